"""One list of stages: whole, frame by frame, swapped, and behind one door."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import PAIRS, paired
from skeletons import every_skeleton
from threadpoolctl import threadpool_info, threadpool_limits

import kinefilter
from kinefilter import Avatar, CleanConfig, Cleaner, InputError, clean
from kinefilter.characters import KINECT_V1, Skeleton, Take, standard_body
from kinefilter.pipeline.correct import Correction, Corrector, Hold, Observation
from kinefilter.pipeline.correct.interface import Frames
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.lab.accuracy import Tally
from kinefilter.pipeline.lab.evaluate import evaluate
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.methods import METHODS
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.pipeline.reliability import measure_body
from kinefilter.pipeline.stages import Correct, Stage
from kinefilter.scenes.sensor import sample_take

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def take() -> Take:
    return sample_take()


def evaluated(
    pair: PairedTake, monkeypatch: pytest.MonkeyPatch, **options: Any
) -> Array:
    """Return the positions that ``evaluate --methods default`` measures."""
    found: list[Array] = []
    add = Tally.add

    def watched(
        self: Tally, pair: PairedTake, positions: Array, *more: Any, **told: bool
    ) -> None:
        found.append(positions)
        add(self, pair, positions, *more, **told)

    monkeypatch.setattr(Tally, "add", watched)
    evaluate([], [pair], ["default"], **options)
    _, positions = found  # raw, then default
    return positions


@paired
def test_evaluate_measures_what_clean_gives_to_the_last_bit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pair = read_pairs(PAIRS / "s03.npz")[7]
    expected = clean(pair.take).clip.positions
    np.testing.assert_array_equal(evaluated(pair, monkeypatch), expected)


def test_evaluate_without_physics_is_clean_without_physics(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole, some = simulate("office", "office", seed=5), slice(90)
    pair = replace(whole, take=whole.take.at(some), truth=whole.truth[some])
    plain = clean(pair.take, CleanConfig(physics=False)).clip.positions
    found = evaluated(pair, monkeypatch, physics=False)
    np.testing.assert_array_equal(found, plain)


def test_an_avatar_steps_the_same_list(take: Take) -> None:
    body = measure_body(take)
    avatar, cleaner = Avatar(body), Cleaner()
    cleaner.start(body)
    for k in range(45):
        frame = take.positions[k], float(take.time[k]), take.state[k]
        pose, draft = avatar.step(*frame), cleaner.step(*frame)
        np.testing.assert_array_equal(pose.positions, draft.positions)
        np.testing.assert_array_equal(pose.rotations, draft.rotations)
        np.testing.assert_array_equal(pose.stands, draft.stands)


def test_live_motion_is_corrected_as_measured_and_then_has_the_corrected_lengths() -> (
    None
):
    whole = simulate("basic", "walk", seed=4).take
    take, cleaner = whole.at(slice(60)), Cleaner(CleanConfig(physics=False))
    body, measured = cleaner.measure(take)
    np.testing.assert_array_equal(body.lengths, cleaner.clean(take).clip.body.lengths)
    assert np.abs(body.lengths - measured.lengths).max() > 0.02
    before = Cleaner().until("correct")
    before.start(measured)
    cleaner.start(body, measured)
    # Feet are kept above the floor after that.
    thighs = take.skeleton.sides("Knee"), take.skeleton.sides("Hip")
    for k in range(45):
        frame = take.positions[k], float(take.time[k]), take.state[k]
        draft = cleaner.step(*frame)
        np.testing.assert_array_equal(draft.standard, before.step(*frame).standard)
        knees, hips = (draft.positions[joints] for joints in thighs)
        lengths = np.linalg.norm(knees - hips, axis=1)
        np.testing.assert_allclose(lengths, body.lengths[thighs[0]], atol=1e-6)


def test_evaluate_live_steps_somebody_measured_in_the_first_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = simulate("basic", "wave", seed=5)
    pair = replace(whole, take=whole.take.at(slice(60)), truth=whole.truth[:60])
    found, take = evaluated(pair, monkeypatch, live=True), pair.take
    body, measured = Cleaner().measure(take.at(take.time <= take.time[0] + 1.0))
    avatar = Avatar(body, measured=measured)
    for k, pose in enumerate(found):
        frame = take.positions[k], float(take.time[k]), take.state[k]
        np.testing.assert_allclose(avatar.step(*frame).positions, pose)


@every_skeleton
def test_scores_and_corrections_of_takes_are_those_of_their_frames(
    skeleton: Skeleton,
) -> None:
    """What does not look ahead is the same, frame by frame or at once."""
    config = CleanConfig(method="local-pca")
    take = simulate("basic", "punch", skeleton=skeleton.name, seed=3).take
    take = take.at(slice(100))
    cleaner = Cleaner(config).without("failures", "reconstruct").until("correct")
    whole = cleaner.whole(take)
    before = cleaner.until("standardize").whole(take)
    for stage in cleaner.stages:
        stage.start(whole.body)
        for k in range(len(take) if stage.name != "measure" else 0):
            frame = Draft(
                skeleton, float(take.time[k]), take.positions[k], take.state[k]
            )
            frame.body = whole.body
            for name in ("reliability", "geometry"):
                setattr(frame, name, getattr(whole, name)[k])
            if stage.name == "correct":
                frame.standard, frame.heading = before.standard[k], before.heading.at(k)
            stage.step(frame)
            if stage.name == "correct":
                np.testing.assert_allclose(
                    frame.positions, whole.positions[k], atol=1e-9
                )
                np.testing.assert_array_equal(frame.confidence, whole.confidence[k])


class Raised(Stage):
    """Lifts every joint, by a little more in each frame."""

    name = "raised"
    adds = ("measured",)

    def start(self, body: object) -> None:  # noqa: ARG002 - any body
        self._height = 0.0

    def step(self, draft: Draft) -> None:
        self._height += 0.01
        draft.measured = draft.measured + np.array([0.0, self._height, 0.0])


def test_a_stage_that_knows_frames_alone_does_takes_too(take: Take) -> None:
    draft = Draft.of(take)
    draft.body = standard_body(KINECT_V1)
    stage = Raised()
    stage.whole(draft, lambda _, count: range(count))
    lift = (np.arange(len(take)) + 1) * 0.01
    expected = take.positions + lift[:, None, None] * [0.0, 1.0, 0.0]
    np.testing.assert_allclose(draft.measured, expected)


class Reusing(Corrector):
    """Answers every frame as measured, in one array."""

    def __init__(self) -> None:
        self._posture = standard_body(KINECT_V1).rest_positions.copy()

    def step(self, observation: Observation) -> Correction:
        self._posture[:] = observation.positions
        return Correction(self._posture, np.ones(len(self._posture)), 1.0)


def test_a_corrector_may_reuse_its_arrays(take: Take) -> None:
    scores = np.ones(take.state.shape)
    seen = Observation(take.positions, scores, scores, take.time)
    np.testing.assert_array_equal(Reusing().whole(seen).positions, take.positions)


class Still(Corrector):
    """Answers every frame with the rest posture."""

    def __init__(self) -> None:
        rest = standard_body(KINECT_V1).rest_positions
        self._rest = rest - rest[KINECT_V1.root]

    def step(self, observation: Observation) -> Correction:
        nothing = np.zeros(len(observation.positions))
        return Correction(self._rest, nothing, 1.0)


def test_a_take_is_cleaned_in_one_thread(take: Take) -> None:
    threads = set[int]()

    class Counting(Hold):
        def whole(self, take: Observation, frames: Frames = None) -> Correction:
            threads.update(x["num_threads"] for x in threadpool_info())
            return super().whole(take, frames)

    counting = Counting(take.skeleton)
    with threadpool_limits(2, "blas"):
        Cleaner(corrector=counting).until("correct").whole(take)
    assert threads == {1}


def test_another_correction_takes_the_place_of_the_named_one(take: Take) -> None:
    config = CleanConfig(physics=False)
    swapped = Cleaner(config).replaced(Correct(config, Still())).clean(take)
    given = Cleaner(config, corrector=Still()).clean(take)
    np.testing.assert_array_equal(swapped.clip.positions, given.clip.positions)
    elbow = swapped.clip.positions[:, KINECT_V1.index("ElbowRight"), 1]
    shoulder = swapped.clip.positions[:, KINECT_V1.index("ShoulderRight"), 1]
    assert np.abs(elbow - shoulder).max() < 0.05  # a T-pose throughout


@pytest.mark.parametrize(
    "changed",
    [
        lambda cleaner: cleaner.replaced(Raised()),
        lambda cleaner: cleaner.without("physics", "raised"),
        lambda cleaner: cleaner.until("raised"),
    ],
)
def test_a_stage_that_is_not_there_is_refused_by_name(changed: Any) -> None:
    with pytest.raises(InputError, match=r"unknown stage 'raised'; .*physics"):
        changed(Cleaner())


def test_without_physics_the_last_stage_is_left_out() -> None:
    names = [stage.name for stage in Cleaner().stages]
    assert len(set(names)) == len(names)
    shorter = [stage.name for stage in Cleaner(CleanConfig(physics=False)).stages]
    assert [*shorter, "physics"] == names
    assert [stage.name for stage in Cleaner().without("physics").stages] == shorter


def test_what_has_to_see_the_whole_take_is_refused_live() -> None:
    method = METHODS["butterworth"].load()(KINECT_V1)
    avatar = Avatar(standard_body(KINECT_V1), corrector=method)
    with pytest.raises(InputError, match="whole take"):
        avatar.step(standard_body(KINECT_V1).rest_positions, 0.0)


# The door


def test_every_name_that_kinefilter_gives_is_there() -> None:
    assert sorted(kinefilter.__all__) == sorted(dir(kinefilter))
    for name in kinefilter.__all__:
        assert getattr(kinefilter, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'cleaned'"):
        _ = kinefilter.cleaned


def modules_after(code: str) -> set[str]:
    """Return the modules that a new interpreter has loaded after some code."""
    code += "\nimport sys; print(*sys.modules, sep='\\n')"
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(result.stdout.split())


def test_importing_kinefilter_loads_nothing_heavy() -> None:
    loaded = modules_after("import kinefilter; kinefilter.__version__")
    assert not loaded & {"mujoco", "pxr", "sklearn", "scipy", "numpy", "plotly"}


def test_cleaning_with_defaults_needs_no_lab() -> None:
    path = Path(__file__).parents[1] / "scenes" / "takes" / "wave_punch_bend.csv"
    loaded = modules_after(
        f"import kinefilter; take = kinefilter.read_take({str(path)!r}); "
        "kinefilter.clean(take.at(slice(60)))"
    )
    lab = ("kinefilter.pipeline.lab", "kinefilter.scenes.library")
    lab += ("kinefilter.scenes.sensor",)
    assert [name for name in loaded if name.startswith(lab)] == []
