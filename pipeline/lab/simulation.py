"""Simulated takes with ground truth: performances recorded by virtual Kinects."""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kinefilter.characters import SKELETONS, Body, Motion, State, Take
from kinefilter.characters.arrays import Array, check_choice
from kinefilter.pipeline.formats.npz import write_arrays
from kinefilter.pipeline.merge.lag import Clock
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.progress import Progress, silent
from kinefilter.scenes import load_scene
from kinefilter.scenes.library import MOTIONS, Area, perform, prop_poses, random_body
from kinefilter.scenes.sensor import SENSORS, Sensor, Tracker, in_sensor_frame, observe

from .recorded_acts import mocap_act

_SKELETON = {"v1": "kinect_v1", "v2": "kinect_v2", "azure": "kinect_v2"}
_OWN_SENSOR = {"kinect_v1": "v1", "kinect_v2": "v2"}
_IN_THE_WAY = ("office", "flip_chart", "box")  # scenes with a prop before a person
_HANDLED = (
    ("box", "lift_box"),
    ("flip_chart", "flip_chart"),
    ("basketball", "basketball"),
    ("chair", "chair"),
    ("chair", "sit_to_stand"),
    ("office", "office"),
)
"""Scenes, and motions that use their props."""
_IN_SCENE = dict(reversed(_HANDLED))  # default motion of each scene: the first above
_ELSEWHERE = ("walk", "run", "carry", "sit", *(motion for _, motion in _HANDLED))
"""Motions that would pass through props, or need one."""
_AMONG = (-0.7, 0.7)  # m: where people walk among several sensors, in view of all
_MOST_PEOPLE = 900  # in training data; the people of studies have seeds from 1000 on
_LEARNED_FROM = 100  # seed of the first person in training data
_ROOM = 0.25  # m around the root, for the feet and elbows of a walker: a guess


def motion_for(scene: str | Path) -> str:
    """Return the default motion in a scene: using its prop, or else squatting."""
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
    """Return the take of a virtual Kinect of a motion in a scene, with ground truth.

    Arguments are those of ``kinefilter simulate``, which explains them. ``person`` is
    the seed of the person and of the sensor's constant errors for them, by default
    ``seed``. Without ``stay_in_view`` gaits go straight and leave the view, as in the
    takes behind the embedded weights and the published figures. Raises an InputError if
    the scene, motion, sensor, skeleton or tracker is unknown.
    """
    check_choice(sensor, SENSORS, "name")
    room = load_scene(scene)
    person = seed if person is None else person
    joints = SKELETONS[skeleton or _SKELETON[sensor]]
    body = random_body(joints, np.random.default_rng(person))
    area = area_in_view(SENSORS[sensor], body.height) if stay_in_view else None
    act = _acted(motion, body, seed, 30.0, area)
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


def _acted(name: str, body: Body, seed: int, fps: float, area: Area | None) -> Motion:
    if name in MOTIONS or not Path(name).suffix:
        return perform(name, body, seed=seed, fps=fps, within=area)
    return mocap_act(Path(name), body.skeleton, fps)


def _named(motion: str) -> str:
    return Path(motion).name.partition(".")[0]


def _truth(act: Motion, take: Take, sensor: Sensor) -> Array:
    # Dropped frames are skipped; time stamps jitter by far less than a frame.
    stamps = take.time - 0.5 * np.diff(act.time).mean() + act.time[0]
    frames = np.minimum(np.searchsorted(act.time, stamps), len(act) - 1)
    return np.asarray(in_sensor_frame(act.positions, sensor)[frames])


class SimulatedView(NamedTuple):
    """The recording of one of several virtual Kinects."""

    pair: PairedTake  # in the sensor's time and frame
    sensor: Sensor
    clock: Clock  # converts seconds of the performance to the sensor's time


def simulate_session(
    scene: str | Path,
    motion: str,
    *,
    sensors: Sequence[str] = ("v2", "v2"),
    degrees: float = 90.0,
    seed: int = 0,
) -> list[SimulatedView]:
    """Return the simultaneous takes of several virtual Kinects, with ground truth.

    Each sensor has its own skeleton, errors, height, tilt and clock, which starts at an
    arbitrary time and drifts by up to 0.1 ms per second; the sensors' frames
    interleave. The ground truth is in each sensor's frame, at its own frames. The
    person faces the first of ``sensors``, which stand ``degrees`` apart.
    """
    rng, room = np.random.default_rng([seed, 2]), load_scene(scene)
    views, count = [], len(sensors)
    for k, name in enumerate(sensors):
        body = random_body(SKELETONS[_SKELETON[name]], np.random.default_rng(seed))
        whole = _acted(motion, body, seed, 30.0 * count, Area(_AMONG, _AMONG))
        act = whole.at(slice(k, None, count))
        poses = {prop: rows[k::count] for prop, rows in prop_poses(room, whole).items()}
        sensor = replace(
            SENSORS[name],
            azimuth=np.radians(degrees * k),
            height=rng.uniform(0.8, 1.2),
            tilt=rng.uniform(-0.07, 0.07),
        )
        own = seed * count + k
        seen = observe(
            act, seed=own, person=seed, sensor=sensor, scene=room, prop_poses=poses
        )
        truth = _truth(act, seen, sensor)
        clock = Clock(0.0, rng.uniform(0.0, 3600.0), rng.uniform(-1e-4, 1e-4))
        take = replace(seen, time=clock.at(act.time[0] + seen.time))
        clip = f"{Path(scene).stem}_{_named(motion)}_{name}_e{seed:02d}_sensor{k + 1}"
        pair = PairedTake(take, truth, f"person {seed}", clip)
        views.append(SimulatedView(pair, sensor, clock))
    return views


def area_in_view(sensor: Sensor, height: float) -> Area:
    """Return the floor area in which a sensor sees a person from head to foot."""
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
    """Return the Kinect v2 take of person ``k`` of ``simulated_pairs``, from 0 on."""
    motion, seed = MOTIONS[k % len(MOTIONS)], _LEARNED_FROM + k
    return simulate("basic", motion, skeleton=skeleton, seed=seed, tracker=tracker)


def simulated_pairs(
    skeleton: str, *, people: int = 400, progress: Progress = silent
) -> list[PairedTake]:
    """Return Kinect v2 takes of up to 900 people in no study, for training."""
    people = min(people, _MOST_PEOPLE)
    return [simulated_pair(k, skeleton) for k in progress("simulate", people)]


def recorded_pairs(file: Path, every: int = 1) -> Iterator[PairedTake]:
    """Yield every so many pairs of a file, or of mocap what a virtual Kinect sees.

    The person of mocap is what its name begins with: 35 in 35_01.bvh.gz.
    """
    if file.suffix == ".npz":
        yield from read_pairs(file)[::every]
    else:
        seed = zlib.crc32(file.name.encode()) % 10_000
        pair = simulate("basic", str(file), seed=seed)
        yield replace(pair, subject=file.name.partition("_")[0])


def pairs_with_props(
    skeleton: str, *, people: int = 600, progress: Progress = silent
) -> list[PairedTake]:
    """Return takes for training in which props hide people too.

    Of ten of the people of ``simulated_pairs``, four move on an empty floor, three
    behind a prop, and three use a prop.
    """
    rng = np.random.default_rng(0)
    standing = [motion for motion in MOTIONS if motion not in _ELSEWHERE]
    pairs = []
    for k in progress("simulate", min(people, _MOST_PEOPLE)):
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
    """Return the ground truth of a pair as the take of a sensor without errors."""
    state = np.full_like(pair.take.state, State.TRACKED)
    return replace(pair.take, positions=pair.truth, state=state)


def write_pairs(pairs: Sequence[PairedTake], path: Path) -> None:
    """Write a person's clips as a pairs file at their median rate, or InputError."""
    takes = [pair.take for pair in pairs]
    stop = np.cumsum([len(take) for take in takes])
    steps = np.concatenate([np.diff(take.time) for take in takes])
    arrays = {
        "joints": np.array(takes[0].skeleton.joints),
        "fps": np.float32(1.0 / np.median(steps)),
        "subject": np.array(pairs[0].subject),
        "kinect": np.concatenate([take.positions for take in takes]),
        "mocap": np.concatenate([pair.truth for pair in pairs]),
        "state": np.concatenate([take.state for take in takes]),
        "clip": np.array([pair.clip for pair in pairs]),
        "start": np.concatenate([[0], stop[:-1]]),
        "stop": stop,
    }
    write_arrays(path, arrays)
