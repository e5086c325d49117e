"""A process that draws and dies over some clips, for the tests of ``render``."""

from __future__ import annotations

import os

from kinefilter.pipeline.render.codec import Coded
from kinefilter.pipeline.render.parts import Parts
from kinefilter.pipeline.render.shot import Shot


def draw_or_die(shot: Shot, parts: Parts, fingerprint: str) -> list[list[Coded]]:
    if shot.clip.stem == "deadly":
        os._exit(1)
    shot.out.with_name(f"{shot.clip.stem}.drawn").write_text(fingerprint)
    return [[] for _ in parts]
