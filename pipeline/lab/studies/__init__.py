"""What README and the papers say, measured again: a table and a plot for each study.

A study is a function of ``Options`` and of sizes that returns a ``Study``; ``catalog``
has them by name. Those of the papers take simulated people. Those of README's figures
take recordings where there are some, and simulated people elsewhere; ``claims.toml``
has what README says of them, and ``claims`` compares it with what was measured.
"""

from . import claims
from .catalog import STUDIES, check_names, fingerprint, is_made, note_made, reproduce
from .output import check_drawing, check_studies_folder, make_pictures, write_study
from .study import Options, Study, as_table
from .takes import recordings_folder

__all__ = [
    "STUDIES",
    "Options",
    "Study",
    "as_table",
    "check_drawing",
    "check_names",
    "check_studies_folder",
    "claims",
    "fingerprint",
    "is_made",
    "make_pictures",
    "note_made",
    "recordings_folder",
    "reproduce",
    "write_study",
]
