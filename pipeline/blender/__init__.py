"""The Blender extension: packaged here, run by Blender."""
