"""Teach ``--scoring learned`` what goes with joints that are far off.

    python tests/teach_reliability.py

Writes ``pipeline/lab/embedded/*_doubt.npz`` from simulated people who are in no study.
Takes about five minutes.
"""

from __future__ import annotations

from pathlib import Path

from kinefilter.characters import SKELETONS
from kinefilter.pipeline.lab.scorers import learned_weights
from kinefilter.pipeline.lab.simulation import pairs_with_props

FOLDER = Path(__file__).parents[1] / "pipeline" / "lab" / "embedded"


def main() -> None:
    for name in SKELETONS:
        learned_weights(pairs_with_props(name)).save(FOLDER / f"{name}_doubt.npz")


if __name__ == "__main__":
    main()
