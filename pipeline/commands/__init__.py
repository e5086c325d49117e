"""The commands of the command line, one a file: they parse and print, nothing else."""

from .batch import Batch
from .bench import Bench
from .character import Character
from .clean import Clean
from .database import Database
from .evaluate import Evaluate
from .info import Info
from .live import Live
from .render import Render
from .replay import Replay
from .report import Report
from .reproduce import Reproduce
from .simulate import Simulate
from .train import Train
from .view import View

__all__ = [
    "Batch",
    "Bench",
    "Character",
    "Clean",
    "Database",
    "Evaluate",
    "Info",
    "Live",
    "Render",
    "Replay",
    "Report",
    "Reproduce",
    "Simulate",
    "Train",
    "View",
]
