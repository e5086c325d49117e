"""What README and the papers say, measured again: a table and a plot a study.

A study is a function of a seed and of sizes that returns a ``Study``; ``catalog`` has
them by name. Those of the papers take simulated people. Those of README's figures take
recordings where there are some (``recordings``), and simulated people elsewhere; what
README says of them stands in ``claims.toml``, and ``verdicts`` compares it with what
was found.
"""

from . import made, verdicts
from .catalog import STUDIES, check_names, reproduce
from .drawing import check_drawing
from .files import check_studies_folder, write_study
from .pictures import make_pictures
from .recordings import recordings_folder
from .study import Study, as_table

__all__ = [
    "STUDIES",
    "Study",
    "as_table",
    "check_drawing",
    "check_names",
    "check_studies_folder",
    "made",
    "make_pictures",
    "recordings_folder",
    "reproduce",
    "verdicts",
    "write_study",
]
