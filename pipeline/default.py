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
from .correct.local_pca import Search
from .database import PostureDatabase
from .models import load_model


def default_corrector(
    database: PostureDatabase, *, search: Search = "solver", seed: int = 0
) -> Corrector:
    """Return the joint offsets of the embedded model, then local PCA.

    Args:
        database: Natural postures.
        search: How local PCA finds its posture.
        seed: Seed of its stochastic search.
    """
    follower = LocalPCA(database, search=search, seed=seed)
    follower = LocalPCA(database, search=search, seed=seed)
    return InTurn([_embedded_model(database.skeleton), follower])


def _embedded_model(skeleton: Skeleton) -> Corrector:
    """Return what ``kinefilter train --simulated`` learned for a skeleton."""
    folder = resources.files("kinefilter.pipeline").joinpath("embedded")
    with resources.as_file(folder / f"{skeleton.name}.npz") as path:
        return load_model(path).corrector
