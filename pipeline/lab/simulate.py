"""Takes whose truth is known: a performance in a scene, before the virtual Kinect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinefilter.characters import SKELETONS, Body, InputError, Motion, State, Take
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.merge.lag import Clock
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.scenes import load_scene
from kinefilter.scenes.library import MOTIONS, Area, perform, prop_poses, random_body
from kinefilter.scenes.sensor import (
    SENSORS,
    Sensor,
    Tracker,
    in_sensor_frame,
    observe,
)

from .recorded_acts import mocap_act

_IN_SCENE = {
    "basketball": "basketball",
    "box": "lift_box",
    "chair": "chair",
    "flip_chart": "flip_chart",
    "office": "office",
}
_SKELETON = {"v1": "kinect_v1", "v2": "kinect_v2", "azure": "kinect_v2"}
_OWN_SENSOR = {"kinect_v1": "v1", "kinect_v2": "v2"}
_IN_THE_WAY = ("office", "flip_chart", "box")
"""Scenes with a thing before a person who does something else."""
_HANDLED = (
    ("box", "lift_box"),
    ("flip_chart", "flip_chart"),
    ("basketball", "basketball"),
    ("chair", "chair"),
    ("chair", "sit_to_stand"),
    ("office", "office"),
)
"""Scenes and what people do with the thing in them."""
_ELSEWHERE = ("walk", "run", "carry", "sit", *(motion for _, motion in _HANDLED))
"""Motions that go through things, or need one."""
_AMONG = (-0.7, 0.7)  # m: where people walk among several sensors, in view of all
_LEARNED_FROM = 100  # seed of the first of the people whom methods learn from
_ROOM = 0.25  # m around the root of who walks, for feet and elbows: a guess


def motion_for(scene: str | Path) -> str:
    """Return what a person does in a scene: something with what is there, on the spot.

    Without anything there, and in scenes of users, they squat.
    """
    return _IN_SCENE.get(str(scene), "squat")


def simulate(
    scene: str | Path,
    motion: str,
    *,
    sensor: str = "v2",
    skeleton: str | None = None,
    seed: int = 0,
    person: int | None = None,
    stay_in_view: bool = False,
    tracker: Tracker = "model",
) -> PairedTake:
    """Return what a virtual Kinect sees of a motion in a scene, and the truth.

    Args:
        scene: One of ``SCENES``, or the path of an MJCF file.
        motion: One of ``MOTIONS``, or the path of a mocap file.
        sensor: One of ``SENSORS``.
        skeleton: Name of the take's skeleton; by default the sensor's own (for Azure
            Kinect, Kinect v2's).
        seed: Draws the person, the performance and the sensor's errors.
        person: Draws the person alone, with what the sensor always errs by in them;
            by default the seed.
        stay_in_view: Let gaits go around in the sensor's view. By default they go
            straight ahead and leave it, as in the takes that the embedded weights and
            the figures come from: studies and training keep to that. Other motions are
            the same either way.
        tracker: How joints are found: ``model``, or in ``depth`` images.

    Raises:
        InputError: An unknown scene, motion, sensor, skeleton or tracker.
    """
    if sensor not in SENSORS:
        raise InputError(f"unknown name {sensor!r}; known: {', '.join(SENSORS)}")
    room = load_scene(scene)
    person = seed if person is None else person
    joints = SKELETONS[skeleton or _SKELETON[sensor]]
    body = random_body(joints, np.random.default_rng(person))
    area = area_in_view(SENSORS[sensor], body.height) if stay_in_view else None
    act = _performed(motion, body, seed, 30.0, area)
    take = observe(
        act,
        seed=seed,
        person=person,
        sensor=SENSORS[sensor],
        scene=room,
        prop_poses=prop_poses(room, act),
        tracker=tracker,
    )
    truth = _truth(act, take, SENSORS[sensor])
    stem = f"{Path(scene).stem}_{_named(motion)}_{sensor}"
    return PairedTake(take, truth, f"person {person}", f"{stem}_e{seed:02d}")


def _performed(
    motion: str, body: Body, seed: int, fps: float, within: Area | None
) -> Motion:
    """Return what a person does, or somebody else did before a mocap system."""
    if motion in MOTIONS or not Path(motion).suffix:
        return perform(motion, body, seed=seed, fps=fps, within=within)
    return mocap_act(Path(motion), body.skeleton, fps)


def _named(motion: str) -> str:
    return Path(motion).name.partition(".")[0]


def _truth(act: Motion, take: Take, sensor: Sensor) -> Array:
    """Return the true joints [m] at a take's frames, time counted from the first."""
    # Frames that never arrived have no truth; stamps tremble far less than a frame.
    stamps = take.time - 0.5 * np.diff(act.time).mean() + act.time[0]
    frames = np.minimum(np.searchsorted(act.time, stamps), len(act) - 1)
    return np.asarray(in_sensor_frame(act.positions, sensor)[frames])


class SimulatedView(NamedTuple):
    """What one of several virtual Kinects saw."""

    pair: PairedTake
    """The take, by the sensor's clock, and the truth in its frame."""
    sensor: Sensor
    """Where it stands."""
    clock: Clock
    """What its clock shows, for seconds of the performance."""


def simulate_session(
    scene: str | Path,
    motion: str,
    *,
    sensors: Sequence[str] = ("v2", "v2"),
    degrees: float = 90.0,
    seed: int = 0,
) -> list[SimulatedView]:
    """Return what several virtual Kinects see of a person at once, and the truth.

    Each has its own skeleton, errors, height, tilt and clock, which shows any time and
    gains or loses up to 0.1 ms a second, and takes its frames between those of the
    others. The truth of each is in its own frame, at its own frames.

    Args:
        scene: One of ``SCENES``, or the path of an MJCF file.
        motion: One of ``MOTIONS``, or the path of a mocap file.
        sensors: Some of ``SENSORS``; the person faces the first.
        degrees: Angle at which each next sensor stands, around the person.
        seed: Draws person, performance, errors, places and clocks.
    """
    rng, room = np.random.default_rng([seed, 2]), load_scene(scene)
    views, count = [], len(sensors)
    for k, name in enumerate(sensors):
        body = random_body(SKELETONS[_SKELETON[name]], np.random.default_rng(seed))
        area = Area(_AMONG, _AMONG)
        whole = _performed(motion, body, seed, 30.0 * count, area)
        act = whole.at(slice(k, None, count))
        poses = {prop: rows[k::count] for prop, rows in prop_poses(room, whole).items()}
        sensor = replace(
            SENSORS[name],
            azimuth=np.radians(degrees * k),
            height=rng.uniform(0.8, 1.2),
            tilt=rng.uniform(-0.07, 0.07),
        )
        seen = observe(
            act,
            seed=seed * count + k,
            person=seed,
            sensor=sensor,
            scene=room,
            prop_poses=poses,
        )
        truth = _truth(act, seen, sensor)
        clock = Clock(0.0, rng.uniform(0.0, 3600.0), rng.uniform(-1e-4, 1e-4))
        take = replace(seen, time=clock.at(act.time[0] + seen.time))
        clip = f"{Path(scene).stem}_{_named(motion)}_{name}_e{seed:02d}_sensor{k + 1}"
        pair = PairedTake(take, truth, f"person {seed}", clip)
        views.append(SimulatedView(pair, sensor, clock))
    return views


def area_in_view(sensor: Sensor, height: float) -> Area:
    """Return where on the floor a person is in a sensor's view from head to foot."""
    place = np.arange(-4.0, 4.0, 0.05)
    around = [(x, y, z) for x in (-1, 1) for y in (0, 1) for z in (-1, 1)]
    person = np.array([_ROOM, height, _ROOM]) * around

    def ends(spots: Array) -> tuple[float, float]:
        seen = sensor.in_view(in_sensor_frame(spots[:, None] + person, sensor))
        rows = np.flatnonzero(seen.all(axis=1))
        return float(place[rows[0]]), float(place[rows[-1]])

    zero = np.zeros_like(place)
    near, far = ends(np.stack([zero, zero, place], axis=-1))
    middle = np.full_like(place, 0.5 * (near + far))
    return Area(ends(np.stack([place, zero, middle], axis=-1)), (near, far))


def simulated_pair(k: int, skeleton: str, tracker: Tracker = "model") -> PairedTake:
    """Return the take of a Kinect v2 of person ``k`` of ``simulated_pairs``.

    Args:
        k: Which person, from 0 on; their motion is the kth of the library.
        skeleton: Name of the take's skeleton.
        tracker: How joints are found.
    """
    motion = MOTIONS[k % len(MOTIONS)]
    return simulate(
        "basic", motion, skeleton=skeleton, seed=_LEARNED_FROM + k, tracker=tracker
    )


def simulated_pairs(
    skeleton: str, *, people: int = 400, progress: Progress = silent
) -> list[PairedTake]:
    """Return takes of Kinect v2 to learn from, each of another simulated person.

    One motion of the library after the other, on a bare floor. Nobody in them is in
    the built-in database or in the studies.

    Args:
        skeleton: Name of the takes' skeleton.
        people: How many, at most 900.
        progress: Wraps the loop over the takes, for a progress bar.
    """
    people = min(people, 900)
    return [simulated_pair(k, skeleton) for k in progress("simulate", people)]


def furnished_pairs(
    skeleton: str, *, people: int = 600, progress: Progress = silent
) -> list[PairedTake]:
    """Return takes to learn from in which things hide people as well.

    Of ten people four move on a bare floor, three behind a thing, and three do
    something with one. They are people of ``simulated_pairs``, seen by the sensor whose
    skeleton it is.

    Args:
        skeleton: Name of the takes' skeleton.
        people: How many, at most 900.
        progress: Wraps the loop over the takes, for a progress bar.
    """
    rng = np.random.default_rng(0)
    standing = [motion for motion in MOTIONS if motion not in _ELSEWHERE]
    pairs = []
    for k in progress("simulate", min(people, 900)):
        turn = k % 10
        if turn < 4:
            scene, motion = "basic", str(rng.choice(MOTIONS))
        elif turn < 7:
            scene, motion = _IN_THE_WAY[turn - 4], str(rng.choice(standing))
        else:
            scene, motion = _HANDLED[rng.integers(len(_HANDLED))]
        sensor = _OWN_SENSOR[skeleton]
        pairs.append(simulate(scene, motion, sensor=sensor, seed=_LEARNED_FROM + k))
    return pairs


def truth_of(pair: PairedTake) -> Take:
    """Return the truth of a simulated take as a take without any error."""
    state = np.full(pair.take.state.shape, State.TRACKED, dtype=np.uint8)
    return Take(pair.take.time, pair.truth, state, pair.take.skeleton, pair.clip)


def write_pairs(pairs: Sequence[PairedTake], path: Path) -> None:
    """Write clips of one person as a pairs file, as ``read_pairs`` reads them.

    Clips are at a constant rate there: the median of the stamps' is written.

    Raises:
        InputError: The file cannot be written.
    """
    stop = np.cumsum([len(pair.take) for pair in pairs])
    steps = np.concatenate([np.diff(pair.take.time) for pair in pairs])
    arrays = {
        "joints": np.array(pairs[0].take.skeleton.joints),
        "fps": np.float32(1.0 / np.median(steps)),
        "subject": np.array(pairs[0].subject),
        "kinect": np.concatenate([pair.take.positions for pair in pairs]),
        "mocap": np.concatenate([pair.truth for pair in pairs]),
        "state": np.concatenate([pair.take.state for pair in pairs]),
        "clip": np.array([pair.clip for pair in pairs]),
        "start": np.concatenate([[0], stop[:-1]]),
        "stop": stop,
    }
    write_arrays(path, arrays)
