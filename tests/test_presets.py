"""The papers' systems by name: their constants, what they leave out, their files."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from real_data import PAIRS, paired
from short_takes import beginning

from kinefilter import CleanConfig, Cleaner, InputError, clean
from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.correct import CorrectorChain, LocalPCA
from kinefilter.pipeline.correct.posture_space import EnergyWeights
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.factory import Model, load_model, make_corrector, save_model
from kinefilter.pipeline.field_types import converted, keyword_hints
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.lab.methods.baselines import LeastEnergy
from kinefilter.pipeline.lab.methods.local_gp import LocalGP
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.lab.systems import CorrectorFactory, systems_of
from kinefilter.pipeline.lab.training import training_set
from kinefilter.pipeline.methods import LEARNED, METHODS, PRESETS, SCORERS
from kinefilter.pipeline.pairs import PairedTake, read_pairs
from kinefilter.scenes.sensor import sample_take

pytestmark = pytest.mark.usefixtures("few_for_kernels")

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def pairs() -> list[PairedTake]:
    """Return a person whom a virtual Kinect saw four times, for two seconds."""
    motions = ("wave", "squat", "cross_arms", "bend")
    found = [
        simulate("basic", motion, sensor="v1", seed=k, person=3)
        for k, motion in enumerate(motions)
    ]
    return [replace(beginning(pair), subject="ann") for pair in found]


@pytest.mark.parametrize("name", PRESETS)
def test_what_a_preset_sets_is_a_keyword_of_its_method(name: str) -> None:
    preset = PRESETS[name]
    hints = keyword_hints(METHODS[preset.method].load())
    assert preset.scoring in SCORERS
    for setting, value in preset.settings.items():
        assert converted(value, hints[setting], setting) == value


def test_the_constants_are_those_of_the_papers() -> None:
    shum = make_corrector(KINECT_V1, CleanConfig(preset="shum-2013"))
    assert isinstance(shum, LeastEnergy)
    assert (shum.neighbors, shum.dimensions) == (30, 20)
    assert (shum.search, shum.steps, shum.samples) == ("stochastic", 20, 100)
    assert shum.weights == EnergyWeights(1.0, 0.5, 1.5, 0.25)
    liu = PRESETS["liu-2016"].settings
    assert (liu["clusters"], liu["samples"], liu["blended"]) == (30, 50, 9)
    weights = (liu["spatial"], liu["temporal"], liu["reliability"])
    assert weights == (0.6, 0.2, 0.2)
    # Unlike eq. 12, see DEPARTURES.
    assert liu["votes"] == "precision"
    chiang = PRESETS["chiang-2017"]
    assert chiang.settings["centroids"] == 800
    assert chiang.settings["smallest_reliability"] == 0.7
    assert chiang.scoring == "chiang"


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_has_no_stage_that_its_paper_has_not(name: str) -> None:
    config = CleanConfig(preset=name)
    stages = [stage.name for stage in Cleaner(config).stages]
    assert not {"failures", "reconstruct"} & {*stages}
    assert ("physics" in stages) == name.startswith("shum")
    assert (config.cutoff, config.feet) == (0.0, "never")
    with_physics = CleanConfig(preset=name, set=("physics=true", "cutoff=3"))
    assert Cleaner(with_physics).stages[-1].name == "physics"
    assert replace(with_physics, seed=1).cutoff == 3.0


def test_parameters_reach_method_scorer_and_character() -> None:
    given = ("neighbors=7", "kinematics=2", "search=solver", "natural_frequency=30")
    config = CleanConfig(preset="shum-2013", set=given)
    made = make_corrector(KINECT_V1, config)
    assert isinstance(made, LeastEnergy)
    assert (made.neighbors, made.search) == (7, "solver")
    assert made.weights.kinematics == 2.0
    assert made.steps == 20
    physics = Cleaner(config).stages[-1]
    assert vars(physics)["_tracking"].natural_frequency == 30.0
    forgetful = CleanConfig(preset="shum-2013", set=("rate_frames=1",))
    take = sample_take()
    slow, quick = (
        Cleaner(c).until("reliability").whole(take).reliability
        for c in (CleanConfig(preset="shum-2013"), forgetful)
    )
    assert np.abs(np.diff(quick, axis=0)).max() > np.abs(np.diff(slow, axis=0)).max()
    ours = make_corrector(KINECT_V1, CleanConfig("local-pca", set=("neighbors=9",)))
    assert isinstance(ours, LocalPCA)
    assert ours.neighbors == 9


@pytest.mark.parametrize(
    ("preset", "given", "words"),
    [
        ("shum-2013", "clusters=3", "a parameter of preset shum-2013: neighbors"),
        ("shum-2013", "neighbors", "expected NAME=VALUE"),
        ("shum-2013", "neighbors=many", "neighbors = 'many': expected a whole number"),
        ("shum-2013", "neighbors=0", "--set neighbors=0: expected 1 to 100000"),
        ("shum-2013", "style=-1", "expected 0 to 100000"),
        ("shum-2013", "style=nan", "expected 0 to 100000"),
        ("shum-2013", "search=best", 'expected "solver", "stochastic"'),
        ("shum-2013", "feet=dance", 'expected "auto", "always", "never"'),
        ("shum-2013", "natural_frequency=0", "finite number above 0"),
        ("shum-2012", "neighbors=3", "a parameter of preset shum-2012: "),
    ],
)
def test_what_cannot_be_set_is_refused_by_name(
    preset: str, given: str, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        Cleaner(CleanConfig(preset=preset, set=(given,)))
    assert words in str(caught.value)


def test_what_no_method_can_do_with_is_refused_by_it() -> None:
    for preset, given, words in (
        ("shum-2013", "neighbors=1", "needs two or more"),
        ("wang-low-rank", "growth=0.5", "has to grow"),
    ):
        with pytest.raises(InputError, match=words):
            make_corrector(KINECT_V1, CleanConfig(preset=preset, set=(given,)))
    for share in ({"carry": 1.1}, {"spared": 2.0}):
        with pytest.raises(InputError, match="a share, from 0 to 1"):
            LocalGP(KINECT_V1, **share)


def test_what_a_preset_decides_is_not_decided_twice() -> None:
    with pytest.raises(InputError, match="decides --method"):
        CleanConfig(preset="shum-2013", method="kalman")
    with pytest.raises(InputError, match="change it with --set cutoff"):
        CleanConfig(preset="shum-2013", cutoff=3.0)
    with pytest.raises(InputError, match="needs the --preset or --method"):
        CleanConfig(set=("neighbors=3",))


def test_the_posture_of_least_energy_is_all_that_shum_gives(
    pairs: list[PairedTake],
) -> None:
    """Reliable joints move with it; without reliability, unreliable ones count."""
    given = ("search=solver", "physics=false")
    shum, blind, first = (
        Cleaner(CleanConfig(preset=name, set=given)).until("correct")
        for name in ("shum-2013", "shum-no-reliability", "shum-2013")
    )
    take = pairs[0].take
    positions = shum.whole(take).positions
    assert np.nanmax(np.abs(positions - take.positions)) > 0.02
    np.testing.assert_array_equal(first.whole(take).positions, positions)
    assert np.abs(blind.whole(take).positions - positions).max() > 0.005


@pytest.fixture(scope="module")
def model(pairs: list[PairedTake], tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = CleanConfig(preset="liu-2016", set=("clusters=3", "samples=20"))
    lessons = training_set(pairs, config)
    method = LocalGP(KINECT_V1, **config.parameters.method).fit(lessons)
    path = tmp_path_factory.mktemp("models") / "liu.npz"
    save_model(Model(method, "local-gp", KINECT_V1, "ann", "liu-2016"), path)
    return path


def test_a_model_keeps_what_it_was_taught_with(
    model: Path, pairs: list[PairedTake]
) -> None:
    config = partial(CleanConfig, preset="liu-2016", model=model)
    made = make_corrector(KINECT_V1, config())
    assert isinstance(made, LocalGP)
    assert (made.clusters, made.trend, made.temporal) == (3, False, 0.2)
    other = make_corrector(KINECT_V1, config(set=("temporal=0", "clusters=3")))
    assert isinstance(other, LocalGP)
    assert other.temporal == 0.0
    with pytest.raises(InputError, match="trained with clusters=3, not 9; train"):
        make_corrector(KINECT_V1, config(set=("clusters=9",)))
    with pytest.raises(InputError, match="not a model of preset zhou-2014"):
        make_corrector(KINECT_V1, CleanConfig(preset="zhou-2014", model=model))
    assert clean(pairs[1].take, config()).trace is None


@pytest.mark.parametrize("words", ["[3", "7", '{"carry": "x"}', '{"carry": 9}'])
def test_damaged_settings_of_a_model_are_refused(
    model: Path, tmp_path: Path, words: str
) -> None:
    with np.load(model) as file:
        arrays = dict(file)
    np.savez(tmp_path / "m.npz", **arrays | {"fitted_settings": np.array(words)})
    with pytest.raises(InputError, match=r"m\.npz: a damaged or outdated model"):
        load_model(tmp_path / "m.npz")


def test_a_trend_that_is_off_says_nothing(model: Path) -> None:
    made = make_corrector(KINECT_V1, CleanConfig(preset="liu-2016", model=model))
    assert isinstance(made, LocalGP)
    assert not made.slopes_.any()


def test_systems_are_named_as_they_were_asked_for() -> None:
    found = systems_of(
        ["none", "learned+local-pca", "local-pca:neighbors=9"],
        ["all:physics=false", "liu-2016:clusters=50"],
        ["neighbors=8"],
    )
    assert [system.label for system in found] == [
        *("none", "learned+local-pca", "local-pca:neighbors=9"),
        *(f"{name}:physics=false" for name in PRESETS),
        "liu-2016:clusters=50",
    ]
    by_label = {system.label: system.config for system in found}
    own, shum = by_label["local-pca:neighbors=9"], by_label["shum-2013:physics=false"]
    assert own.parameters.method["neighbors"] == 9
    assert shum.parameters.method["neighbors"] == 8
    assert not shum.physics
    for methods, presets, given, words in (
        (["nobody"], [], [], "unknown method 'nobody'"),
        ([], ["nobody"], [], "unknown preset 'nobody'"),
        (["none"], [], ["clusters=3"], "none of none has such a parameter"),
    ):
        with pytest.raises(InputError, match=words):
            systems_of(methods, presets, given)


def test_what_learns_is_taught_once_for_its_terms(pairs: list[PairedTake]) -> None:
    small = "clusters=3:samples=20"
    first, second = systems_of(
        [], [f"liu-2016:{small}", f"liu-2016:{small}:temporal=0"]
    )
    school = CorrectorFactory(
        pairs, KINECT_V1, people=False, database=builtin_database(KINECT_V1)
    )
    whole, part = school.corrector(first), school.corrector(second)
    assert isinstance(whole, LocalGP)
    assert isinstance(part, LocalGP)
    assert len(school._learned) == 1
    np.testing.assert_array_equal(whole.features_, part.features_)
    assert (whole.temporal, part.temporal) == (0.2, 0.0)
    (both,) = systems_of(["joint-offsets+local-pca"])
    assert isinstance(school.corrector(both), CorrectorChain)


def test_chiangs_reliability_gates_its_own_training(pairs: list[PairedTake]) -> None:
    shums = training_set(pairs)
    chiangs = training_set(pairs, CleanConfig(preset="chiang-2017"))
    assert not np.array_equal(shums.reliability, chiangs.reliability)
    draft = Cleaner(CleanConfig(preset="chiang-2017")).until("reliability")
    found = draft.whole(pairs[0].take).reliability
    np.testing.assert_array_equal(chiangs.reliability[: len(found)], found)


@paired
def test_presets_train_clean_and_are_evaluated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = tmp_path / "few.npz"
    _write_some(PAIRS / "s02.npz", few)
    model, take = tmp_path / "m.npz", tmp_path / "take.csv"
    write_take_csv(read_pairs(few)[0].take, take)
    teach = ["train", str(few), "--preset", "liu-2016", "--set", "clusters=4"]
    assert main([*teach, "-o", str(model)]) == 0
    use = ["clean", str(take), "--preset", "liu-2016", "--model", str(model)]
    assert main([*use, "-o", str(tmp_path / "clip.npz")]) == 0
    assert "liu-2016, local-gp, trained on" in capsys.readouterr().out
    asked = ["--presets", "liu-2016,liu-2016:temporal=0", "--set", "clusters=4"]
    given = ["--train", str(few), "--test", str(few)]
    assert main(["evaluate", *given, *asked, "--every", "2"]) == 0
    shown = capsys.readouterr().out
    assert "2 clips, protocol people" in shown
    assert "liu-2016:temporal=0" in shown
    assert main(["train", str(few), "--preset", "shum-2013", "-o", str(model)]) == 2
    assert "does not learn from pairs" in capsys.readouterr().err


def _write_some(source: Path, path: Path) -> None:
    """Write the first two seconds of the first clips of a pairs file."""
    with np.load(source) as file:
        arrays = dict(file)
    for name in ("clip", "start", "stop"):
        arrays[name] = arrays[name][:3]
    arrays["stop"] = arrays["start"] + 60
    stop = int(arrays["stop"].max())
    for name in ("kinect", "mocap"):
        arrays[name] = arrays[name][:stop]
    np.savez(path, **arrays)
    assert len(read_pairs(path)) == 3


@pytest.mark.parametrize("name", [name for name in LEARNED if name != "learned"])
def test_what_is_adjustable_is_a_keyword(name: str) -> None:
    made = LEARNED[name].load()(KINECT_V1)
    assert {*made.settings} == {*keyword_hints(LEARNED[name].load())}
    assert {*made.adjustable} <= {*made.settings}
