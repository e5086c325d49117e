"""What somebody says of a take: joints that are wrong, sides that are exchanged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V2, InputError, Origin, Take
from kinefilter.pipeline.cleaner import CleanResult
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.edits import LIMBS, read_edits
from kinefilter.pipeline.formats import write_take_csv
from kinefilter.pipeline.lab.simulate import simulate
from kinefilter.pipeline.pairs import PairedTake

ARM = [
    KINECT_V2.index(joint) for joint in LIMBS["right-arm"] if joint in KINECT_V2.joints
]
BEGIN, END = 2.0, 3.0


@pytest.fixture(scope="module")
def pair() -> PairedTake:
    return simulate("basic", "wave", seed=5)


def edited(folder: Path, text: str) -> Path:
    path = folder / "take.edits.toml"
    path.write_text(text, encoding="utf-8")
    return path


def table(kind: str, begin: float = BEGIN, end: float = END, joints: str = "") -> str:
    named = f"joints = [{joints}]\n" if joints else ""
    return f"[[{kind}]]\n{named}begin = {begin}\nend = {end}\n"


def cleaned(take: Take, edits: Path | None = None) -> CleanResult:
    return clean(take, CleanConfig(physics=False, edits=edits))


def during(take: Take, around: float = 0.0) -> NDArray[np.bool_]:
    since = take.time - take.time[0]
    return np.asarray((since >= BEGIN - around) & (since <= END + around))


def test_a_limb_that_is_distrusted_goes_on_as_if_it_were_hidden(
    pair: PairedTake, tmp_path: Path
) -> None:
    take, inside = pair.take, during(pair.take)
    wrong = take.positions.copy()
    wrong[np.ix_(inside, ARM)] += [0.2, -0.1, 0.15]
    wrong = replace(take, positions=wrong)
    told = table("distrust", joints='"right-arm"')
    found = cleaned(wrong, edited(tmp_path, told))
    gone = take.positions.copy()
    gone[np.ix_(inside, ARM)] = np.nan
    hidden = cleaned(replace(take, positions=gone))
    np.testing.assert_array_equal(found.clip.positions, hidden.clip.positions)
    assert (found.clip.origin[np.ix_(inside, ARM)] == Origin.FILLED).all()
    assert "edited: right-arm distrusted from 2 to 3 s" in found.notes

    def error(result: CleanResult) -> float:
        away = result.clip.positions - result.clip.root[:, None]
        truth = pair.truth - pair.truth[:, :1]
        return float(np.linalg.norm((away - truth)[inside][:, ARM], axis=-1).mean())

    assert error(found) < 0.7 * error(cleaned(wrong))


def test_little_else_moves(pair: PairedTake, tmp_path: Path) -> None:
    told = table("distrust", joints='"right-arm"')
    found = cleaned(pair.take, edited(tmp_path, told)).clip
    before = cleaned(pair.take).clip
    moved = np.linalg.norm(found.positions - before.positions, axis=-1)
    others = np.delete(moved, ARM, axis=1)
    assert moved[during(pair.take)][:, ARM].max() > 4 * others.max()
    assert moved[~during(pair.take, around=0.5)].max() < 0.01


def test_sides_are_put_back_before_joints_are_named(
    pair: PairedTake, tmp_path: Path
) -> None:
    told = table("distrust", joints='"right-arm"')
    wanted = cleaned(pair.take, edited(tmp_path, told)).clip
    wrong = pair.take.exchanged(during(pair.take))
    found = cleaned(wrong, edited(tmp_path, told + table("exchange"))).clip
    np.testing.assert_array_equal(found.positions, wanted.positions)


def test_sides_that_are_exchanged_are_put_back(
    pair: PairedTake, tmp_path: Path
) -> None:
    wrong = pair.take.exchanged(during(pair.take))
    found = cleaned(wrong, edited(tmp_path, table("exchange")))
    np.testing.assert_array_equal(
        found.clip.positions, cleaned(pair.take).clip.positions
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no edits"),
        ("distrust = 3", "unknown 'distrust'"),
        (table("pin"), "unknown 'pin'"),
        (table("distrust"), "expected begin, end, joints"),
        (table("exchange", joints='"Head"'), "expected begin, end"),
        (table("distrust", joints="3"), "expected a list of names"),
        ("[[distrust]]\njoints = []\nbegin = 0\nend = 1", "no joints"),
        ("[[exchange]]\nbegin = 0\nend = nan", "seconds after the first frame"),
        ("[[exchange]]\nbegin = true\nend = 2", "seconds after the first frame"),
        (table("exchange", 3.0, 2.0), "the end after the beginning"),
        (table("exchange", -1.0, 2.0), "the end after the beginning"),
        ("[[distrust]", "not TOML"),
    ],
)
def test_a_file_that_says_nothing_of_the_kind_is_refused(
    tmp_path: Path, text: str, told: str
) -> None:
    with pytest.raises(InputError, match="edits") as caught:
        read_edits(edited(tmp_path, text))
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (table("distrust", joints='"RightArm"'), "unknown joint 'RightArm'; known: "),
        (table("exchange", 99.0, 100.0), "no frame from 99 to 100 s; the take is"),
        (
            table("distrust", 0.0, 1e6, ", ".join(f'"{j}"' for j in KINECT_V2.joints)),
            "distrusts every joint",
        ),
    ],
)
def test_edits_that_a_take_does_not_fit_are_refused_and_nothing_is_written(
    pair: PairedTake,
    tmp_path: Path,
    text: str,
    told: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    take, edits = tmp_path / "take.csv", edited(tmp_path, text)
    write_take_csv(pair.take, take)
    words = ["clean", str(take), "-o", str(tmp_path / "clip.npz")]
    assert main([*words, "--edits", str(edits)]) == 2
    assert told in capsys.readouterr().err.replace("\n", " ")
    assert sorted(p.name for p in tmp_path.iterdir()) == [take.name, edits.name]
