"""``kinefilter character``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from kinefilter.characters import SKELETONS, STANDARD_HEIGHT, standard_body

from .terminal import Skeletons, check_output, keep, out


@dataclass(frozen=True)
class Character:
    """Write the simulated character as MJCF, for your own MuJoCo scenes."""

    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write (.xml)."""
    height: float = STANDARD_HEIGHT
    """Body height [m]."""
    mass: float | None = None
    """Body mass [kg]; default: estimated from the height."""
    skeleton: Skeletons = "kinect_v2"
    """Skeleton whose joints the character has."""
    scene: str = "basic"
    """Surroundings: a scene (an unknown name lists the scenes), or an MJCF file
    (.xml)."""

    def run(self) -> int:
        """Write the character."""
        from kinefilter.pipeline.formats import atomic_path
        from kinefilter.scenes import scene_xml

        check_output(self.out, ".xml")
        keep(self.out, Path(self.scene))
        body = standard_body(
            SKELETONS[self.skeleton], height=self.height, mass=self.mass
        )
        text = scene_xml(self.scene, body)
        with atomic_path(self.out) as temporary:
            temporary.write_text(text, encoding="utf-8")
        out.print(
            f"wrote {self.out}: {self.skeleton}, "
            f"{body.height:.2f} m, {body.mass:.0f} kg"
        )
        return 0
