"""Let an avatar follow input that no sensor should give, and tell how it fares.

    python tests/hostile.py 1000000

Noise, jumps of meters, teleports, joints missing for seconds, swapped sides, frozen
and coinciding joints, pauses, and pushes. Prints frames without a finite pose, resets,
how deep the character got into the floor, and the memory of the process at the
beginning and at the end.
"""

from __future__ import annotations

import resource
import sys

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from kinefilter import Avatar
from kinefilter.characters import KINECT_V1, standard_body
from kinefilter.pipeline.metrics import lowest_point
from kinefilter.scenes.library import perform_medley

Array = NDArray[np.float64]

EPISODE = 90  # frames that one kind of trouble lasts
BODY = standard_body(KINECT_V1)


def troubled(frame: Array, kind: int, rng: np.random.Generator) -> Array:
    """Return a frame (J, 3) with one kind of trouble."""
    n = len(frame)
    if kind == 1:
        return frame + rng.normal(scale=0.2, size=frame.shape)
    if kind == 2:
        return frame + rng.choice([0.0, 3.0], p=[0.9, 0.1]) * rng.normal(size=3)
    if kind == 3:
        hidden = rng.random(n) < 0.5
        return np.where(hidden[:, None], np.nan, frame)
    if kind == 4:
        return np.full_like(frame, np.nan)
    if kind == 5:
        return frame[KINECT_V1.mirror]
    if kind == 6:
        return np.zeros_like(frame)
    if kind == 7:
        return rng.normal(scale=10.0, size=frame.shape)
    if kind == 8:
        thrown = frame.copy()
        thrown[rng.integers(n)] += rng.normal(scale=2.0, size=3)
        return thrown
    if kind == 9:
        return frame * 1e6
    return frame


def main(count: int) -> None:
    """Run and print."""
    out = Console(soft_wrap=True, highlight=False)
    rng = np.random.default_rng(0)
    parts = [("punch", 5.0), ("kick", 5.0), ("squat", 5.0), ("wave", 5.0)]
    act = perform_medley(parts, BODY, seed=1)
    avatar = Avatar(BODY)
    time, bad, resets, early, lowest = 0.0, 0, 0, 0, 0.0
    for k in track(range(count), "hostile"):
        kind = int(np.random.default_rng(k // EPISODE).integers(10))
        time += 1 / 30 if rng.random() < 0.999 else rng.uniform(0.001, 30.0)
        if k % 977 == 0:
            avatar.push("Head", 500.0 * rng.normal(size=3), 0.2)
        pose = avatar.step(troubled(act.positions[k % len(act)], kind, rng), time)
        bad += not np.isfinite(pose.positions).all()
        resets += pose.reset
        lowest = min(lowest, float(lowest_point(pose.positions[None], BODY)[0]))
        if k == min(20_000, count // 10):
            early = _memory()
    out.print(
        f"{count} frames: {bad} without a finite pose, {resets} put back onto their "
        f"target, {-lowest * 1e3:.1f} mm under the floor at most; memory at "
        f"the peak {early} MiB early, {_memory()} MiB at the end"
    )


def _memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


if __name__ == "__main__":
    main(int(sys.argv[1]))
