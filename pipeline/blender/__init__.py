"""The Blender extension: packaged here, run by Blender."""

from .extension import write_extension

__all__ = ["write_extension"]
