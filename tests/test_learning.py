"""Learning from pairs: reading them, the learned corrector, its files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from real_data import PAIRS, paired

from kinefilter import CleanConfig, PostureDatabase, clean
from kinefilter.characters import (
    KINECT_V1,
    KINECT_V2,
    InputError,
    State,
    Take,
    standard_body,
)
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.correct import Observation
from kinefilter.pipeline.correct.fourier_ridge import FourierRidge
from kinefilter.pipeline.factory import Model, load_model, save_model
from kinefilter.pipeline.lab import training
from kinefilter.pipeline.lab.accuracy import Accuracy
from kinefilter.pipeline.lab.evaluate import evaluate
from kinefilter.pipeline.lab.methods.fourier_ridge_learner import FourierRidgeLearner
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.methods.training_data import TrainingSet
from kinefilter.pipeline.lab.training import observed, standard_truth, training_set
from kinefilter.pipeline.methods import LEARNED
from kinefilter.pipeline.metrics import distances, jitter
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.scenes.library import perform

pytestmark = pytest.mark.usefixtures("few_for_kernels")

Array = NDArray[np.float64]
BIAS = {
    "WristLeft": [0.0, 0.06, 0.0],
    "WristRight": [0.0, 0.06, 0.0],
    "KneeLeft": [-0.05, 0.0, -0.03],
    "KneeRight": [0.05, 0.0, -0.03],
}
"""What the imagined sensor gets wrong, always and on both sides [m]."""


def _pair(subject: str, motion: str, repetition: int, height: float) -> PairedTake:
    """Return a performance and how a sensor with a constant bias would see it."""
    body = standard_body(KINECT_V1, height=height)
    act = perform(motion, body, seed=repetition)
    rng = np.random.default_rng(repetition)
    seen = act.positions[:90] + 0.004 * rng.standard_normal((90, len(KINECT_V1), 3))
    for joint, bias in BIAS.items():
        seen[:, KINECT_V1.index(joint)] += bias
    state = np.full(seen.shape[:2], State.TRACKED, dtype=np.uint8)
    clip = f"m01_{subject}_e{repetition:02d}"
    take = Take(act.time[:90], seen, state, KINECT_V1, clip)
    return PairedTake(take, act.positions[:90], subject, clip)


@pytest.fixture(scope="module")
def pairs() -> list[PairedTake]:
    return [
        _pair(subject, motion, repetition, height)
        for subject, height in (("s01", 1.6), ("s02", 1.7), ("s03", 1.8))
        for motion in ("squat", "raise_arms")
        for repetition in (2, 5, 8)
    ]


@pytest.fixture(autouse=True)
def _only_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulating people takes longer than what is tested here."""
    monkeypatch.setattr(training, "_SIMULATED", 0)


@pytest.fixture(scope="module")
def model(pairs: list[PairedTake]) -> FourierRidge:
    return FourierRidgeLearner(KINECT_V1, samples=256).fit(training_set(pairs[::3]))


@pytest.fixture(scope="module")
def lessons(pairs: list[PairedTake]) -> TrainingSet:
    """Return what one person teaches."""
    return training_set(pairs[:6:2])


@pytest.fixture(scope="module")
def local(lessons: TrainingSet) -> LocalGP:
    return LocalGP(KINECT_V1, clusters=5, samples=20).fit(lessons)


def _save_pairs(pairs: list[PairedTake], path: Path, **changes: Any) -> None:
    lengths = [len(pair.take) for pair in pairs]
    stop = np.cumsum(lengths)
    arrays: dict[str, Any] = {
        "joints": np.array(KINECT_V1.joints),
        "fps": np.float32(30.0),
        "subject": np.array(pairs[0].subject),
        "kinect": np.concatenate([pair.take.positions for pair in pairs]),
        "mocap": np.concatenate([pair.truth for pair in pairs]),
        "clip": np.array([pair.clip for pair in pairs]),
        "start": stop - lengths,
        "stop": stop,
    }
    np.savez(path, **{**arrays, **changes})


def test_pairs_come_back_from_their_file(
    pairs: list[PairedTake], tmp_path: Path
) -> None:
    _save_pairs(pairs[:3], tmp_path / "p.npz")
    again = read_pairs(tmp_path / "p.npz")
    assert [pair.clip for pair in again] == [pair.clip for pair in pairs[:3]]
    for one, two in zip(pairs, again, strict=False):
        np.testing.assert_array_equal(one.take.positions, two.take.positions)
        np.testing.assert_array_equal(one.truth, two.truth)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mocap": np.full((5, 20, 3), 1e300)}, "mocap has a joint 1e.300 m away"),
        ({"mocap": np.zeros((5, 20, 3))}, "both need the same frames"),
        ({"joints": np.array(["a"] * 20)}, "not a known skeleton"),
        ({"stop": np.array([10_000] * 3)}, "clip .* is rows"),
    ],
)
def test_pairs_whose_sides_differ_are_refused(
    pairs: list[PairedTake], tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    _save_pairs(pairs[:3], tmp_path / "p.npz", **changes)
    with pytest.raises(InputError, match=message):
        read_pairs(tmp_path / "p.npz")


def test_a_file_that_is_no_pairs_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("hello")
    np.savez(tmp_path / "other.npz", kinect=np.zeros(3))
    for name in ("text.npz", "other.npz", "absent.npz"):
        with pytest.raises(InputError, match=name):
            read_pairs(tmp_path / name)


def test_training_pairs_share_the_hips_and_the_scale(pairs: list[PairedTake]) -> None:
    lessons = training_set(pairs[:2])
    hips = [KINECT_V1.index("HipLeft"), KINECT_V1.index("HipRight")]
    np.testing.assert_allclose(
        lessons.truth[:, hips].mean(axis=1),
        lessons.positions[:, hips].mean(axis=1),
        atol=2e-3,
    )
    away = np.linalg.norm(lessons.truth - lessons.positions, axis=2).mean(axis=0)
    biased = [KINECT_V1.index(joint) for joint in BIAS]
    assert away[biased].min() > 2 * np.delete(away, biased).max()
    assert lessons.first.sum() == 2


def test_a_constant_bias_is_learned_also_for_strangers(pairs: list[PairedTake]) -> None:
    figures = evaluate(pairs[::3], [], ["learned"], physics=False)["methods"]
    assert figures["learned"]["E"] < 0.5 * figures["raw"]["E"]
    assert figures["learned"]["joints"]["WristLeft"] < 3.0
    assert figures["raw"]["joints"]["WristLeft"] > 5.0


def test_reliability_is_measured_against_the_truth(pairs: list[PairedTake]) -> None:
    """Half of the frames of one clip have an arm torn off, and everything knows."""
    pair = pairs[0]
    positions = pair.take.positions.copy()
    positions[::2, KINECT_V1.index("WristLeft")] += [0.0, 0.0, 0.5]
    torn = Take(pair.take.time, positions, pair.take.state, KINECT_V1, "torn")
    tested = [PairedTake(torn, pair.truth, "s09", "m01_s09_e01")]
    areas = evaluate(pairs[:1], tested, ["none"], physics=False)["reliability_auc"]
    for scores in areas.values():
        assert scores["over_10_cm"] > 0.8


def test_known_people_are_corrected_better(pairs: list[PairedTake]) -> None:
    two = pairs[:12]
    figures = evaluate(two, [], ["learned"], protocol="repetitions", physics=False)
    known = figures["methods"]
    assert known["learned"]["E"] < 0.9 * known["raw"]["E"]
    assert known["learned"]["people"].keys() == {"s01", "s02"}


def test_a_model_file_gives_the_same_corrections(
    model: FourierRidge, pairs: list[PairedTake], tmp_path: Path
) -> None:
    save_model(Model(model, "learned", KINECT_V1, "three people"), tmp_path / "m.npz")
    again = load_model(tmp_path / "m.npz")
    assert (again.method, again.skeleton, again.source) == (
        "learned",
        KINECT_V1,
        "three people",
    )
    ones = np.ones(len(KINECT_V1))
    posture = pairs[0].take.positions[3] - pairs[0].take.positions[3, 0]
    model.start()
    seen = Observation(posture, ones, ones)
    np.testing.assert_array_equal(
        model.step(seen).positions, again.corrector.step(seen).positions
    )


def test_clean_with_a_model_uses_its_method(
    model: FourierRidge, pairs: list[PairedTake], tmp_path: Path
) -> None:
    save_model(Model(model, "learned", KINECT_V1, "three people"), tmp_path / "m.npz")
    take, truth = pairs[4].take, pairs[4].truth
    accuracy = Accuracy(KINECT_V1)
    error = {
        name: accuracy.distances(clean(take, config).clip.positions, truth).mean()
        for name, config in {
            "model": CleanConfig(model=tmp_path / "m.npz"),
            "none": CleanConfig(method="none"),
        }.items()
    }
    assert error["model"] < 0.7 * error["none"]


@pytest.mark.parametrize("method", list(LEARNED))
def test_every_learned_method_trains_saves_and_cleans(
    method: str, lessons: TrainingSet, pairs: list[PairedTake], tmp_path: Path
) -> None:
    load = FourierRidgeLearner if method == "learned" else LEARNED[method].load()
    learner = load(KINECT_V1).fit(lessons)
    path = tmp_path / "m.npz"
    save_model(Model(learner, method, KINECT_V1, lessons.source), path)
    take, truth = pairs[4].take, pairs[4].truth
    result = clean(take, CleanConfig(model=path))
    accuracy = Accuracy(KINECT_V1)
    corrected = accuracy.distances(result.clip.positions, truth).mean()
    assert corrected < 0.9 * accuracy.distances(take.positions, truth).mean()
    assert result.stages["physics"].bone_length_cv < 1e-6


def test_models_that_do_not_fit_are_refused(
    model: FourierRidge, pairs: list[PairedTake], tmp_path: Path
) -> None:
    path = tmp_path / "m.npz"
    save_model(Model(model, "learned", KINECT_V1, "x"), path)
    take = pairs[0].take
    other = perform("wave", standard_body(KINECT_V2), seed=1)
    state = np.full(other.positions.shape[:2], 2, dtype=np.uint8)
    v2 = Take(other.time, other.positions, state, KINECT_V2)
    with pytest.raises(InputError, match="kinect_v1, but the take is kinect_v2"):
        clean(v2, CleanConfig(model=path))
    with pytest.raises(InputError, match="omit --method, or"):
        clean(take, CleanConfig(model=path, method="kalman"))
    with pytest.raises(InputError, match="give a --model"):
        clean(take, CleanConfig(method="learned"))
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(tmp_path / "newer.npz", **{**arrays, "version": np.array(99)})
    arrays.pop("fitted_weights")
    np.savez(tmp_path / "damaged.npz", **arrays)
    (tmp_path / "text.npz").write_text("no model")
    for name in ("newer.npz", "damaged.npz", "text.npz", "absent.npz"):
        with pytest.raises(InputError, match=name):
            load_model(tmp_path / name)


def test_too_few_frames_are_refused(pairs: list[PairedTake]) -> None:
    with pytest.raises(InputError, match="too few"):
        FourierRidgeLearner(KINECT_V1).fit(training_set(pairs[:1]))
    with pytest.raises(InputError, match="no clips"):
        training_set([])


def test_evaluation_needs_people_or_repetitions(pairs: list[PairedTake]) -> None:
    alone = [pair for pair in pairs if pair.subject == "s01"]
    with pytest.raises(InputError, match="two or more"):
        evaluate(alone, [], ["none"])
    early = [pair for pair in pairs if "e08" not in pair.clip]
    with pytest.raises(InputError, match="e08"):
        evaluate(early, [], ["none"], protocol="repetitions")
    with pytest.raises(InputError, match="unknown method 'magic'"):
        evaluate(pairs, [], ["magic"])
    with pytest.raises(InputError, match=r"learned learns: give pairs .* --train"):
        evaluate([], pairs, ["learned"])
    take = Take(np.arange(9) / 30, np.ones((9, 25, 3)), np.ones((9, 25)), KINECT_V2)
    other = PairedTake(take, take.positions, "s09", "m01")
    with pytest.raises(InputError, match="; give pairs of one skeleton"):
        evaluate(pairs, [other], ["none"])


def test_train_and_evaluate_run_from_the_command_line(
    pairs: list[PairedTake], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = []
    for subject in ("s01", "s02"):
        files.append(str(tmp_path / f"{subject}.npz"))
        own = [pair for pair in pairs if pair.subject == subject][::3]
        _save_pairs(own, Path(files[-1]))
    model = tmp_path / "model.npz"
    assert main(["train", *files, "-o", str(model)]) == 0
    assert load_model(model).source == "4 clips of s01, s02"
    figures = tmp_path / "figures.json"
    arguments = ["evaluate", "--train", *files, "--no-physics"]
    arguments += ["--methods", "none,learned"]
    assert main([*arguments, "--json", str(figures)]) == 0
    assert figures.exists()
    assert "E_var" in capsys.readouterr().out


def test_the_mocap_of_pairs_makes_a_database(
    pairs: list[PairedTake], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "pairs.npz", tmp_path / "mocap.npz"
    _save_pairs([pair for pair in pairs if pair.subject == "s01"], file)
    assert main(["database", "build", str(file), "-o", str(out)]) == 0
    database = PostureDatabase.load(out)
    assert database.recorded
    # The mocap of imagined pairs is what the scripts do: on the standard body again.
    act = perform("squat", standard_body(KINECT_V1), seed=2)
    posture = act.positions[30] - act.positions[30, KINECT_V1.root]
    nearest = np.sqrt(database.neighbors(posture, np.full(20, 1 / 20), 1)[1][0])
    assert nearest < 0.03
    for wrong, message in (
        ([str(file), "clip.bvh"], "not both"),
        ([str(file), "--skeleton", "kinect_v2"], "add --skeleton kinect_v1"),
    ):
        again = tmp_path / "again.npz"
        assert main(["database", "build", *wrong, "-o", str(again)]) == 2
        assert message in capsys.readouterr().err
        assert not again.exists()


def test_methods_are_measured_without_their_parts(pairs: list[PairedTake]) -> None:
    small = "local-gp:clusters=3:samples=20"
    methods = [
        "local-pca",
        small,
        "nearest",
        "no-reliability",
        f"{small}:temporal=0:reliability=0",
        f"{small}:reliability=0",
        f"{small}:temporal=0",
    ]
    figures = evaluate(pairs[:3], pairs[6:7], methods, physics=False)["methods"]
    assert list(figures) == ["raw", *methods]


def test_the_temporal_term_calms_and_the_reliability_term_holds_back(
    pairs: list[PairedTake], local: LocalGP
) -> None:
    """In what local-gp itself makes: the smoother calms every clip."""
    draft = observed(pairs[12])
    seen = Observation(draft.standard, draft.reliability, draft.geometry, draft.time)
    spatial, calm, held = (
        local.adjusted(**terms).whole(seen).positions
        for terms in (
            {"temporal": 0.0, "reliability": 0.0},
            {"reliability": 0.0},
            {"temporal": 0.0},
        )
    )
    assert jitter(draft.time, calm) < 0.95 * jitter(draft.time, spatial)
    truth = standard_truth(pairs[12], draft)
    raw = draft.standard
    sure = draft.reliability >= 0.9  # others are held before their offset is told
    assert distances(held, raw)[sure].mean() < distances(spatial, raw)[sure].mean()
    for made in (spatial, held):
        assert distances(made, truth).mean() < 0.9 * distances(raw, truth).mean()


def test_only_local_gp_learns_on(
    pairs: list[PairedTake], model: FourierRidge, local: LocalGP, tmp_path: Path
) -> None:
    for name, corrector in (("learned", model), ("local-gp", local)):
        found = Model(corrector, name, KINECT_V1, "imagined")
        save_model(found, tmp_path / f"{name}.npz")
    take = pairs[0].take
    adapting = CleanConfig(model=tmp_path / "local-gp.npz", adapt=True, physics=False)
    still = CleanConfig(model=tmp_path / "local-gp.npz", physics=False)
    apart = clean(take, adapting).clip.positions - clean(take, still).clip.positions
    assert 0.0 < np.abs(apart).max() < 0.05
    with pytest.raises(InputError, match="model of method learned cannot --adapt"):
        clean(take, CleanConfig(model=tmp_path / "learned.npz", adapt=True))
    with pytest.raises(InputError, match="--adapt needs a --model"):
        clean(take, CleanConfig(adapt=True))


@paired
def test_what_is_learned_beats_the_filters_on_real_strangers() -> None:
    others = ("s02", "s04", "s08")
    train = [p for s in others for p in read_pairs(PAIRS / f"{s}.npz")[::48]]
    test = read_pairs(PAIRS / "s06.npz")[::40]
    methods = ["learned", "butterworth"]
    figures = evaluate(train, test, methods, physics=False)["methods"]
    assert figures["learned"]["E_std"] < 0.9 * figures["raw"]["E_std"]
    assert figures["learned"]["E_var"] < 0.95 * figures["raw"]["E_var"]
    assert figures["learned"]["E_std"] < figures["butterworth"]["E_std"]
