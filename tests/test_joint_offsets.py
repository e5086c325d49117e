"""Offsets that turn with the body; the default; methods in turn."""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from offset_lessons import training_set_of
from skeletons import every_skeleton

from kinefilter import CleanConfig, clean
from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    SKELETONS,
    Skeleton,
    State,
    standard_body,
)
from kinefilter.characters.rotations import about_y, rotate
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.correct import Correction, CorrectorChain, Hold, Observation
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.factory import default_corrector
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.evaluate import evaluate
from kinefilter.pipeline.lab.methods.baselines import JointOffsets
from kinefilter.pipeline.lab.simulation import simulate, simulated_pairs
from kinefilter.pipeline.lab.training import observed, training_set
from kinefilter.pipeline.progress import silent
from kinefilter.pipeline.stages import MeasureCorrectedBody
from kinefilter.scenes.library import perform

Array = NDArray[np.float64]


def _made_up(skeleton: Skeleton) -> JointOffsets:
    """Return offsets of some centimeters, drawn at random."""
    shares = 0.02 * np.random.default_rng(0).standard_normal((len(skeleton), 6))
    joints, settings = np.arange(len(skeleton)), np.array("{}")
    arrays = {"joints": joints, "shares": shares, "settings": settings}
    return JointOffsets.from_arrays(skeleton, arrays)


def _seen(posture: Array) -> Observation:
    ones = np.ones(len(posture))
    return Observation(posture, ones, ones)


@cache
def _postures(skeleton: Skeleton, motion: str = "tai_chi") -> Array:
    return perform(motion, standard_body(skeleton), seed=3).positions


def test_an_offset_along_a_segment_is_learned() -> None:
    """What always lies ahead along the forearm is taken back, in other motions too."""

    def beyond(postures: Array) -> Array:
        wrist, elbow = KINECT_V1.index("WristLeft"), KINECT_V1.index("ElbowLeft")
        forearm = postures[:, wrist] - postures[:, elbow]
        forearm /= np.linalg.norm(forearm, axis=1, keepdims=True)
        moved = postures.copy()
        moved[:, wrist] += 0.05 * forearm
        return moved

    truth, other = _postures(KINECT_V1), _postures(KINECT_V1, "wave")
    first = np.zeros(len(truth), dtype=bool)
    reliability = np.ones(truth.shape[:2])
    lessons = training_set_of(beyond(truth), reliability, truth, first)
    method = JointOffsets(KINECT_V1).fit(lessons)
    wrist = KINECT_V1.index("WristLeft")
    for wrong, right in zip(beyond(other), other, strict=True):
        made = method.step(_seen(wrong)).positions
        # Ridge leaves up to a half, and asks for less where postures tell less.
        assert np.linalg.norm(made[wrist] - right[wrist]) < 0.6 * 0.05
        made[wrist] = right[wrist]
        np.testing.assert_allclose(made, right, atol=1e-12)


@pytest.mark.parametrize("skeleton", SKELETONS.values(), ids=SKELETONS)
@settings(max_examples=20, deadline=None)
@given(st.floats(-np.pi, np.pi))
def test_offsets_turn_with_the_body(skeleton: Skeleton, angle: float) -> None:
    method, turn = _made_up(skeleton), about_y(np.array(angle))
    posture = _postures(skeleton)[40]
    there = rotate(turn, method.offsets(posture))
    np.testing.assert_allclose(method.offsets(rotate(turn, posture)), there, atol=1e-9)


def test_simulated_pairs_teach_the_same_offsets_on_both_sides() -> None:
    lessons = training_set(simulated_pairs("kinect_v1", people=51))
    method = JointOffsets(KINECT_V1).fit(lessons)
    rest = standard_body(KINECT_V1).rest_positions
    made = method.step(_seen(rest)).positions
    mirrored = made[KINECT_V1.mirror] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(made, mirrored, atol=0.015)
    assert np.linalg.norm(made - rest, axis=1).mean() > 0.01


@every_skeleton
def test_the_default_brings_simulated_strangers_nearer(skeleton: Skeleton) -> None:
    motions = ("cross_arms", "punch")
    pairs = [
        simulate("basic", motion, skeleton=skeleton.name, seed=1200 + k)
        for k, motion in enumerate(motions)
    ]
    figures = evaluate([], pairs, ["default", "local-pca"], physics=False)
    figures = figures["methods"]
    assert figures["default"]["E"] < 0.85 * figures["raw"]["E"]
    assert figures["default"]["E"] < 0.9 * figures["local-pca"]["E"]


def test_what_was_not_measured_stays_open_to_the_next_method() -> None:
    class Watch(Hold):
        def step(self, observation: Observation) -> Correction:
            self.saw = observation.positions
            return super().step(observation)

    posture = _postures(KINECT_V1)[0].copy()
    posture[KINECT_V1.index("HandLeft")] = np.nan
    watch = Watch(KINECT_V1)
    CorrectorChain(_made_up(KINECT_V1), watch).step(_seen(posture))
    np.testing.assert_array_equal(np.isnan(watch.saw), np.isnan(posture))
    assert np.nanmax(np.abs(watch.saw - posture)) > 0.01


def test_a_whole_take_is_moved_as_its_frames_are() -> None:
    """Also where joints are missing for a while."""
    postures = _postures(KINECT_V2)[:40].copy()
    postures[5:20, KINECT_V2.index("ElbowLeft")] = np.nan
    postures[13:15] = np.nan
    corrector = _made_up(KINECT_V2)
    ones = np.ones(postures.shape[:2])
    whole = corrector.whole(Observation(postures, ones, ones, np.arange(40) / 30.0))
    corrector.start()
    for k, frame in enumerate(postures):
        stepped = corrector.step(_seen(frame))
        np.testing.assert_allclose(whole.positions[k], stepped.positions, atol=1e-12)
        np.testing.assert_array_equal(whole.confidence[k], stepped.confidence)


def test_the_default_forgets_when_it_starts_again() -> None:
    corrector = default_corrector(builtin_database(KINECT_V1))
    pair = simulate("basic", "punch", sensor="v1", seed=1300)
    frames = observed(pair).standard[:20]
    runs = []
    for _ in range(2):
        corrector.start()
        runs.append([corrector.step(_seen(frame)).positions for frame in frames])
    np.testing.assert_array_equal(*runs)


def test_bones_are_measured_again_after_correction() -> None:
    """Legs that were corrected by a tenth are a tenth longer, left and right."""
    body = standard_body(KINECT_V1)
    act = perform("raise_arms", body, seed=1)
    state = np.full(act.positions.shape[:2], State.TRACKED, dtype=np.uint8)
    draft = Draft(KINECT_V1, act.time, act.positions, state)
    moved = act.positions.copy()
    shins = []
    for side in ("Left", "Right"):
        knee, ankle, foot = (
            KINECT_V1.index(part + side) for part in ("Knee", "Ankle", "Foot")
        )
        step = 0.1 * (moved[:, ankle] - moved[:, knee])
        moved[:, ankle] += step
        moved[:, foot] += step
        shins.append(ankle)
    measure = MeasureCorrectedBody(CleanConfig())
    draft.positions = moved
    measure.whole(draft, silent)
    lengths = draft.body.lengths
    np.testing.assert_allclose(lengths[shins], 1.1 * body.lengths[shins])
    draft.positions = act.positions
    measure.whole(draft, silent)
    np.testing.assert_allclose(draft.body.lengths, body.lengths, rtol=1e-6)


@pytest.mark.parametrize("more", [[], ["pairs.npz", "--simulated", "kinect_v1"]])
def test_train_wants_either_files_or_simulated_people(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    model = tmp_path / "model.npz"
    assert main(["train", *more, "-o", str(model)]) == 2
    assert "--simulated" in capsys.readouterr().err
    assert not model.exists()


def test_furnished_rooms_need_simulated_people(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model.npz"
    assert main(["train", "pairs.npz", "--furnished", "-o", str(model)]) == 2
    assert "--furnished requires --simulated" in capsys.readouterr().err
    assert not model.exists()


def test_what_a_model_made_of_a_guess_counts_for_something() -> None:
    class Watch(Hold):
        def step(self, observation: Observation) -> Correction:
            self.saw = observation
            return super().step(observation)

    posture = _postures(KINECT_V1)[0].copy()
    hand, wrist = KINECT_V1.index("HandLeft"), KINECT_V1.index("WristLeft")
    posture[hand] = np.nan
    reliability = np.ones(len(posture))
    reliability[[hand, wrist]] = 0.0
    watch = Watch(KINECT_V1)
    methods = CorrectorChain(_made_up(KINECT_V1), watch, least_reliability=0.65)
    methods.step(Observation(posture, reliability, reliability))
    expected = np.where(np.arange(len(reliability)) == wrist, 0.65, reliability)
    np.testing.assert_array_equal(watch.saw.reliability, expected)
    np.testing.assert_array_equal(watch.saw.geometry, expected)


def test_local_pca_follows_a_model_where_it_is_asked_to() -> None:
    """What a model leaves of a hidden arm, natural postures repair."""
    folder = resources.files("kinefilter.pipeline") / "embedded"
    pairs = [simulate("office", "office", sensor="v1", seed=s) for s in (1301, 1302)]
    accuracy, error = Accuracy(KINECT_V1), {}
    methods: tuple[str | None, ...] = (None, "local-pca")
    with resources.as_file(folder / "learned.npz") as path:
        for method in methods:
            config = CleanConfig(
                model=path, method=method, physics=False, reconstruct=False
            )
            error[method] = sum(
                np.nanmean(
                    accuracy.distances(clean(p.take, config).clip.positions, p.truth)
                )
                for p in pairs
            )
    assert error["local-pca"] < 0.95 * error[None]
