"""One take of what several sensors recorded of a person, by clocks of their own."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from live_sensors import error, first_frames
from numpy.typing import NDArray
from real_data import DATA
from scipy.spatial.transform import Rotation

from kinefilter import merge, read_clip, read_take
from kinefilter.characters import KINECT_V2, InputError, Origin, State, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.lab.simulation import simulate_session
from kinefilter.pipeline.merge import Fused, Fusion, Sight, align, read_calibration
from kinefilter.pipeline.merge.fusion import Facing
from kinefilter.pipeline.merge.rigid import Placement, placement
from kinefilter.pipeline.target.floor import leveled
from kinefilter.scenes.sensor import in_sensor_frame

Array = NDArray[np.float64]
FRAMES = 150  # of simulated takes
_HERE = np.array([0.0, 0.0, 0.0])
_FRONT = Placement(Rotation.identity(), np.zeros(3))


class Session(NamedTuple):
    """Two simulated takes of a walk, and what is true of them."""

    takes: tuple[Take, Take]
    truths: tuple[Array, Array]
    lag: float  # of the second clock at the first one's middle [s]
    placed: Placement  # from the second sensor's frame to the first's


@cache
def session(
    seed: int, degrees: float = 90.0, sensors: tuple[str, str] = ("v2", "v2")
) -> Session:
    views = simulate_session(
        "basic", "walk", sensors=sensors, degrees=degrees, seed=seed
    )
    views = first_frames(views, FRAMES)
    takes = [
        replace(view.pair.take, source=f"sensor{k}.csv")
        for k, view in enumerate(views, start=1)
    ]
    points = np.random.default_rng(0).normal(size=(30, 3))
    here, there = (in_sensor_frame(points, view.sensor) for view in views)
    first, second = (view.clock for view in views)
    middle = takes[0].time.mean()
    return Session(
        (takes[0], takes[1]),
        (views[0].pair.truth, views[1].pair.truth),
        second.at(first.inverse(middle)) - middle,
        placement(there, here),
    )


def truth_at(times: Array, found: Session) -> tuple[NDArray[np.bool_], Array]:
    """Return which times are in the first take, and the truth then in its frame."""
    time, truth = found.takes[0].time, found.truths[0]
    inside = (times >= time[0]) & (times <= time[-1])
    there = [np.interp(times[inside], time, x) for x in truth.reshape(len(time), -1).T]
    return inside, np.stack(there, axis=1).reshape(-1, *truth.shape[1:])


@pytest.mark.parametrize("degrees", [45.0, 90.0, -90.0, 180.0])
def test_clock_and_place_are_found_from_a_walk(degrees: float) -> None:
    """Within a hundredth of a second, a degree and two centimeters."""
    found = session(3, degrees)
    first, second = found.takes
    made = align(first, second)
    middle = first.time.mean()
    assert made.clock.at(middle) - middle == pytest.approx(found.lag, abs=0.010)
    turned = made.placed.turn * found.placed.turn.inv()
    assert np.degrees(turned.magnitude()) < 1.0
    body = found.truths[1].reshape(-1, 3)
    away = made.placed.apply(body) - found.placed.apply(body)
    assert np.linalg.norm(away.mean(axis=0)) < 0.02
    assert made.clock_is_sure
    assert made.place_is_sure


def test_merged_walk_is_truer_than_what_either_sensor_saw() -> None:
    found = session(4)
    made = merge(found.takes)
    single = [
        error(take.positions, truth, take)
        for take, truth in zip(found.takes, found.truths, strict=True)
    ]
    inside, truth = truth_at(made.take.time, found)
    merged = error(made.take.positions[inside], truth, made.take)
    assert merged < 0.7 * min(single)
    np.testing.assert_allclose(made.shares.sum(axis=1), 1.0, atol=1e-9)


def test_20_joints_beside_25() -> None:
    """The merged take has the larger skeleton; what only one has stays that one's."""
    found = session(5, 60.0, ("v1", "v2"))
    made = merge(found.takes)
    assert made.take.skeleton == KINECT_V2
    neck, knee = KINECT_V2.index("Neck"), KINECT_V2.index("KneeLeft")
    assert (made.shares[:, 0, neck] == 0.0).all()
    assert 0.0 < made.shares[:, 0, knee].mean() < 1.0


def _sight(
    positions: Array, *, reliability: float = 1.0, sensor: Array = _HERE
) -> Sight:
    count = len(positions)
    state = np.where(np.isnan(positions[:, 0]), State.NOT_TRACKED, State.TRACKED)
    return Sight(positions, np.full(count, reliability), state.astype(np.uint8), sensor)


@cache
def _walk() -> Array:
    """Return a walk as the first sensor would see it without errors [m], (T, 25, 3)."""
    return session(3).truths[0]


def _steps(sights: list[list[Sight | None]]) -> list[Fused]:
    fusion = Fusion(KINECT_V2, len(sights[0]))
    return [fusion.step(frame, 1.0 / 30.0) for frame in sights]


def test_where_sensors_agree_nothing_changes() -> None:
    walk = _walk()
    beside = np.array([2.5, 0.0, 2.5])
    made = _steps([[_sight(p), _sight(p, sensor=beside)] for p in walk])
    np.testing.assert_allclose([f.positions for f in made], walk, atol=1e-9)


def test_a_sensor_that_has_the_sides_exchanged_is_put_right() -> None:
    """Behind a person, a sensor takes the back for the front."""
    walk, behind = _walk(), np.array([0.0, 0.0, 6.0])
    mirrored = walk[:, KINECT_V2.mirror]
    made = _steps(
        [
            [_sight(p), _sight(q, sensor=behind)]
            for p, q in zip(walk, mirrored, strict=True)
        ]
    )
    np.testing.assert_allclose([f.positions for f in made], walk, atol=1e-9)


def test_who_turns_away_from_all_sensors_is_put_right() -> None:
    """Sensors agree then, but knees and elbows bend the wrong way."""
    walk = _walk()[:60]
    mirrored = walk[:, KINECT_V2.mirror]
    made = _steps([[_sight(p), _sight(p)] for p in mirrored])
    np.testing.assert_allclose(made[-1].positions, walk[-1], atol=1e-9)


def test_who_looks_ahead_knows_the_sides_from_the_first_frame() -> None:
    """A limb that one sensor loses for a while exchanges nothing."""
    walk = _walk()[:60].copy()
    elbows = KINECT_V2.sides("Elbow")
    there = walk[:, KINECT_V2.mirror].copy()
    there[:20, elbows] = walk[:20, elbows] = np.nan
    frames = [[_sight(p), _sight(q)] for p, q in zip(walk, there, strict=True)]
    sides, _ = Fusion(KINECT_V2, 2).precompute(frames, np.full(60, 1.0 / 30.0))
    np.testing.assert_array_equal(sides, [[False, True]] * 60)


def test_a_sensor_beside_a_person_does_not_turn_them() -> None:
    """It sees them turned toward itself; who turns toward it is seen to."""
    angles, beside = np.radians([0.0, 90.0]), np.radians(60.0)
    turning = np.linspace(0.0, np.radians(90.0), 120)
    headings = np.concatenate([np.zeros(90), turning, np.full(90, turning[-1])])
    seen = [np.minimum(headings, np.radians(30.0)), np.maximum(headings, beside)]
    yaws, elapsed = np.transpose(seen), np.full(300, 1.0 / 30.0)
    facing = Facing().whole(yaws, np.tile(angles, (300, 1)), elapsed)
    away = np.abs(facing - headings)
    assert away.max() < np.radians(30.0)
    assert away[[*range(70), *range(230, 300)]].max() < np.radians(6.0)


@pytest.mark.parametrize("joint", ["HandLeft", "SpineBase"])
def test_a_joint_that_one_sensor_sees_stays_that_ones(joint: str) -> None:
    walk, hand = _walk(), KINECT_V2.index(joint)
    hidden = walk.copy()
    hidden[:, hand] = np.nan
    made = _steps([[_sight(p), _sight(q)] for p, q in zip(walk, hidden, strict=True)])
    np.testing.assert_allclose([f.positions for f in made], walk, atol=1e-9)
    assert {f.shares[0, hand] for f in made} == {1.0}
    assert all(f.state[hand] == State.TRACKED for f in made)


def test_what_no_sensor_sees_stays_missing() -> None:
    hidden = _walk()[:5].copy()
    hand = KINECT_V2.index("HandLeft")
    hidden[:, hand] = np.nan
    for made in _steps([[_sight(p), None] for p in hidden]):
        assert np.isnan(made.positions[hand]).all()
        assert made.state[hand] == State.NOT_TRACKED
        assert made.reliability[hand] == made.shares[:, hand].sum() == 0.0


def test_joints_are_weighted_by_reliability() -> None:
    walk, hand = _walk()[:30], KINECT_V2.index("HandLeft")
    wrong = walk + np.where(np.arange(25) == hand, 0.4, 0.0)[:, None]
    made = _steps(
        [
            [_sight(p), _sight(q, reliability=0.2)]
            for p, q in zip(walk, wrong, strict=True)
        ]
    )
    np.testing.assert_allclose(made[0].positions[hand] - walk[0, hand], 0.2 / 1.2 * 0.4)


def test_a_joint_does_not_jump_where_the_other_sensor_takes_over() -> None:
    """How each sensor misplaces it was learned while both saw it."""
    walk = np.repeat(_walk()[:1], 120, axis=0)
    knee = KINECT_V2.index("KneeLeft")
    shifted = walk.copy()
    shifted[:, knee] += [0.0, 0.06, 0.0]
    seen = walk.copy()
    seen[90:, knee] = np.nan
    made = _steps([[_sight(p), _sight(q)] for p, q in zip(seen, shifted, strict=True)])
    path = np.array([f.positions[knee] for f in made])
    assert np.linalg.norm(path[90] - path[89]) < 0.005


def written(folder: Path, *takes: Take) -> list[str]:
    paths = []
    for k, take in enumerate(takes, start=1):
        path = folder / f"sensor{k}.csv"
        write_take_csv(take, path)
        paths.append(str(path))
    return paths


def test_command_writes_a_take_that_reads_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = session(4)
    paths = written(tmp_path, *found.takes)
    out, json_file = tmp_path / "merged.csv", tmp_path / "merged.json"
    assert main(["merge", *paths, "-o", str(out), "--json", str(json_file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(any(Path(path).name in line for line in lines) for path in paths)
    take, made = read_take(out), merge([read_take(path) for path in paths])
    np.testing.assert_allclose(take.positions, made.take.positions, atol=1e-8)
    np.testing.assert_array_equal(take.state, made.take.state)
    header = out.read_text().splitlines()[0].split(",")
    assert header[-2:] == ["ThumbRight.reliability", "ThumbRight.sensor"]
    sensors = json.loads(json_file.read_text())["sensors"]
    assert sensors[1]["turned_degrees"] == pytest.approx(-90.0, abs=3.0)
    assert sum(sensor["share"] for sensor in sensors) == pytest.approx(1.0)


def _errors_alone_and_merged(tmp_path: Path, seed: int) -> list[float]:
    found = session(seed)
    paths = written(tmp_path, *found.takes)
    errors, measured = list[float](), list[float]()
    other = found._replace(takes=found.takes[::-1], truths=found.truths[::-1])
    for words, seen in ((paths[:1], found), (paths[1:], other), (paths, found)):
        out = tmp_path / f"clip{len(errors)}.npz"
        assert main(["clean", *words, "-o", str(out), "--no-physics"]) == 0
        clip = read_clip(out)
        inside, truth = truth_at(clip.time, seen)
        truth = leveled(truth, clip.tilt, clip.roll)
        errors.append(error(clip.positions[inside], truth, found.takes[0]))
        measured.append(np.mean(clip.origin == Origin.MEASURED))
    assert measured[2] > 0.9 * min(measured[:2]), measured
    return errors


def test_clean_makes_one_clip_of_two_sensors(tmp_path: Path) -> None:
    """It is truer than the better of the sensors alone, over several sessions."""
    errors = [_errors_alone_and_merged(tmp_path, seed) for seed in (5, 7, 9, 11, 13)]
    *alone, merged = np.transpose(errors)
    assert merged.mean() < 0.95 * np.minimum(*alone).mean(), errors


def test_what_only_several_sensors_have_needs_several(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = written(tmp_path, *session(4).takes)
    out = ["-o", str(tmp_path / "clip.npz")]
    for words, said in (
        ([paths[0], "--calibration", "session.json"], "several sensors"),
        ([*paths, "--body", "all"], "--body all works with one sensor only"),
        ([], "no take given"),
        ([str(tmp_path)], "is a folder; use 'kinefilter batch' for it"),
    ):
        assert main(["clean", *words, *out]) == 2
        assert said in capsys.readouterr().err.replace("\n", " ")


def _standing(take: Take) -> Take:
    """Return the first three seconds of a take as of somebody who stands and nods."""
    nod = 0.03 * np.sin(take.time[:90] * 5.0)
    positions = np.repeat(take.positions[:1], 90, axis=0)
    positions[..., 1] += nod[:, None] * (np.arange(25) % 4 == 0)
    return replace(
        take, time=take.time[:90], positions=positions, state=take.state[[0] * 90]
    )


def test_calibration_places_the_sensors_of_somebody_who_stands(tmp_path: Path) -> None:
    """And is refused where a sensor was moved, or takes are in another order."""
    walked, moved = session(4), session(5, 60.0)
    paths, saved = written(tmp_path, *walked.takes), tmp_path / "session.json"
    out = ["-o", str(tmp_path / "merged.csv")]
    assert main(["merge", *paths, *out, "--save-calibration", str(saved)]) == 0
    with pytest.raises(InputError, match="first as its sensor 2 and this one as its"):
        merge(walked.takes[::-1], calibration=read_calibration(saved))
    still = [_standing(take) for take in walked.takes]
    paths = written(tmp_path, *still)
    assert main(["merge", *paths, *out, "--calibration", str(saved)]) == 0
    paths = written(tmp_path, *moved.takes)
    assert main(["merge", *paths, *out, "--calibration", str(saved)]) == 2
    frozen = [
        replace(take, positions=take.positions[[0] * len(take)]) for take in still
    ]
    paths, text = written(tmp_path, *frozen), saved.read_text()
    assert main(["merge", *paths, *out, "--calibration", str(saved)]) == 0
    for number in ("1e7", "1e300"):
        wrong = text.replace('"lag_seconds": ', f'"lag_seconds": {number}, "was": ')
        saved.write_text(wrong)
        assert main(["merge", *paths, *out, "--calibration", str(saved)]) == 2


def test_takes_that_do_not_belong_together_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = session(4).takes, session(6).takes
    out = tmp_path / "merged.csv"
    for takes, words in (
        ([one[0], other[1]], "one by one, or with 'kinefilter batch'"),
        ([one[0], one[0]], "takes are identical"),
        ([one[0]], "only one take is given"),
    ):
        paths = written(tmp_path, *takes)
        assert main(["merge", *paths, "-o", str(out)]) == 2
        assert words in capsys.readouterr().err.replace("\n", " ")
        assert not out.exists()
    none = ["--calibration", str(tmp_path / "none.json")]
    assert main(["merge", *paths, "-o", str(out), *none]) == 2
    assert "none.json: there is no such file" in capsys.readouterr().err


def test_standing_people_do_not_tell_where_sensors_are() -> None:
    made = merge([_standing(take) for take in session(4).takes])
    (note,) = made.all_notes()
    assert "unsure" in note or "30 degrees" in note


@pytest.mark.skipif(not DATA.is_dir(), reason="needs the recordings")
@pytest.mark.parametrize(
    ("name", "degrees"), [("p12_90deg_walk", 90.0), ("p16_45deg_steps", 45.0)]
)
def test_recorded_session(name: str, degrees: float) -> None:
    """Two Kinect v2: angle, lag against the recording computer's, and far limbs."""
    folder = DATA / "two-kinects"
    side, front = (read_take(next(folder.glob(f"{name}_{s}*.csv.gz"))) for s in "AB")
    made = merge([front, side])
    (found,) = made.alignments
    turn = found.placed.turn.apply([0.0, 0.0, 1.0])
    assert np.degrees(np.arctan2(turn[0], turn[2])) == pytest.approx(-degrees, abs=3.0)
    rows = (folder / f"{name}.sync.csv").read_text().splitlines()[1:]
    ticks = np.array([row.split(",")[1:3] for row in rows], dtype=float)
    apart = float(np.mean(ticks[:, 0] - ticks[:, 1]))
    middle = float(ticks[:, 1].mean())
    # The second computer's frames arrive 25 ms later in all sessions.
    assert found.clock.at(middle) - middle == pytest.approx(apart - 0.025, abs=0.02)
    arm = [KINECT_V2.index(joint) for joint in ("ElbowLeft", "WristLeft")]
    away = np.nanmedian(made.residuals[:, :, arm], axis=(1, 2))
    assert away[0] < 0.05 < away[1] + 0.03
