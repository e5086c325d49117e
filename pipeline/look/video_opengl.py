"""The OpenGL that draws without a screen, found by trying it in a process of its own.

MuJoCo chooses its OpenGL when it is imported, and a process can hold only one kind.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass

from kinefilter.characters import InputError

_NAMES = {"win32": {"wgl": "WGL"}, "darwin": {"cgl": "CGL"}}.get(
    sys.platform, {"egl": "EGL", "osmesa": "OSMesa"}
)  # in the order in which they are tried
_LONGEST = 60.0  # s that a driver may take to start, a guess
_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader", "software")
_PROBE = """
import mujoco
context = mujoco.GLContext(16, 16)
context.make_current()
drawing = mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), 50)
mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawing)
assert drawing.currentBuffer == mujoco.mjtFramebuffer.mjFB_OFFSCREEN
from OpenGL import GL
print("draws with", GL.glGetString(GL.GL_RENDERER).decode(), flush=True)
import os
os._exit(0)  # some drivers fail when they are closed
"""


@dataclass(frozen=True)
class Backend:
    """An OpenGL that works here: MUJOCO_GL's value, and the driver's own words."""

    name: str
    renderer: str

    @property
    def software(self) -> bool:
        """Whether the processor draws, which makes shadows and samples slow."""
        return any(word in self.renderer.lower() for word in _SOFTWARE)

    def __str__(self) -> str:
        name = _NAMES.get(self.name, self.name)
        where = "no GPU" if self.software else "GPU"
        return f"drawn with {name} ({where}: {self.renderer})"

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables of the processes that draw."""
        # One thread each: several processes draw, and would compete for the cores.
        return {"MUJOCO_GL": self.name, "LP_NUM_THREADS": "0"}


def find_backend() -> Backend:
    """Return the first OpenGL that draws: MUJOCO_GL's if it is set, else the system's.

    That is EGL or OSMesa, WGL on Windows, CGL on macOS. If none does, an InputError
    names what to install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    reasons = []
    for name in (wanted,) if wanted else _NAMES:
        if isinstance(found := _try(name), Backend):
            return found
        reasons.append(f"{_NAMES.get(name, name)}: {found}")
    raise InputError(
        f"no OpenGL that draws without a screen ({'; '.join(reasons)}); install one: "
        "the GPU's driver brings one; on Debian libosmesa6 draws on any machine, "
        "libegl1 is faster" + (", or unset MUJOCO_GL" if wanted else "")
    )


def _try(name: str) -> Backend | str:
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, "MUJOCO_GL": name},
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_LONGEST,
        )
    except subprocess.TimeoutExpired:
        return "does not answer"
    found = re.search("^draws with (.*)", done.stdout, re.MULTILINE)
    if found is not None:
        return Backend(name, found[1])
    said = done.stderr.strip().splitlines()
    return said[-1].strip()[:120] if said else f"ended with code {done.returncode}"
