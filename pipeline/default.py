"""What corrects a take when nothing is asked for.

The embedded model knows constant offsets alone. Whole postures can be learned from
simulated people too (``kinefilter train --simulated``); no study shows that recorded
people gain from it, so it is not the default.
"""

from __future__ import annotations

from importlib import resources

from kinefilter.characters import Skeleton

from .correct import Corrector, LocalPCA
from .correct.in_turn import InTurn
from .database import PostureDatabase
from .models import load_model

__all__ = ["default_corrector"]


def default_corrector(database: PostureDatabase) -> Corrector:
    """Return the joint offsets of the embedded model, then local PCA.

    Args:
        database: Natural postures.
    """
    return InTurn([_embedded_model(database.skeleton), LocalPCA(database)])


def _embedded_model(skeleton: Skeleton) -> Corrector:
    """Return what ``kinefilter train --simulated`` learned for a skeleton."""
    folder = resources.files("kinefilter.pipeline").joinpath("embedded")
    with resources.as_file(folder / f"{skeleton.name}.npz") as path:
        return load_model(path).corrector
