"""How often ``pair`` takes mocap for that of a take, and how near it comes to others.

``python tests/pairing_figures.py DATA [PERSON...]``: DATA has ``ui-prmd`` and
``raw-pairs``. Every third clip of the people in ui-prmd meets its own mocap, that of
another repetition, of another person's same exercise, and of other exercises. Every raw
pair of them is compared with the finished pair of the same clip.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from raw_pairs import compared

from kinefilter.characters import InputError
from kinefilter.pipeline.commands.terminal import out
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.lab.pairing import pair_session
from kinefilter.pipeline.pairs import PairedTake, read_pairs

_EVERY = 3


def fits(pair: PairedTake, other: PairedTake) -> bool:
    """Tell whether a take is paired with the mocap of a clip."""
    joints = pair.take.skeleton.joints
    mocap = Mocap(joints, other.truth, None, 1 / 30, other.clip)
    try:
        pair_session([(pair.take, mocap)], subject="x")
    except InputError:
        return False
    return True


def main(data: Path, people: list[str]) -> None:
    """Print both tables."""
    files = sorted((data / "ui-prmd").glob("s*.npz"))
    pairs = [p for f in files if not people or f.stem in people for p in read_pairs(f)]
    rng = np.random.default_rng(0)

    def same(one: PairedTake, other: PairedTake) -> tuple[bool, bool]:
        return one.subject == other.subject, one.clip[:3] == other.clip[:3]

    kinds: dict[str, Callable[[PairedTake, PairedTake], bool]] = {
        "its own": lambda a, b: a is b,
        "another repetition": lambda a, b: same(a, b) == (True, True) and a is not b,
        "another person, same exercise": lambda a, b: same(a, b) == (False, True),
        "another exercise": lambda a, b: same(a, b) == (True, False),
        "another exercise and person": lambda a, b: same(a, b) == (False, False),
    }
    for kind, fit in kinds.items():
        found = []
        for pair in pairs[::_EVERY]:
            others = [other for other in pairs if fit(pair, other)]
            found.append(fits(pair, others[rng.integers(len(others))]))
        out.print(f"{kind}: {np.mean(found):.1%} of {len(found)} are paired")
    for file in sorted((data / "raw-pairs").glob("*.c3d")):
        clip = file.name.split(".")[0]
        if not people or clip[4:7] in people:
            try:
                ms, degrees, cm, apart = compared(clip)
            except (InputError, AssertionError) as error:
                out.print(f"{clip}: {error}")
                continue
            out.print(
                f"{clip}: lag {ms:+.1f} ms, {degrees:.2f} degrees, {cm:.2f} cm; joints "
                f"{np.nanmean(apart):.2f} cm, {np.nanmax(apart):.2f} at most"
            )


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
