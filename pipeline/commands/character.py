"""``kinefilter character``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from kinefilter.characters import SKELETONS, STANDARD_HEIGHT, InputError, standard_body

from .terminal import Skeletons, keep, out


@dataclass(frozen=True)
class Character:
    """Write the simulated character as MJCF, for your own MuJoCo scenes."""

    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write (.xml)."""
    height: float = STANDARD_HEIGHT
    """Stature [m]."""
    mass: float | None = None
    """Body mass [kg]; default: from the stature."""
    skeleton: Skeletons = "kinect_v2"
    """Whose joints it has."""
    scene: str = "basic"
    """What is around it: a scene (an unknown name lists them), or an MJCF file
    (.xml)."""

    def run(self) -> int:
        """Write the character."""
        from kinefilter.pipeline.formats import atomic_path, check_folder
        from kinefilter.scenes import scene_xml

        if self.out.suffix != ".xml":
            raise InputError(f"{self.out}: expected a name that ends in .xml")
        check_folder(self.out)
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
