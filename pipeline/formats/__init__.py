"""Files in and out: the only place with foreign axes, units and layouts."""

from .archive import read_clip
from .bvh import Bvh
from .bvh_reader import read_bvh
from .clips import check_writable, write_clip
from .contacts import read_contacts, write_contacts
from .export import Export
from .files import atomic_path, check_folder
from .recording import Recording
from .tables import write_take_csv
from .takes import read_recording, read_take, read_takes
from .usd_reader import read_usd_positions

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
    "read_usd_positions",
    "write_clip",
    "write_contacts",
    "write_take_csv",
]
