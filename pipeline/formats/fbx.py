"""FBX, made by the user's own Blender of a GLB: nobody else writes it openly."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from kinefilter.characters import Clip, InputError

from .export import Export
from .files import AnyPath, atomic_path
from .glb import write_glb
from .rig import RigMotion

_KEYS = 24  # a second: Blender's own rate, so that each keyframe is one of its frames
_SECONDS, _PER_FRAME = 120.0, 0.05
"""Time [s] that Blender may take for any clip, and more for each of its frames: forty
times what it needs. A guess."""
_SCRIPT = Path(__file__).with_name("blender_fbx.py")


def blender_command(blender: str | None) -> list[str]:
    """Return how to run a script in Blender, or in a Python that has its ``bpy``.

    None stands for the Blender that the shell finds. Raises an InputError if there is
    none.
    """
    found = shutil.which(blender or "blender")
    if found is None:
        where = f"--blender {blender}: no such program" if blender else "no Blender"
        raise InputError(
            f"{where}; .fbx is made by Blender: install it from blender.org (or bpy "
            "into a Python of its own) and name its program with --blender, or write "
            ".glb"
        )
    if Path(found).name.lower().startswith("python"):
        return [found, "-P", str(_SCRIPT), "--"]
    flags = ["--background", "--factory-startup", "--python-exit-code", "1"]
    return [found, *flags, "--python", str(_SCRIPT), "--"]


def write_fbx(clip: Clip, moved: RigMotion, path: AnyPath, export: Export) -> None:
    """Write a clip with even frames as FBX, whole or not at all.

    Skeleton, skin, animation and props are those of GLB, in centimeters, y up. Raises
    InputError if Blender is missing, fails or takes too long.
    """
    command = blender_command(export.blender)
    keyed = replace(clip, time=np.arange(len(clip)) / _KEYS)
    most = _SECONDS + _PER_FRAME * len(clip)
    with (
        atomic_path(path) as temporary,
        tempfile.TemporaryDirectory(prefix="kinefilter-") as folder,
    ):
        write_glb([(keyed, moved)], Path(folder) / "clip.glb", export)
        made = Path(folder) / "clip.fbx"
        numbers = (len(clip), export.fps or clip.fps, _KEYS)
        said = _run([*command, folder, *map(repr, numbers)], most, path)
        if not made.is_file():
            why = next(
                (line for line in reversed(said) if "Error" in line), "no reason"
            )
            raise InputError(
                f"{path}: Blender ({command[0]}) made no FBX ({why.strip()}); take "
                "Blender 4.2 or later, or write .glb"
            )
        shutil.copyfile(made, temporary)


def _run(command: list[str], most: float, path: AnyPath) -> list[str]:
    """Return the lines that a command prints; it ends with this process, however."""
    heard, told = os.pipe()  # what it reads ends when this process does
    try:
        ran = subprocess.run(
            command,
            stdin=heard,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=most,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise InputError(
            f"{path}: Blender ({command[0]}) took over {most:.0f} s and was ended; "
            "write .glb, or cut the take"
        ) from None
    except OSError as error:
        raise InputError(
            f"--blender {command[0]}: cannot be run ({error.strerror})"
        ) from None
    finally:
        os.close(heard)
        os.close(told)
    return ran.stdout.decode("utf-8", "replace").splitlines()
