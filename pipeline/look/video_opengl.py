"""Finding an OpenGL that draws without a screen, by trying each in its own process.

MuJoCo chooses its OpenGL on import, and a process can load only one kind.
"""

import os
import re
import subprocess
import sys
from dataclasses import dataclass

from kinefilter.characters import InputError

_NAMES = {"win32": {"wgl": "WGL"}, "darwin": {"cgl": "CGL"}}.get(
    sys.platform, {"egl": "EGL", "osmesa": "OSMesa"}
)  # in the order in which they are tried
_TIMEOUT = 60.0  # s that a driver may take to start, a guess
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
os._exit(0)  # some drivers crash on exit
"""


@dataclass(frozen=True)
class Backend:
    """An OpenGL that works here: the value for MUJOCO_GL, and the driver's name."""

    name: str
    renderer: str

    @property
    def software(self) -> bool:
        """Whether the CPU draws, which makes shadows and samples slow."""
        return any(word in self.renderer.lower() for word in _SOFTWARE)

    def __str__(self) -> str:
        name = _NAMES.get(self.name, self.name)
        where = "no GPU" if self.software else "GPU"
        return f"drawn with {name} ({where}: {self.renderer})"

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables for the processes that draw."""
        # One thread each: several processes draw and would compete for the cores.
        return {"MUJOCO_GL": self.name, "LP_NUM_THREADS": "0"}


def find_backend() -> Backend:
    """Return the OpenGL of MUJOCO_GL or the first that works, or raise InputError."""
    wanted, reasons = os.environ.get("MUJOCO_GL", "").strip().lower(), []
    for name in (wanted,) if wanted else _NAMES:
        if isinstance(result := _try(name), Backend):
            return result
        reasons.append(f"{_NAMES.get(name, name)}: {result}")
    raise InputError(
        f"no OpenGL draws without a screen here ({'; '.join(reasons)}); install the "
        "GPU's driver, or on Debian libosmesa6, which works on any machine, or the "
        "faster libegl1" + (", or unset MUJOCO_GL" if wanted else "")
    )


def _try(name: str) -> Backend | str:
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, "MUJOCO_GL": name},
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_TIMEOUT,
        )
    except subprocess.TimeoutExpired:
        return f"no answer in {_TIMEOUT:g} s"
    driver = re.search("^draws with (.*)", done.stdout, re.MULTILINE)
    if driver is not None:
        return Backend(name, driver[1])
    errors = done.stderr.strip().splitlines()
    return errors[-1].strip()[:120] if errors else f"exit code {done.returncode}"
