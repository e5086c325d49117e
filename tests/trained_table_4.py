"""Table IV of Shum 2013, cleaned by models that were trained on simulated takes.

    python tests/trained_table_4.py FOLDER

Trains a model a skeleton into FOLDER, unless it is there, in some four minutes each.
Nobody who teaches is in the study.
"""

from __future__ import annotations

import sys
from pathlib import Path

from rich.console import Console

from kinefilter.characters import SKELETONS
from kinefilter.pipeline.cli import main as kinefilter
from kinefilter.pipeline.studies.shum_reconstruction import shum_table_4
from kinefilter.pipeline.studies.study import as_table


def main() -> None:
    models = {name: Path(sys.argv[1]) / f"{name}.npz" for name in SKELETONS}
    Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
    for name, path in models.items():
        if not path.is_file():
            simulated = ["--simulated", name, "--furnished"]
            kinefilter(["train", *simulated, "--method", "best", "-o", str(path)])
    Console().print(as_table(shum_table_4(models=models)))


if __name__ == "__main__":
    main()
