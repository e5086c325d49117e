"""What a USD file says about itself and its skeleton."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError

from .guarded import read_guarded
from .usd_reader import read_usd_positions

_LARGEST = 2**31  # bytes


def check_usd(path: str) -> None:
    """Raise InputError for a file that no reader of USD should be asked to open.

    A package (.usdz) keeps its files as they are; one that has to be inflated is
    another archive, of whatever size.
    """
    size = Path(path).stat().st_size
    if size > _LARGEST:
        raise InputError(f"{path}: {size / 1e6:.0f} MB of USD are no clip")
    if Path(path).suffix.lower() != ".usdz":
        return
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        raise InputError(f"{path}: damaged USD package; export it again") from None
    stored = all(member.compress_type == zipfile.ZIP_STORED for member in members)
    if not stored or sum(member.file_size for member in members) > size:
        raise InputError(
            f"{path}: its files are packed smaller than they are, which a USD package "
            "may not; export it again"
        )


def usd_contents(path: str) -> dict[str, Any]:
    """Return units, axis, rate, joints and duration of the first animated skeleton.

    Raises:
        InputError: The file is no USD, or has no animated skeleton.
    """
    check_usd(path)
    contents: dict[str, Any] = json.loads(
        str(read_guarded("usd_contents", path)["json"])
    )
    return contents


def arrays_of(path: str) -> dict[str, NDArray[Any]]:
    """Return the contents as JSON in an array (see ``guarded``).

    Raises:
        InputError: As ``usd_contents``.
    """
    from pxr import Tf, Usd, UsdGeom

    try:
        time, names, _ = read_usd_positions(path)
        stage = Usd.Stage.Open(path)
    except (Tf.ErrorException, RuntimeError, ValueError, IndexError, TypeError):
        raise InputError(
            f"{path}: its skeleton and animation do not fit; export it again"
        ) from None
    steps = np.diff(time)
    attributes = sorted(
        {
            attribute.GetName()
            for prim in stage.Traverse()
            for attribute in prim.GetAuthoredAttributes()
            if attribute.GetName().startswith(("kinefilter:", "primvars:kinefilter:"))
        }
    )
    contents = {
        "unit": f"{UsdGeom.GetStageMetersPerUnit(stage):g} m",
        "up_axis": str(UsdGeom.GetStageUpAxis(stage)),
        "joints": len(names),
        "names": list(names),
        "frames": len(time),
        "seconds": float(time[-1] - time[0]) if len(time) else 0.0,
        "fps": float(1.0 / np.median(steps)) if len(steps) and steps.all() else None,
        "time_codes_per_second": float(stage.GetTimeCodesPerSecond()),
        "attributes": attributes,
    }
    return {"json": np.array(json.dumps(contents))}
