"""Writing FBX: the user's own Blender, the only open writer, converts a GLB."""

import os
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE, STDOUT

import numpy as np

from kinefilter.characters import Clip, InputError

from .export import Export
from .files import AnyPath, atomic_path
from .glb import write_glb
from .rig import RigMotion

_KEYS = 24  # keyframes/s: Blender's default rate, so that each is one of its frames
_SECONDS, _PER_FRAME = 120.0, 0.05
"""Time limit [s] of Blender, and more a frame: forty times what it needs. A guess."""
_SCRIPT = Path(__file__).with_name("blender_fbx.py")


def blender_command(blender: str | None) -> list[str]:
    """Return the command that runs the FBX script in Blender, or in a Python with bpy.

    By default it is that of KINEFILTER_BLENDER, or the one on the PATH. Raises
    InputError if there is none.
    """
    blender = blender or os.environ.get("KINEFILTER_BLENDER")
    program = shutil.which(blender or "blender")
    if program is None:
        where = f"{blender}: no such program" if blender else "no Blender"
        raise InputError(
            f"{where}; FBX is written by Blender: install it from blender.org (or bpy "
            "in a Python environment of its own) and give its program with --blender "
            "or in KINEFILTER_BLENDER, or write .glb"
        )
    if Path(program).name.lower().startswith("python"):
        return [program, "-P", str(_SCRIPT), "--"]
    flags = ["--background", "--factory-startup", "--python-exit-code", "1"]
    return [program, *flags, "--python", str(_SCRIPT), "--"]


def write_fbx(clip: Clip, motion: RigMotion, path: AnyPath, export: Export) -> None:
    """Write a clip with even frames as FBX, whole or not at all.

    Skeleton, skin, animation and props are those of GLB, in centimeters, y up. Raises
    InputError if Blender is missing, fails or takes too long.
    """
    command = blender_command(export.blender)
    keyed = replace(clip, time=np.arange(len(clip)) / _KEYS)
    timeout = _SECONDS + _PER_FRAME * len(clip)
    with (
        atomic_path(path) as temporary,
        tempfile.TemporaryDirectory(prefix="kinefilter-") as folder,
    ):
        write_glb([(keyed, motion)], Path(folder) / "clip.glb", export)
        fbx = Path(folder) / "clip.fbx"
        numbers = map(repr, (len(clip), export.fps or clip.fps, _KEYS))
        lines = _run([*command, folder, *numbers], timeout, path)
        if not fbx.is_file():
            errors = [line.strip() for line in lines if "Error" in line]
            reason = errors[-1] if errors else "no error message"
            raise InputError(
                f"{path}: Blender ({command[0]}) wrote no FBX ({reason}); use Blender "
                "4.2 or later, or write .glb"
            )
        shutil.copyfile(fbx, temporary)


def _run(command: list[str], timeout: float, path: AnyPath) -> list[str]:
    """Return the lines that a command prints; it ends when this process ends."""
    standard_input, held_open = os.pipe()  # at its end, the script exits
    try:
        ran = subprocess.run(
            command, stdin=standard_input, stdout=PIPE, stderr=STDOUT, timeout=timeout
        )
    except subprocess.TimeoutExpired:
        wrong = f"took over {timeout:.0f} s and was ended; write .glb, or cut the take"
        raise InputError(f"{path}: Blender ({command[0]}) {wrong}") from None
    except OSError as error:
        reason = f"cannot be run ({error.strerror})"
        raise InputError(f"Blender ({command[0]}) {reason}") from None
    finally:
        os.close(standard_input)
        os.close(held_open)
    return ran.stdout.decode("utf-8", "replace").splitlines()
