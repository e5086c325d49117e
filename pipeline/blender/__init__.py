"""The Blender extension: made here, run by Blender."""

from .extension import write_extension

__all__ = ["write_extension"]
