"""Compare correction methods on pairs of Kinect takes and mocap.

    python compare_methods.py PAIRS [METHOD ...]

``kinefilter simulate box --motion lift_box --pairs pairs.npz -o take.csv`` makes such
pairs of a simulated person.
"""

import sys
from argparse import ArgumentParser
from pathlib import Path

import kinefilter


def main(path: Path, *methods: str) -> None:
    """Print the errors of each method's clips relative to the mocap."""
    pairs = kinefilter.read_pairs(path)
    figures = kinefilter.evaluate([], pairs, methods or ("none", "default"))
    for name, row in figures["methods"].items():
        print(f"{name}: E {row['E']:.2f} cm, E_var {row['E_var']:.2f} cm")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        ArgumentParser(usage="%(prog)s PAIRS [METHOD ...]").error("give pairs")
    try:
        main(Path(sys.argv[1]), *sys.argv[2:])
    except kinefilter.InputError as error:
        sys.exit(str(error))
