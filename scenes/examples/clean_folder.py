"""Clean every take in a folder and write the clips as USD.

    python clean_folder.py TAKES CLIPS

``kinefilter batch TAKES -o CLIPS`` does the same on all cores and writes a manifest.
"""

import sys
from argparse import ArgumentParser
from pathlib import Path

import kinefilter


def main(takes: Path, clips: Path) -> None:
    """Clean the CSV takes in a folder."""
    clips.mkdir(parents=True, exist_ok=True)
    cleaner = kinefilter.Cleaner()  # loads its database only once
    for path in sorted(takes.glob("*.csv")):
        try:
            result = cleaner.clean(kinefilter.read_take(path))
        except kinefilter.InputError as error:
            print(error)
            continue
        kinefilter.write_clip(result.clip, clips / f"{path.stem}.usdc")
        before, after = result.stages["raw"], result.stages["physics"]
        print(f"{path.name}: jitter {before.jitter:.0f} to {after.jitter:.0f} m/s^3")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        ArgumentParser(usage="%(prog)s TAKES CLIPS").error("give two folders")
    main(Path(sys.argv[1]), Path(sys.argv[2]))
