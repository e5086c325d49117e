"""What is said of a frame: when it is, what is doubtful, what carries the body."""

from __future__ import annotations

import html

import numpy as np

from kinefilter.characters import Clip, Term

_TERMS = {int(term): term.words for term in Term}


def status_html(clip: Clip, frame: int) -> str:
    """Return a few lines about a frame as HTML."""
    worst = int(np.argmin(clip.reliability[frame]))
    term = _TERMS.get(int(clip.deciding_term[frame, worst]), "unknown")
    force = float(clip.external_force[frame])
    rows = {
        "time": f"{clip.time[frame] - clip.time[0]:.2f} s, frame {frame + 1} of "
        f"{len(clip)}",
        "least reliable": f"{clip.skeleton.joints[worst]}, "
        f"{clip.reliability[frame, worst]:.2f} ({term})",
    }
    if np.isfinite(force):
        rows["external force"] = f"{force:.2f} body weights"
    cells = "".join(
        f'<div style="opacity:0.6">{name}</div><div>{html.escape(text)}</div>'
        for name, text in rows.items()
    )
    return (
        '<div id="status" style="display:grid;grid-template-columns:auto 1fr;'
        f'gap:1px 8px;font-size:12px;margin:2px 8px">{cells}</div>'
    )
