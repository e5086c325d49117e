"""Mocap files of every kind, by what they hold."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from kinefilter.characters import InputError

from .acclaim import read_amc, read_asf
from .bvh_takes import read_bvh_mocap
from .c3d import read_c3d
from .files import beginning, check_file
from .mocap import Mocap

RIGS = ("cmu", "motionbuilder", "acclaim", "plug_in_gait")
"""Skeletons that mocap comes on, besides the Kinects' own."""
_C3D_MAGIC = 0x50


def sorted_mocap(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files that hold motion, and the ASF files, which hold none.

    Raises:
        InputError: No file holds motion.
    """
    skeletons = [file for file in files if file.suffix.lower() == ".asf"]
    motions = [file for file in files if file not in skeletons]
    if not motions:
        raise InputError("no BVH, AMC or C3D files given; name one or more")
    return motions, skeletons


def read_mocap(path: str | os.PathLike[str], skeletons: Sequence[Path] = ()) -> Mocap:
    """Read a BVH, AMC or C3D file; BVH and AMC may be gzipped.

    Args:
        path: The file; what it holds decides, not its name.
        skeletons: ASF files, for AMC: the one whose name the motion's begins with, or
            the only one; without any, one beside the motion.

    Raises:
        InputError: The file is missing or malformed, or there is no skeleton for it.
    """
    path = check_file(path)
    with path.open("rb") as file:
        if file.read(2)[1:] == bytes([_C3D_MAGIC]):
            return read_c3d(path)
    first = beginning(path)
    if first.startswith("HIERARCHY"):
        return read_bvh_mocap(os.fspath(path))
    if first[:1] in ("#", ":"):
        return read_amc(path, read_asf(_skeleton_for(path, skeletons)))
    raise InputError(
        f"{path}: no mocap: expected BVH (HIERARCHY ...), AMC (:FULLY-SPECIFIED) with "
        "its ASF, or C3D"
    )


def _skeleton_for(path: Path, skeletons: Sequence[Path]) -> Path:
    """Return the ASF file for an AMC file; raises InputError without one."""
    given = skeletons or sorted(path.parent.glob("*.asf"))
    fitting = [asf for asf in given if path.name.startswith(asf.stem)]
    if fitting:
        return max(fitting, key=lambda asf: len(asf.stem))
    if len(given) == 1:
        return given[0]
    raise InputError(
        f"{path}: no ASF file for it among {len(given)}; give the subject's skeleton, "
        "such as 01.asf for 01_02.amc"
    )
