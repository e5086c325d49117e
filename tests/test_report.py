"""``kinefilter report``: what its page holds, what fails, what it refuses."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable
from dataclasses import fields, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import MakeClip
from numpy.typing import NDArray

from kinefilter import CleanConfig, clean
from kinefilter.characters import KINECT_V1, KINECT_V2, Clip, InputError, Skeleton, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import (
    read_clip,
    read_take,
    write_clip,
    write_take_csv,
)
from kinefilter.pipeline.look.comparison import compare, read_comparison
from kinefilter.pipeline.look.page import parse_limit, write_report
from kinefilter.pipeline.metrics import METRICS, distances
from kinefilter.pipeline.target.floor import leveled
from kinefilter.scenes import SAMPLE

Pair = tuple[Clip, Take]
MakePair = Callable[..., Pair]


@pytest.fixture(scope="session")
def make_pair(make_clip: MakeClip) -> MakePair:
    """Return a maker of clips with the takes they were made of."""

    def make(
        frames: int = 40,
        skeleton: Skeleton = KINECT_V1,
        *,
        tilt: float = 0.0,
        floor: float = -0.8,
    ) -> Pair:
        clip, rng = make_clip(frames, skeleton), np.random.default_rng(1)
        raw = clip.positions + rng.normal(scale=0.05, size=clip.positions.shape)
        raw[frames // 2, 3] = np.nan
        state = np.where(np.isnan(raw[..., 0]), 0, clip.state).astype(np.uint8)
        clip = replace(
            clip,
            state=state,
            moved_by_correction=distances(clip.positions, raw),
            moved_by_physics=np.zeros(raw.shape[:2]),
            deciding_term=clip.deciding_term % 4,
            tilt=tilt,
            floor=floor,
        )
        positions = leveled(raw + np.array([0.0, floor, 0.0]), -tilt)
        return clip, Take(clip.time, positions, clip.state, skeleton, "made up")

    return make


@pytest.fixture
def files(make_pair: MakePair, tmp_path: Path) -> list[str]:
    """Return the arguments of a report of a made-up clip."""
    clip, take = make_pair()
    write_clip(clip, tmp_path / "clip.npz")
    write_take_csv(take, tmp_path / "take.csv")
    return [
        *("report", str(tmp_path / "clip.npz"), "--take", str(tmp_path / "take.csv")),
        *("-o", str(tmp_path / "report.html")),
    ]


class _Page(HTMLParser):
    """The elements of a page, and the text in those with an id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.data = self.title = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        tag, attributes = self.tags[-1] if self.tags else ("", {})
        if attributes.get("id") == "data" and not self.data:
            self.data = data
        if tag == "title":
            self.title += data.rstrip("\n")


def _contents(path: Path) -> dict[str, Any]:
    found = json.loads(_Page(path.read_text(encoding="utf-8")).data)
    assert isinstance(found, dict)
    return found


def _numbers(array: dict[str, str], kind: str) -> NDArray[Any]:
    return np.frombuffer(base64.b64decode(array[kind]), f"<{kind}")


def test_a_page_holds_the_arrays_of_clip_and_take(
    make_pair: MakePair, tmp_path: Path
) -> None:
    clip, take = make_pair(tilt=0.1)
    write_report(compare(clip, take), tmp_path / "report.html")
    found = _contents(tmp_path / "report.html")
    assert found["joints"] == list(KINECT_V1.joints)
    shape = clip.positions.shape
    positions = _numbers(found["clean"], "i2").reshape(shape) / 1e3
    np.testing.assert_allclose(positions, clip.positions, atol=6e-4)
    missing = np.isnan(take.positions[..., 0])
    raw = _numbers(found["raw"], "i2").reshape(shape)
    assert (raw[missing] == -(2**15)).all()
    np.testing.assert_allclose(
        distances(positions, raw / 1e3)[~missing],
        clip.moved_by_correction[~missing],
        atol=3e-3,
    )
    np.testing.assert_allclose(
        _numbers(found["reliability"], "u1") / 100.0,
        clip.reliability.ravel(),
        atol=0.006,
    )
    for name, array in (("origin", clip.origin), ("term", clip.deciding_term)):
        np.testing.assert_array_equal(_numbers(found[name], "u1"), array.ravel())
    contacts = _numbers(found["contacts"], "u1")
    np.testing.assert_array_equal(contacts, clip.contacts.ravel())


@pytest.mark.parametrize("tilt", [0.0, -0.25])
def test_the_take_is_where_cleaning_put_it(make_pair: MakePair, tilt: float) -> None:
    clip, take = make_pair(tilt=tilt, floor=-1.1)
    raw = compare(clip, take).raw
    expected = leveled(take.positions, tilt) - [0.0, -1.1, 0.0]
    np.testing.assert_allclose(raw, expected, atol=1e-12)


def test_exchanged_sides_leave_the_take_where_it_is(make_pair: MakePair) -> None:
    clip, take = make_pair(tilt=0.1)
    exchanged = take.positions.copy()
    exchanged[:8] = exchanged[:8, KINECT_V1.mirror]
    raw = compare(clip, replace(take, positions=exchanged)).raw
    expected = leveled(exchanged, 0.1) - [0.0, -0.8, 0.0]
    np.testing.assert_allclose(raw, expected, atol=1e-12)


def test_repeated_time_stamps_count_once(make_pair: MakePair) -> None:
    clip, take = make_pair()
    twice = np.repeat(np.arange(40), 2)
    arrays = {
        field.name: getattr(clip, field.name)[twice]
        for field in fields(clip)
        if isinstance(getattr(clip, field.name), np.ndarray)
    }
    again = Take(
        *(take.time[twice], take.positions[twice], take.state[twice]), take.skeleton
    )
    once, found = compare(clip, take), compare(replace(clip, **arrays), again)
    assert found.before == pytest.approx(once.before, rel=1e-9, nan_ok=True)
    assert found.after == pytest.approx(once.after, rel=1e-9, nan_ok=True)


def test_metrics_and_damage_are_those_that_clean_printed() -> None:
    take = read_take(SAMPLE)
    positions = take.positions.copy()
    positions[100:200, take.skeleton.index("AnkleRight")] += [0.12, 0.08, 0.0]
    take = replace(take, positions=positions)
    result = clean(take)
    found = compare(result.clip, take)
    for figures, stage in ((found.before, "raw"), (found.after, "physics")):
        for name in METRICS.keys() - {"skate"}:
            expected = getattr(result.stages[stage], name)
            assert figures[name] == pytest.approx(expected, nan_ok=True), name
    assert found.damage == result.damage != ()
    assert found.after["jitter"] < 0.2 * found.before["jitter"]
    assert found.after["skate"] == 1e-3 * found.after["skate_mm_per_frame"]


@pytest.mark.parametrize("suffix", [".usdc", ".bvh", ".csv"])
def test_clips_of_other_kinds_have_nearly_the_metrics_of_the_whole_clip(
    suffix: str, tmp_path: Path
) -> None:
    take = read_take(SAMPLE)
    clip = clean(take, CleanConfig(physics=False)).clip
    write_clip(clip, tmp_path / f"clip{suffix}")
    found = read_comparison(tmp_path / f"clip{suffix}", SAMPLE)
    expected = compare(clip, take)
    for name in ("jitter", "peak_hand_speed", "moved_cm"):
        assert found.after[name] == pytest.approx(expected.after[name], rel=0.1)
    write_report(found, tmp_path / "report.html")
    rates = _numbers(_contents(tmp_path / "report.html")["reliability"], "u1")
    assert rates.max() <= 100


def test_unknown_reliability_is_marked_on_the_page(
    make_pair: MakePair, tmp_path: Path
) -> None:
    clip, take = make_pair()
    unknown = replace(clip, reliability=np.full(clip.state.shape, np.nan))
    write_report(compare(unknown, take), tmp_path / "report.html")
    rates = _numbers(_contents(tmp_path / "report.html")["reliability"], "u1")
    assert (rates == 255).all()


def test_curves_are_the_derivatives_of_closed_forms(make_pair: MakePair) -> None:
    from kinefilter.pipeline.look.page import page_contents

    clip, _ = make_pair(60)
    still = clip.at(np.zeros(60, dtype=int))
    still = replace(still, time=clip.time)
    moved = replace(still, root=still.root + [0.0, 0.0, 2.0] * clip.time[:, None] ** 3)
    pair = replace(compare(*make_pair(60)), clip=moved, raw=still.positions)
    speed, jitter = page_contents(pair, ())["curves"]
    third = _numbers(jitter["clean"], "f4")
    np.testing.assert_allclose(third[np.isfinite(third)], 12.0, rtol=1e-4)
    first = _numbers(speed["clean"], "f4")
    np.testing.assert_allclose(first[30], 6.0 * clip.time[30] ** 2, rtol=0.05)
    assert np.nanmax(_numbers(jitter["raw"], "f4")) == 0.0
    # A difference of three steps is that of the second of its four frames.
    assert np.flatnonzero(np.isnan(third)).tolist() == [0, 58, 59]
    assert np.flatnonzero(np.isnan(first)).tolist() == [59]


def test_the_page_of_five_minutes_is_under_15_mb(
    make_pair: MakePair, tmp_path: Path
) -> None:
    path = tmp_path / "report.html"
    write_report(compare(*make_pair(9000, KINECT_V2)), path)
    assert path.stat().st_size < 15e6


def test_clean_writes_the_page_that_report_writes(tmp_path: Path) -> None:
    clip, pages = str(tmp_path / "clip.npz"), [tmp_path / f"{k}.html" for k in (1, 2)]
    sample = str(SAMPLE)
    assert main(["clean", sample, "-o", clip, "--report", str(pages[0])]) == 0
    assert main(["report", clip, "--take", sample, "-o", str(pages[1])]) == 0
    assert pages[0].read_bytes() == pages[1].read_bytes()
    assert main(["clean", sample, "-o", clip, "--report", clip]) == 2


def test_a_page_refers_to_nothing_elsewhere(files: list[str]) -> None:
    assert main(files) == 0
    text = Path(files[-1]).read_text(encoding="utf-8")
    for tag, attributes in _Page(text).tags:
        assert tag not in ("img", "iframe", "object", "embed")
        assert "src" not in attributes
        assert (attributes.get("href") or "data:,") == "data:,"
    assert not re.search(r"https?://|@import|url\(", text)


def test_names_from_files_are_text_and_no_markup(
    make_pair: MakePair, tmp_path: Path
) -> None:
    name = "</script><script>alert(1)</script><!--<b>&amp;$data${js}$$\u2028\ud800"
    clip, take = make_pair()
    path = tmp_path / "report.html"
    write_report(compare(replace(clip, source="plain"), take), path)
    plain = _Page(path.read_text(encoding="utf-8"))
    write_report(compare(replace(clip, source=name), take), path)
    found = _Page(path.read_text(encoding="utf-8"))
    assert found.tags == plain.tags
    assert json.loads(found.data)["source"] == name
    assert found.title == f"kinefilter: {name}".replace("\ud800", "?")


def test_a_metric_beyond_a_limit_fails() -> None:
    figures = dict.fromkeys(METRICS, 1.0) | {"flight_error": float("nan")}
    assert parse_limit("skate > 0.5").fails(figures)
    assert parse_limit("skate<1.5").fails(figures)
    assert not parse_limit("skate>1").fails(figures)
    assert not parse_limit("flight_error>0").fails(figures)  # nobody flew
    assert str(parse_limit(" skate >3e-3")) == "skate>0.003"


@pytest.mark.parametrize(
    "text",
    ["", "skate", "skate>", "skat>1", "skate>x", "skate>nan", "skate>=1", "9" * 5000],
)
def test_a_malformed_limit_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"skate>0\.003|no number") as refused:
        parse_limit(text)
    assert len(str(refused.value)) < 500


def test_fail_on_gives_exit_code_1_and_the_page(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    page = Path(files[-1])
    assert main([*files, "--fail-on", "moved_cm>100"]) == 0
    page.unlink()
    gates = ["--fail-on", "moved_cm>100", "--fail-on", "jitter>0.001"]
    assert main([*files, *gates]) == 1
    printed = capsys.readouterr().err
    assert "jitter>0.001: it is " in printed
    assert printed.endswith(" (jitter, m/s³)\n")
    assert "moved_cm" not in printed
    metrics = {metric["name"]: metric for metric in _contents(page)["metrics"]}
    assert {"text": "> 0.001", "fails": True} in metrics["jitter"]["limits"]
    assert {"text": "> 100", "fails": False} in metrics["moved_cm"]["limits"]


def test_a_limit_on_what_cannot_be_measured_does_not_pass_in_silence(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*files, "--fail-on", "flight_error>5"]) == 0
    assert "flight_error>5 not checked" in capsys.readouterr().err
    clip = Path(files[1]).with_suffix(".bvh")
    write_clip(read_clip(files[1]), clip)
    files[1] = str(clip)
    wrong = _refused([*files, "--fail-on", "float_mm>20"], capsys)
    assert "which .bvh does not hold; give the clip as .npz" in wrong


def test_a_given_limit_replaces_the_pages_own(files: list[str]) -> None:
    assert main([*files, "--fail-on", "jitter>0.001"]) == 1
    metrics = {m["name"]: m["limits"] for m in _contents(Path(files[-1]))["metrics"]}
    assert metrics["jitter"] == [{"text": "> 0.001", "fails": True}]
    assert [limit["text"] for limit in metrics["skate"]] == ["> 0.003"]


def _refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Assert exit code 2, one line of error and an old page kept; return the line."""
    page = Path(arguments[arguments.index("-o") + 1])
    kept = page.parent.is_dir() and page.suffix == ".html"
    if kept:
        page.write_text("old", encoding="utf-8")
    assert main(arguments) == 2
    if kept:
        assert page.read_text(encoding="utf-8") == "old"
        assert not list(page.parent.glob(".*.html"))
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    return printed


def test_what_does_not_belong_together_is_refused(
    make_pair: MakePair, files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    take_path = Path(files[3])
    clip, take = make_pair()
    short = make_pair(39)[1]
    other = make_pair(40, KINECT_V2)[1]
    late = replace(take, time=take.time + 1.0)
    away = replace(take, positions=take.positions * 1.5)
    for wrong, message in (
        (short, "40 frames, the take 39"),
        (other, "kinect_v1, the take kinect_v2"),
        (late, "time stamps"),
        (away, "most joints of the take are not where"),
    ):
        write_take_csv(wrong, take_path)
        assert message in _refused(files, capsys)
    assert compare(clip, take).clip is clip


@pytest.mark.parametrize(
    ("at", "word", "message"),
    [
        (1, "clip.bvh", "clip.bvh"),
        (1, "none.npz", "no such file"),
        (1, "take.csv", "raw take"),
        (3, "clip.npz", ""),
        (3, "none.csv", "no such file"),
        (5, "report.txt", "must end in .html"),
        (5, "clip.npz/report.html", "folder"),
    ],
)
def test_files_that_do_not_fit_are_refused(
    files: list[str],
    capsys: pytest.CaptureFixture[str],
    at: int,
    word: str,
    message: str,
) -> None:
    folder = Path(files[-1]).parent
    (folder / "clip.bvh").write_text("HIERARCHY", encoding="utf-8")
    files[at] = str(folder / word)
    assert message in _refused(files, capsys)


def test_numbers_that_are_no_places_are_refused(make_pair: MakePair) -> None:
    clip, take = make_pair()
    for array in ("root", "reliability"):
        values = getattr(clip, array).copy()
        values[3, 0] = np.nan
        with pytest.raises(InputError, match="not finite"):
            compare(replace(clip, **{array: values}), take)
    with pytest.raises(InputError, match="clip has joints over 10000 m"):
        compare(replace(clip, root=clip.root + 1e200), take)
    with pytest.raises(InputError, match="take has joints over 10000 m"):
        compare(clip, replace(take, positions=take.positions * 1e200))
