"""Reading and writing files: the only place with foreign axes, units and layouts.

Each layout is described where it is read: ``sheets`` (one row per frame), ``datasets``
(NTU and MSR), ``azure``, ``keypoints``, ``bvh``, ``markers`` (C3D and TRC) and
``acclaim``. Readers accept repeated time stamps, dropped frames, and joints that are
missing in some or all frames. A person who reappears within 2 s and 0.5 m is the same.
"""

from .bvh import Bvh, read_bvh
from .clips import check_writable, read_clip, write_clip, write_people
from .export import Export
from .files import atomic_path, check_folder
from .recording import Recording
from .sheets import read_contacts, write_contacts, write_take_csv
from .takes import read_recording, read_take, read_takes

__all__ = [
    "Bvh",
    "Export",
    "Recording",
    "atomic_path",
    "check_folder",
    "check_writable",
    "read_bvh",
    "read_clip",
    "read_contacts",
    "read_recording",
    "read_take",
    "read_takes",
    "write_clip",
    "write_contacts",
    "write_people",
    "write_take_csv",
]
