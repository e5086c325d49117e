"""Training pairs of a Kinect take and mocap that share neither clock nor axes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from raw_pairs import RAW, compared
from real_data import paired
from scipy.spatial.transform import Rotation
from skeletons import every_skeleton
from test_mocap_files import write_trc
from text_files import write_text

from kinefilter.characters import (
    KINECT_V1,
    InputError,
    Skeleton,
    State,
    Take,
    standard_body,
)
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.formats.recording import Mocap
from kinefilter.pipeline.lab.marker_sets import read_marker_set
from kinefilter.pipeline.lab.pairing import Pairing, pair_session
from kinefilter.pipeline.merge.lag import Spline
from kinefilter.pipeline.pairs import read_pairs
from kinefilter.scenes.library import perform, perform_medley

Array = NDArray[np.float64]
TURN, SHIFT = Rotation.from_euler("yxz", [70.0, 15.0, -10.0], degrees=True), [1, 2, 3]
TENTH_OF_A_FRAME = 1.0 / 300.0


def joint(name: str, skeleton: Skeleton = KINECT_V1) -> int:
    return skeleton.index(name)


def recordings(
    positions: Array,
    *,
    lag: float = 0.4,
    drift: float = 0.0,
    start: float = 0.0,
    noise: float = 0.006,
    skeleton: Skeleton = KINECT_V1,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[Take, Mocap]:
    """Return a movement (30 frames a second) as a Kinect and as mocap [mm] have it.

    The mocap's clock shows ``lag`` as the take begins at ``start``; the Kinect stands
    where ``shift`` says.
    """
    time = np.arange(len(positions)) / 30
    rng = np.random.default_rng(0)
    seen = positions + shift + rng.normal(0.0, noise, positions.shape)
    for side in ("Left", "Right"):  # a Kinect has the ankle up the shank
        ankle, knee = joint(f"Ankle{side}", skeleton), joint(f"Knee{side}", skeleton)
        shank = positions[:, knee] - positions[:, ankle]
        seen[:, ankle] += 0.06 * shank / np.linalg.norm(shank, axis=1, keepdims=True)
    # The take is the middle of the movement, the mocap may begin earlier.
    middle = slice(30, -30)
    state = np.full(seen[middle].shape[:2], State.TRACKED, dtype=np.uint8)
    take = Take(
        start + time[middle] - time[30], seen[middle], state, skeleton, "x/k.csv"
    )
    clock = np.arange(0.0, lag + (1 + drift) * (time[-1] - time[30]), 0.01)
    then = (clock - lag) / (1 + drift) + time[30]
    assert then[0] >= 0.0
    there = Spline(time, positions).at(then)
    placed = 1000 * (TURN.apply(there.reshape(-1, 3)) + SHIFT).reshape(there.shape)
    return take, Mocap(skeleton.joints, placed, None, 0.01, "x/m.c3d")


def one(take: Take, mocap: Mocap, **options: Any) -> Pairing:
    (pairing,), refused = pair_session([(take, mocap)], subject="ann", **options)
    assert refused == []
    return pairing


@pytest.fixture(scope="module")
def medley() -> Array:
    parts = [("tai_chi", 15.0), ("wave", 10.0), ("squat", 15.0), ("punch", 10.0)]
    body = standard_body(KINECT_V1)
    return np.array(perform_medley(parts, body, seed=2).positions)


def exercise(name: str = "tai_chi", skeleton: Skeleton = KINECT_V1) -> Array:
    return np.array(perform(name, standard_body(skeleton), seed=1).positions)


def check(pairing: Pairing, take: Take, positions: Array) -> None:
    """Check transform and truth: the Kinect's frame is that of the movement."""
    turn = pairing.placed.turn * TURN
    assert np.degrees(turn.magnitude()) < 0.3
    truth = pairing.pair.truth
    known = ~np.isnan(truth).any(axis=2)
    true = positions[30:-30][: len(truth)]
    assert known[10:-10].all()
    assert np.linalg.norm(truth - true, axis=2)[known].max() < 0.01
    assert len(truth) == len(take)


@every_skeleton
@pytest.mark.parametrize(("lag", "start"), [(0.4137, 0.0), (-0.731, 33_000.25)])
def test_lag_and_transform_are_those_that_were_made(
    skeleton: Skeleton, lag: float, start: float
) -> None:
    positions = exercise(skeleton=skeleton)
    take, mocap = recordings(positions, lag=lag, start=start, skeleton=skeleton)
    pairing = one(take, mocap)
    assert abs(pairing.clock.lag - lag) < TENTH_OF_A_FRAME
    assert np.degrees((pairing.placed.turn * TURN).magnitude()) < 0.3
    begin = max(0, int(np.ceil(-lag * 30)))
    true = positions[30 + begin :][: len(pairing.pair.take)]
    assert np.nanmax(np.linalg.norm(pairing.pair.truth - true, axis=2)) < 0.01
    assert pairing.explained > 0.95
    assert any("too short to tell whether" in note for note in pairing.notes)


@pytest.mark.parametrize("drift", [400e-6, -900e-6])
def test_a_clock_that_drifts_is_told_and_followed(medley: Array, drift: float) -> None:
    take, mocap = recordings(medley, drift=drift)
    pairing = one(take, mocap)
    assert pairing.clock.drift == pytest.approx(drift, abs=60e-6)
    assert np.abs(
        pairing.clock.at(take.time) - (0.4 + (1 + drift) * take.time)
    ).max() < (TENTH_OF_A_FRAME)
    check(pairing, take, medley)


def test_clocks_that_agree_are_told_no_drift(medley: Array) -> None:
    pairing = one(*recordings(medley))
    assert pairing.clock.drift == 0.0
    assert pairing.notes == ()


def test_gaps_leaps_and_wrong_labels_are_left_out_and_told() -> None:
    positions = exercise()
    take, mocap = recordings(positions)
    points = mocap.positions.copy()
    points[100:200, joint("KneeLeft")] = np.nan  # 1 s without the marker
    points[300:310, joint("WristLeft")] += 400.0  # a marker leaps
    points[:, joint("FootRight")] = points[:, joint("Head")]  # and one is mistaken
    points[:, joint("ElbowRight")] = np.nan  # one was never there
    seen = take.positions.copy()
    seen[120:140] += [0.9, 0.0, 0.0]  # the Kinect follows somebody else
    pairing = one(replace(take, positions=seen), replace(mocap, positions=points))
    truth, notes = pairing.pair.truth, " ".join(pairing.notes)
    missing = np.isnan(truth).any(axis=2)
    frames = np.arange(len(truth)) / 30 + 0.4  # of the mocap's clock
    assert missing[(frames > 1.02) & (frames < 1.97), joint("KneeLeft")].all()
    assert missing[(frames > 3.0) & (frames < 3.09), joint("WristLeft")].all()
    assert "lengths" in notes
    assert missing[120:140].all()
    assert "20 frames are left out" in notes
    assert missing[:, joint("FootRight")].all()
    assert "FootRight is left out" in notes
    assert "ElbowRight: not in both recordings" in notes
    assert missing[:, joint("WristRight")].mean() < 0.12


def test_dropped_and_repeated_frames_get_their_places_at_an_even_rate() -> None:
    take, mocap = recordings(exercise())
    kept = np.r_[0:50, 50, 57 : len(take)]
    time = take.time[kept]
    time[50] = time[49]
    ragged = Take(time, take.positions[kept], take.state[kept], KINECT_V1, "k")
    pair = one(ragged, mocap).pair
    rows = np.delete(np.arange(len(mocap.positions)), slice(200, 240))
    fewer = replace(mocap, positions=mocap.positions[rows], time=0.01 * rows)
    apart = np.linalg.norm(one(ragged, fewer).pair.truth - pair.truth, axis=2)
    assert np.nanmax(apart) < 0.02
    assert len(pair.take) == len(take)
    assert np.isnan(pair.take.positions[50:57]).all()
    assert np.isnan(pair.truth[50:57]).all()
    np.testing.assert_array_equal(pair.take.positions[57:], take.positions[57:])
    np.testing.assert_array_equal(pair.take.positions[:50], take.positions[:50])


# Sessions


def test_takes_of_a_session_share_transform_and_clock_offset() -> None:
    acts = [exercise(name) for name in ("tai_chi", "squat", "wave")]
    made = [recordings(act, lag=0.4 + 0.002 * k) for k, act in enumerate(acts)]
    named = [
        (replace(take, source=f"{name}.csv.gz"), mocap)
        for name, (take, mocap) in zip("abc", made, strict=True)
    ]
    pairings, refused = pair_session(named, subject="ann")
    assert refused == []
    assert [p.pair.clip for p in pairings] == ["a", "b", "c"]
    assert all(p.placed is pairings[0].placed for p in pairings)
    assert {p.clock.lag for p in pairings} == {pairings[1].clock.lag}
    assert pairings[1].clock.lag == pytest.approx(0.402, abs=TENTH_OF_A_FRAME)
    assert all("share one clock offset" in " ".join(p.notes) for p in pairings)


def test_a_take_after_which_the_sensor_was_moved_has_its_own_transform() -> None:
    acts = [exercise(name) for name in ("tai_chi", "squat", "wave")]
    shifts = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.4, 0.0, 0.0)]
    made = [
        recordings(act, lag=0.4 + 0.1 * k, shift=shift)
        for k, (act, shift) in enumerate(zip(acts, shifts, strict=True))
    ]
    pairings, _ = pair_session(made, subject="ann")
    assert [("did the sensor move" in " ".join(p.notes)) for p in pairings] == [
        *(False, False),
        True,
    ]
    for pairing, lag in zip(pairings, (0.4, 0.5, 0.6), strict=True):
        assert pairing.clock.lag == pytest.approx(lag, abs=TENTH_OF_A_FRAME)
        assert 100 * np.nanmedian(pairing.away) < 2.0


# Refusals


def test_what_does_not_belong_together_is_refused_with_the_reason() -> None:
    take, mocap = recordings(exercise())
    wave, waved = recordings(exercise("wave"))
    with pytest.raises(InputError, match=r"m\.c3d.*explains.*another movement"):
        one(take, waved)
    child = replace(mocap, positions=0.7 * mocap.positions)
    with pytest.raises(InputError, match=r"1\.43 times as long.*two people"):
        one(take, child)
    still = replace(take, positions=np.tile(take.positions[:1], (len(take), 1, 1)))
    with pytest.raises(InputError, match="does not move"):
        one(still, mocap)
    with pytest.raises(InputError, match="too short"):
        one(take, replace(mocap, positions=mocap.positions[:80]))
    armless = wave.positions.copy()
    armless[:, [joint(f"{j}Left") for j in ("Elbow", "Knee", "Hip", "Ankle")]] = np.nan
    armless[:, [joint(f"{j}Right") for j in ("Elbow", "Knee", "Hip")]] = np.nan
    with pytest.raises(InputError, match="5 joints of the limbs in common"):
        one(replace(wave, positions=armless), waved)


def test_recordings_without_a_moment_in_common_are_refused(medley: Array) -> None:
    """The take of the first 20 s, the mocap of the last 20 s."""
    take, _ = recordings(medley[:600])
    _, later = recordings(medley[-600:])
    with pytest.raises(InputError, match="another time"):
        one(take, later)


def test_takes_of_two_skeletons_or_rates_are_refused() -> None:
    take, mocap = recordings(exercise())
    slow = replace(take, time=2.0 * take.time)
    with pytest.raises(InputError, match=r"frames a second.*files of their own"):
        pair_session([(take, mocap), (slow, mocap)], subject="ann")


def test_the_command_leaves_out_what_is_refused_and_writes_nothing_without_any(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = []
    for name in ("tai_chi", "wave"):
        take, mocap = recordings(exercise(name))
        write_take_csv(take, tmp_path / f"{name}.csv")
        cm = replace(mocap, positions=mocap.positions / 10.0)
        write_trc(tmp_path / f"{name}.trc", cm)
        files.append([str(tmp_path / f"{name}.{end}") for end in ("csv", "trc")])
    (tai_chi, moved), (wave, waved) = files
    out, figures = tmp_path / "ann.npz", tmp_path / "found.json"
    wanted = ["-o", str(out), "--json", str(figures)]
    assert main(["pair", tai_chi, waved, *wanted]) == 2
    assert "explains" in capsys.readouterr().err
    assert not out.exists()
    assert not figures.exists()
    assert main(["pair", tai_chi, moved, wave, moved, *wanted]) == 1
    assert "left out" in capsys.readouterr().err
    (pair,) = read_pairs(out)
    assert (pair.subject, pair.clip) == ("ann", "tai_chi")
    found = json.loads(figures.read_text("utf-8"))
    assert found["takes"][0]["lag_s"] == pytest.approx(0.4, abs=TENTH_OF_A_FRAME)
    assert "wave.csv" in found["left_out"][0]
    for wrong in ([tai_chi], [tai_chi, moved, wave]):
        assert main(["pair", *wrong, *wanted]) == 2
    assert main(["pair", tai_chi, moved, *wanted, "--least", "7"]) == 2
    assert main(["pair", tai_chi, moved, "-o", tai_chi]) == 2


def test_a_table_of_ones_own_names_other_markers(tmp_path: Path) -> None:
    take, mocap = recordings(exercise())
    limbs = [j for j in KINECT_V1.joints if not j.startswith(("Hand", "Spine"))]
    points = mocap.positions[:, [joint(name) for name in limbs]]
    mine = Mocap(tuple(f"M{k}" for k in range(len(limbs))), points, None, 0.01, "mine")
    rows = [f'{name} = {{ at = ["M{k}"] }}' for k, name in enumerate(limbs)]
    table = write_text(tmp_path / "own.toml", "[kinect_v1]\n", "\n".join(rows))
    with pytest.raises(InputError, match=r"mine: no hips.*M0, M1.*--markers"):
        one(take, mine)
    pairing = one(take, mine, table=read_marker_set(table))
    assert pairing.clock.lag == pytest.approx(0.4, abs=TENTH_OF_A_FRAME)
    assert np.isnan(pairing.pair.truth[:, joint("Spine")]).all()


# Recordings


@paired
@pytest.mark.parametrize(
    "clip",
    [
        *("m01_s02_e05", "m02_s03_e05", "m04_s04_e05", "m07_s02_e05", "m10_s04_e05"),
        *("m01_s08_e03", "m05_s06_e05", "m09_s08_e05"),  # of people not chosen on
    ],
)
def test_recorded_pairs_are_those_that_were_made_of_them_before(clip: str) -> None:
    ms, degrees, cm, apart = compared(clip)
    assert abs(ms) < 5.0  # theirs is in steps of 10 ms
    assert degrees < 1.0
    assert cm < 1.0
    assert len(apart) == 17
    assert apart.max() < 1.5


@paired
def test_a_limb_that_the_sensor_loses_for_a_while_refuses_no_pair(
    tmp_path: Path,
) -> None:
    """The raised foot points at the sensor, which has it half a meter too low."""
    clip = RAW / "m06_s07_e05"
    files = [f"{clip}.kinect.csv", f"{clip}.markers.c3d"]
    assert main(["pair", *files, "-o", str(tmp_path / "s07.npz")]) == 0
    ms, degrees, cm, apart = compared(clip.name)
    assert abs(ms) < 33.3  # a frame: the sensor's leg disturbed their lag, or ours
    assert degrees < 2.0
    assert cm < 2.0
    assert apart.max() < 1.5


@paired
def test_a_recording_that_nobody_could_align_is_refused(tmp_path: Path) -> None:
    clip = RAW / "m08_s06_e07"
    files = [f"{clip}.kinect.csv", f"{clip}.markers.c3d"]
    assert main(["pair", *files, "-o", str(tmp_path / "o.npz")]) == 2
    take = RAW / "m01_s02_e05.kinect.csv"
    for other in ("m02_s03_e05", "m04_s04_e05", "m07_s02_e05", "m09_s08_e05"):
        markers = RAW / f"{other}.markers.c3d"
        assert (
            main(["pair", str(take), str(markers), "-o", str(tmp_path / "o.npz")]) == 2
        )
    assert not list(tmp_path.iterdir())


@paired
def test_evaluate_reads_pairs_of_a_session_and_residuals_are_drawn(
    tmp_path: Path,
) -> None:
    pytest.importorskip("matplotlib")
    files = [str(file) for file in sorted(RAW.glob("*s02*"))]
    out, picture = tmp_path / "s02.npz", tmp_path / "s02.png"
    assert main(["pair", *files, "-o", str(out), "--picture", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [pair.clip for pair in read_pairs(out)] == ["m01_s02_e05", "m07_s02_e05"]
    figures = tmp_path / "figures.json"
    arguments = ["--methods", "none", "--no-physics", "--json", str(figures)]
    assert main(["evaluate", "--test", str(out), *arguments]) == 0
    raw = json.loads(figures.read_text("utf-8"))["methods"]["raw"]
    assert 4.0 < raw["E"] < 8.0


def test_a_picture_without_matplotlib_is_refused(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    words = ["pair", "take.csv", "mocap.bvh", "-o", str(tmp_path / "pairs.npz")]
    assert main([*words, "--picture", str(tmp_path / "fit.png")]) == 2
    assert "a plot needs matplotlib" in capsys.readouterr().err
