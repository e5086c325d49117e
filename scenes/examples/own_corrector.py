"""Clean a take with your own correction method.

    python own_corrector.py TAKE CLIP

To add the method to the command line, put its class into ``pipeline/correct`` and add a
line to ``METHODS`` in ``pipeline/methods.py``.
"""

import sys
from argparse import ArgumentParser
from pathlib import Path

import numpy as np

import kinefilter
from kinefilter.pipeline.correct import Correction, Corrector, Hold, Observation


class Mirror(Corrector):
    """Correction of unreliable joints by mirroring those of the other side."""

    def __init__(self, skeleton):
        self._hold, self._partner = Hold(skeleton), skeleton.mirror

    def start(self):
        """Reset the state for a new motion."""
        self._hold.start()

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame, in which the root is at the origin and faces +z."""
        filled = self._hold.step(observation)
        mirrored = filled.positions[self._partner] * [-1.0, 1.0, 1.0]
        share = (observation.reliability * filled.confidence)[:, None]
        positions = share * filled.positions + (1.0 - share) * mirrored
        return Correction(positions, share[:, 0], np.nan)


def main(path: Path, clip: Path) -> None:
    """Clean a take with the method above."""
    take = kinefilter.read_take(path)
    cleaner = kinefilter.Cleaner(corrector=Mirror(take.skeleton))
    kinefilter.write_clip(cleaner.clean(take).clip, clip)
    print(f"wrote {clip}")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        ArgumentParser(usage="%(prog)s TAKE CLIP").error("give a take and a clip")
    try:
        main(Path(sys.argv[1]), Path(sys.argv[2]))
    except kinefilter.InputError as error:
        sys.exit(str(error))
