"""kinefilter turns noisy Kinect skeleton takes into clips that animators ship.

This module offers what most users need, and imports it on first use. Fields of
``CleanConfig`` and ``Export`` are options that ``kinefilter clean --help`` explains.

    take = kinefilter.read_take("take.csv")
    result = kinefilter.clean(take, kinefilter.CleanConfig(cutoff=4.0))
    kinefilter.write_clip(result.clip, "clip.glb", kinefilter.Export(fps=24.0))
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kinefilter.characters import Clip, InputError, Motion, Take
    from kinefilter.pipeline.avatar import Avatar, Pose
    from kinefilter.pipeline.clean_result import CleanResult
    from kinefilter.pipeline.cleaner import Cleaner, clean
    from kinefilter.pipeline.config import CleanConfig
    from kinefilter.pipeline.database import PostureDatabase
    from kinefilter.pipeline.formats import Export, read_clip, write_clip
    from kinefilter.pipeline.formats.takes import read_take, read_takes
    from kinefilter.pipeline.lab.evaluate import evaluate
    from kinefilter.pipeline.merge import clean_session, merge
    from kinefilter.pipeline.pairs import read_pairs
    from kinefilter.pipeline.physics.shared_scene import SharedScene

_PLACES = {
    "characters": ("Clip", "InputError", "Motion", "Take"),
    "pipeline.avatar": ("Avatar", "Pose"),
    "pipeline.clean_result": ("CleanResult",),
    "pipeline.cleaner": ("Cleaner", "clean"),
    "pipeline.config": ("CleanConfig",),
    "pipeline.database": ("PostureDatabase",),
    "pipeline.formats": ("Export", "read_clip", "write_clip"),
    "pipeline.formats.takes": ("read_take", "read_takes"),
    "pipeline.lab.evaluate": ("evaluate",),
    "pipeline.merge": ("clean_session", "merge"),
    "pipeline.pairs": ("read_pairs",),
    "pipeline.physics.shared_scene": ("SharedScene",),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}

__all__ = [
    "Avatar",
    "CleanConfig",
    "CleanResult",
    "Cleaner",
    "Clip",
    "Export",
    "InputError",
    "Motion",
    "Pose",
    "PostureDatabase",
    "SharedScene",
    "Take",
    "__version__",
    "clean",
    "clean_session",
    "evaluate",
    "merge",
    "read_clip",
    "read_pairs",
    "read_take",
    "read_takes",
    "write_clip",
]


def __getattr__(name: str) -> Any:
    """Import the object of a name."""
    if name == "__version__":
        from importlib.metadata import version

        return version("kinefilter")
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"kinefilter.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
