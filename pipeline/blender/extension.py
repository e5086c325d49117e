"""The zip that Blender installs: manifest, add-on, and its lists of rigs and colors."""

import json
import zipfile
from importlib.metadata import version
from pathlib import Path

import numpy as np

from kinefilter.pipeline.formats.files import AnyPath, atomic_path
from kinefilter.pipeline.look.drawing import reliability_colors
from kinefilter.retarget.rig_map import RIGS, load_rig_map

_MANIFEST = """schema_version = "1.0.0"
id = "kinefilter"
version = "{version}"
name = "kinefilter"
tagline = "Clean Kinect takes and retarget them to armatures"
maintainer = "kinefilter"
type = "add-on"
tags = ["Animation", "Import-Export"]
blender_version_min = "4.2.0"
license = ["SPDX:Apache-2.0"]

[permissions]
files = "Read takes, and write a clip to a temporary folder"
"""
_FILES = {"__init__.py": "add_on.py", "armatures.py": "armatures.py"}
_COLORS = 21  # in steps of 5 %
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest time that zip knows


def write_extension(path: AnyPath) -> None:
    """Write the extension for Blender 4.2 and later, whole or not at all.

    The same version of kinefilter always writes the same bytes. Raises InputError if
    the file cannot be written.
    """
    data = {
        "rigs": RIGS,
        # BVH cannot describe the rest pose of the others.
        "targets": [rig for rig in RIGS if not load_rig_map(rig).axes_in_bvh],
        "colors": reliability_colors(np.linspace(0.0, 1.0, _COLORS)).tolist(),
    }
    files = {
        "blender_manifest.toml": _MANIFEST.format(version=version("kinefilter")),
        "known.json": json.dumps(data),
    }
    for name, source in _FILES.items():
        files[name] = Path(__file__).with_name(source).read_text("utf-8")
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, text in files.items():
            info = zipfile.ZipInfo(name, _EPOCH)
            info.create_system = 3  # Unix, on any system
            archive.writestr(info, text)
