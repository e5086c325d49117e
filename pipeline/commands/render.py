"""``kinefilter render``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg

from kinefilter.characters import InputError
from kinefilter.pipeline.look import Look

from .terminal import err, keep, out, progress_bars


@dataclass(frozen=True)
class Render:
    """Draw clips as videos, animations or pictures.

    Needs no screen: EGL draws or, where no GPU is, OSMesa (Debian's libosmesa6).
    """

    clips: Positional[tuple[Path, ...]]
    """Clips: .npz, USD, .bvh or .csv; the last two hold no props and reliability."""
    out: Annotated[Path, arg(aliases=["-o"])]
    """What to write: out.mp4, out.gif or frames/%05d.png; {clip} stands for a clip's
    name. Pictures that are there already are kept."""
    look: OmitArgPrefixes[Look] = field(default_factory=Look)
    jobs: int | None = None
    """Processes that draw; default: one a core."""

    def run(self) -> int:
        """Draw, write, report."""
        from kinefilter.pipeline.look import render_clips

        if not self.clips:
            raise InputError("no clips given; name one or more to draw")
        if self.jobs is not None and self.jobs < 1:
            raise InputError(f"--jobs {self.jobs}: expected 1 or more")
        keep(self.out, *self.clips, self.look.compare)
        try:
            with progress_bars() as progress:
                done = render_clips(
                    self.clips, self.out, self.look, jobs=self.jobs, progress=progress
                )
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                "the same command again goes on with numbered pictures, a video begins "
                "anew"
            ) from None
        out.print(str(done.backend))
        for path in done.written:
            out.print(f"wrote {path}")
        for failure in done.failures:
            err.print(f"kinefilter: {failure}; left out")
        return 1 if done.failures else 0
