"""The commands ``info``, ``character`` and ``blender``."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from kinefilter.characters import SKELETONS, STANDARD_HEIGHT, InputError, standard_body
from kinefilter.pipeline.config import TakeFormat
from kinefilter.pipeline.formats.files import new_text
from kinefilter.pipeline.formats.plain import finite, printable

from .terminal import Skeletons, check_output, err, out


@dataclass(frozen=True)
class Info:
    """Describe a take, a clip, or any other file that kinefilter reads."""

    file: Positional[tuple[Path, ...]]
    """The file, or several."""
    format: TakeFormat | None = None
    """Format of a take; default: detected from its content."""
    json: bool = False
    """Print JSON, one document per file."""

    def run(self) -> int:
        """Read the file and print a description."""
        from kinefilter.pipeline.contents import as_tables, contents_of

        if not self.file:
            raise InputError("no file given; give a take, a clip or any other file")
        failed = 0
        for path in self.file:
            try:
                contents = contents_of(path, format=self.format)
            except InputError as error:
                err.print(f"kinefilter: {printable(str(error))}")
                failed += 1
                continue
            if self.json:
                sys.stdout.write(json.dumps(finite(contents), indent=2) + "\n")
            else:
                out.print(as_tables(contents))
        return 2 if failed == len(self.file) else min(failed, 1)


@dataclass(frozen=True)
class Character:
    """Write the simulated character as MJCF for use in your own MuJoCo scenes."""

    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write (.xml)."""
    height: float = STANDARD_HEIGHT
    """Body height [m]."""
    mass: float | None = None
    """Body mass [kg]; default: estimated from the height."""
    skeleton: Skeletons = "kinect_v2"
    """Skeleton of the character."""
    scene: str = "basic"
    """Surroundings: a scene (an unknown name lists the scenes), or an MJCF file
    (.xml)."""

    def run(self) -> int:
        """Write the character."""
        from kinefilter.scenes import scene_xml

        check_output(self.out, Path(self.scene), suffix=".xml")
        skeleton = SKELETONS[self.skeleton]
        body = standard_body(skeleton, height=self.height, mass=self.mass)
        text = scene_xml(self.scene, body)
        with new_text(self.out) as file:
            file.write(text)
        size = f"{body.height:.2f} m, {body.mass:.0f} kg"
        out.print(f"wrote {self.out}: {self.skeleton}, {size}")
        return 0


@dataclass(frozen=True)
class Blender:
    """Write an extension for Blender 4.2 and later that cleans takes inside Blender.

    Install it in Blender with Edit, Preferences, Get Extensions, Install from Disk.
    File, Import, Kinect take then runs this command line and puts the clip onto a new
    armature or onto the active one. Bones are colored by reliability, and markers show
    where the tracker failed.
    """

    out: Annotated[Path, arg(aliases=["-o"])]
    """File to write (.zip)."""

    def run(self) -> int:
        """Write the extension."""
        from kinefilter.pipeline.blender.extension import write_extension

        check_output(self.out, suffix=".zip")
        write_extension(self.out)
        out.print(f"wrote {self.out}")
        return 0
