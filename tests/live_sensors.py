"""People whom two sensors of a live session see, without sockets and processes.

    python tests/live_sensors.py [--seeds 10 30] [--motions walk dance turn]

tells how far limb joints are from the truth, relative to the hips, of people whom live
follows by either sensor alone and by both, and how long a frame takes: simulated
sessions, sensors 60, 90 and 120 degrees apart, placed before the first frame.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
from rich.console import Console
from short_takes import beginning

from kinefilter import Avatar, Cleaner
from kinefilter.characters import InputError, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.simulation import SimulatedView, simulate_session
from kinefilter.pipeline.live.fusing import FusedPerson
from kinefilter.pipeline.live.live_config import LiveConfig
from kinefilter.pipeline.live.messages import Frame, SeenBody
from kinefilter.pipeline.live.sensors import Sensors
from kinefilter.pipeline.live.tally import Tally
from kinefilter.pipeline.merge import Alignment, align, clean_session
from kinefilter.pipeline.target.floor import leveled

_say = Console(soft_wrap=True, highlight=False).print


@cache
def views(
    seed: int, degrees: float = 90.0, motion: str = "walk"
) -> tuple[SimulatedView, SimulatedView]:
    """Return what two virtual Kinects see of a person."""
    one, other = simulate_session("basic", motion, degrees=degrees, seed=seed)
    return one, other


def first_frames(seen: Sequence[SimulatedView], count: int) -> list[SimulatedView]:
    """Return the first ``count`` frames of what each sensor saw."""
    return [view._replace(pair=beginning(view.pair, count)) for view in seen]


def two_sensors(take: Take) -> Sensors:
    """Return the streams of two sensors with a take's skeleton."""
    return Sensors(take.skeleton, 2, (), Tally())


def frames(
    *seen: SimulatedView, late: float = 0.0
) -> Iterator[tuple[int, float, Frame]]:
    """Yield whose each frame is, when it comes [s], and the frame, in that order.

    Those of all but the first sensor are late by so much [s].
    """
    rows = []
    for number, view in enumerate(seen):
        take = view.pair.take
        came = view.clock.inverse(take.time) + late * bool(number)
        for k, now in enumerate(came.tolist()):
            body = SeenBody("1", take.positions[k].copy(), take.state[k].copy())
            rows.append((now, number, Frame(float(take.time[k]), (body,))))
    for now, number, frame in sorted(rows, key=lambda row: row[0]):
        yield number, now, frame


def follow(
    seen: Sequence[SimulatedView], found: Alignment, times: list[float] | None = None
) -> Array:
    """Return poses [m] at the first sensor's frames, the second where it was found."""
    take = seen[0].pair.take
    sensors = two_sensors(take)
    stream = sensors.streams[1]
    config = LiveConfig(("-", "-"), ("-",), skeleton=take.skeleton.name)
    person, poses = FusedPerson(config, sensors), []
    person.avatar = person._make_avatar(*Cleaner().measure(take))
    for number, now, frame in frames(*seen):
        leads = sensors.arrive(number, frame, now)
        stream.clock, stream.placed = found.clock, found.placed
        if leads:
            began = time.perf_counter()
            pose = person.step(frame.bodies[0], frame.time)
            if times is not None:
                times.append(time.perf_counter() - began)
            assert pose is not None
            poses.append(pose.positions)
    return np.array(poses)


def alone(take: Take) -> Array:
    """Return the poses [m] of live with one sensor."""
    body, measured = Cleaner().measure(take)
    avatar = Avatar(body, measured=measured)
    rows = zip(take.positions, take.time.tolist(), take.state, strict=True)
    return np.array([avatar.step(*row).positions for row in rows])


def error(positions: Array, truth: Array, take: Take) -> float:
    """Return the mean distance of limb joints from the truth [m], hips taken off."""
    return float(np.nanmean(Accuracy(take.skeleton).distances(positions, truth)))


def cleaned(seen: Sequence[SimulatedView]) -> float:
    """Return the error of the clip that ``clean`` makes of both takes [m]."""
    take, truth = seen[0].pair.take, seen[0].pair.truth
    takes = [view.pair.take for view in seen]
    clip = clean_session(takes, CleanConfig(tilt=0.0))[0].clip
    flat = clip.positions.reshape(len(clip.time), -1)
    at = [np.interp(take.time, clip.time, column) for column in flat.T]
    there = np.stack(at, axis=1).reshape(truth.shape)
    return error(there, leveled(truth, clip.tilt, clip.roll), take)


def main() -> None:
    """Print the errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(10, 14))
    parser.add_argument("--motions", nargs="+", default=["walk", "dance", "turn"])
    asked = parser.parse_args()
    rows, times = [], list[float]()
    for motion in asked.motions:
        for seed in range(*asked.seeds):
            for degrees in (60.0, 90.0, 120.0):
                both = views.__wrapped__(seed, degrees, motion)
                pairs = [view.pair for view in both]
                try:
                    found = align(*(pair.take for pair in pairs))
                    row = [error(alone(p.take), p.truth, p.take) for p in pairs]
                    fused = follow(both, found, times)
                    row.append(error(fused, pairs[0].truth, pairs[0].take))
                    row.append(cleaned(both))
                except InputError as refused:
                    _say(f"{motion} {seed} {degrees:g}: {refused}")
                    continue
                rows.append([motion, *row])
                told = " ".join(f"{100.0 * value:.1f}" for value in row)
                _say(f"{motion} {seed} {degrees:g}: {told}")
    for motion in asked.motions:
        values = 100.0 * np.array([row[1:] for row in rows if row[0] == motion])
        first, second, fused, whole = values.mean(axis=0)
        better = values[:, :2].min(axis=1)
        _say(
            f"{motion}, {len(values)} sessions, cm: first sensor {first:.1f}, second "
            f"{second:.1f}, the better one of each {better.mean():.1f}, both "
            f"{fused:.1f}, clean with both {whole:.1f}; both are worse than the better "
            f"one in {np.sum(values[:, 2] > better)}"
        )
    half, most = np.quantile(times, [0.5, 0.99]) * 1e3
    _say(f"ms a frame: half {half:.1f}, 99 % {most:.1f}")


if __name__ == "__main__":
    main()
