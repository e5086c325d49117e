"""``kinefilter rate`` and ``ratings``: what raters see, and what their answers say."""

from __future__ import annotations

import base64
import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser
from conftest import MakeClip
from scipy import stats

from kinefilter.characters import KINECT_V2, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_clip, write_take_csv
from kinefilter.pipeline.lab.rating import planned
from kinefilter.pipeline.lab.ratings import (
    Key,
    Sheet,
    friedman,
    holm,
    summarize,
    wilcoxon,
)
from kinefilter.pipeline.target.floor import leveled
from kinefilter.scenes.library import perform

FLOOR = -0.8  # m, of the sensor's frame


@pytest.fixture
def folders(make_clip: MakeClip, tmp_path: Path) -> Path:
    """Return a folder of two systems and a sensor, with two motions each."""
    for name in ("oldway", "newway", "rawtakes"):
        (tmp_path / name / "day").mkdir(parents=True)
    for motion, act in (("squatting", "squat"), ("day/waving", "wave")):
        body = make_clip(1).body
        clip = make_clip(time=(moved := perform(act, body, seed=1)).time)
        # What the clip takes for the floor is where the feet of the take are not.
        clip = replace(
            clip,
            root=moved.root,
            rotations=moved.rotations,
            tilt=0.1,
            floor=FLOOR - 0.12,
        )
        write_clip(clip, tmp_path / "newway" / f"{motion}.npz")
        write_clip(clip, tmp_path / "oldway" / f"{motion}.bvh")
        raw = leveled(clip.positions + np.array([0.0, FLOOR, 0.0]), -0.1)
        state = np.full(raw.shape[:2], 2, dtype=np.uint8)
        state[10, 3] = 0
        take = Take(clip.time + 7.0, raw, state, clip.skeleton)
        write_take_csv(take, tmp_path / "rawtakes" / f"{motion}.csv")
    (tmp_path / "newway" / "manifest.csv").write_text("take,status\n")
    return tmp_path


def _rate(folder: Path, *more: str, out: str = "page.html") -> int:
    systems = [str(folder / name) for name in ("oldway", "newway", "rawtakes")]
    return main(["rate", *systems, "-o", str(folder / out), *more])


def _contents(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = json.loads(text.split('id="data">')[1].split("</script>")[0])
    assert isinstance(found, dict)
    return found


def _key(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "page.key.json").read_text(encoding="utf-8"))
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize("systems", [2, 3, 4, 5])
@pytest.mark.parametrize("motions", [1, 2, 3])
@pytest.mark.parametrize("repeats", [0, 1, 2])
def test_sides_are_balanced_and_every_two_systems_meet_in_every_motion(
    systems: int, motions: int, repeats: int
) -> None:
    for seed in range(20):
        plan = planned(systems, motions, single=False, repeats=repeats, seed=seed)
        pairs = motions * systems * (systems - 1) // 2
        assert len(plan) == pairs + min(pairs, repeats)
        once = plan[:pairs]
        met = Counter(frozenset(trial) for trial in once)
        assert set(met.values()) == {1}
        assert len(met) == pairs
        assert {trial[::-1] for trial in plan[len(once) :]} <= set(once)
        assert all(left[0] == right[0] for left, right in plan)
        lead = Counter(left for (_, left), _ in plan)
        lead.subtract(right for _, (_, right) in plan)
        assert set(lead.values()) <= {-1, 0, 1}
        of_two = Counter((left, right) for (_, left), (_, right) in once)
        for a, b in product(range(systems), repeat=2):
            assert abs(of_two[a, b] - of_two[b, a]) <= 1


def test_the_seed_shuffles_and_one_at_a_time_shows_each_clip_once() -> None:
    options = {"single": True, "repeats": 1}
    plans = [planned(3, 4, **options, seed=seed) for seed in (0, 0, 1)]
    assert plans[0] == plans[1] != plans[2]
    assert len(plans[0]) == 13
    assert plans[0][-1] == plans[0][0]
    assert set(plans[0]) == {((m, s),) for m in range(4) for s in range(3)}


def test_the_page_names_nothing_and_holds_what_the_key_says(folders: Path) -> None:
    assert _rate(folders, "--seed", "5") == 0
    text = (folders / "page.html").read_text(encoding="utf-8")
    for name in ("oldway", "newway", "rawtakes", "squatting", "waving", str(folders)):
        assert name not in text
    assert not re.search(r"""https?:|src=|url\(|\bimport\b|fetch\(""", text)
    page, key = _contents(folders / "page.html"), _key(folders)
    assert page["seed"] == 5
    assert page["page"] == key["page"]
    assert page["trials"] == key["trials"]
    assert len(page["trials"]) == 2 * 3 + 2
    assert sorted(key["motions"]) == ["day/waving", "squatting"]
    places: dict[tuple[str, str], Any] = {}
    for clip, told in zip(page["clips"], key["clips"], strict=True):
        data = np.frombuffer(base64.b64decode(clip["positions"]), "<i2")
        places[told["motion"], told["system"]] = data.reshape(-1, 3)
        assert told["motion"] == key["motions"][clip["motion"]]
    for motion in key["motions"]:
        clean, bvh, raw = (places[motion, s] for s in ("newway", "oldway", "rawtakes"))
        assert np.ptp(clean[:, 1]) > 1000
        np.testing.assert_allclose(bvh, clean, atol=2)
        missing = raw[:, 0] == -(2**15)
        assert missing.sum() == 1
        np.testing.assert_allclose(raw[~missing], clean[~missing], atol=15)
    pairs = {frozenset(key["clips"][k]["motion"] for k in t) for t in key["trials"]}
    assert all(len(pair) == 1 for pair in pairs)


def test_the_same_seed_makes_the_same_page_and_another_one_another(
    folders: Path,
) -> None:
    for seed, name in (("1", "a"), ("1", "b"), ("2", "c")):
        assert _rate(folders, "--seed", seed, out=f"{name}.html") == 0
    for kind, part in (("html", None), ("key.json", "clips")):
        texts = [(folders / f"{n}.{kind}").read_text(encoding="utf-8") for n in "abc"]
        a, b, c = (json.loads(t)[part] if part else t for t in texts)
        assert a == b != c


def test_motions_that_some_system_lacks_are_left_out_and_told(
    folders: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folders / "rawtakes" / "squatting.csv").unlink()
    assert _rate(folders) == 0
    told = capsys.readouterr().out
    assert "oldway: left out 1 that others lack" in told
    assert "1 motions, 5 trials" in told


def test_two_files_are_the_same_motion_whatever_they_are_called(folders: Path) -> None:
    clip, take = folders / "newway/squatting.npz", folders / "rawtakes/squatting.csv"
    (folders / "a=b.csv").write_bytes(take.read_bytes())
    words = [str(clip), f"raw={take}", str(folders / "a=b.csv")]
    page = str(folders / "page.html")
    assert main(["rate", *words, "-o", page, "--reference", str(clip)]) == 0
    assert _key(folders)["systems"] == ["squatting", "raw", "a=b"]
    contents = _contents(folders / "page.html")
    assert "accurate" in contents["question"]
    assert contents["motions"][0]["reference"]["positions"] in [
        clip["positions"] for clip in contents["clips"]
    ]


def _shortened(folder: Path) -> None:
    path = folder / "rawtakes" / "squatting.csv"
    rows = path.read_text().splitlines()
    path.write_text("\n".join(rows[: len(rows) // 2]))


def _of_another_skeleton(folder: Path) -> None:
    state = np.full((90, len(KINECT_V2)), 2, dtype=np.uint8)
    places = np.random.default_rng(0).normal(size=(*state.shape, 3))
    take = Take(np.arange(90) / 10, places, state, KINECT_V2)
    write_take_csv(take, folder / "rawtakes" / "squatting.csv")


def _damaged(folder: Path) -> None:
    (folder / "newway" / "squatting.npz").write_text("x")


def _twice(folder: Path) -> None:
    (folder / "newway" / "squatting.csv").write_text("x")


@pytest.mark.parametrize(
    ("change", "words", "message"),
    [
        (None, "--seed -1", "--seed -1"),
        (None, "--repeats -1", "--repeats -1"),
        (None, "-o page.txt", r"\.html"),
        (None, "newway=rawtakes", "a second system newway"),
        (None, "name=", "NAME=PATH"),
        (None, "absent", "absent"),
        (None, "empty", "no .* file in this folder"),
        (None, "--reference absent", "absent"),
        (_shortened, "", "lasts .* the same motion"),
        (_of_another_skeleton, "", "other joints"),
        (_damaged, "", r"squatting\.npz"),
        (_twice, "", "the same motion as"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    folders: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[Path], None] | None,
    words: str,
    message: str,
) -> None:
    monkeypatch.chdir(folders)
    Path("empty").mkdir()
    if change is not None:
        change(folders)
    before = sorted(folders.rglob("*"))
    page = [] if "-o" in words else ["-o", "page.html"]
    systems = ["oldway", "newway", "rawtakes"]
    assert main(["rate", *systems, *words.split(), *page]) == 2
    told = capsys.readouterr().err
    assert re.search(message, told), told
    assert told.count("\n") == 1
    assert sorted(folders.rglob("*")) == before


def test_systems_without_a_common_motion_or_clip_or_alone_are_refused(
    folders: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = ["-o", str(folders / "page.html")]
    takes, clips = folders / "rawtakes", folders / "newway"
    assert main(["rate", f"{takes}/squatting.csv", str(takes / "day"), *page]) == 2
    assert "nowhere near y = 0" in capsys.readouterr().err
    assert main(["rate", f"{takes / 'day'}", str(clips), *page]) == 2
    assert "no motion is in every system" in capsys.readouterr().err
    assert main(["rate", str(clips), *page]) == 2
    assert "two systems" in capsys.readouterr().err
    assert not (folders / "page.html").exists()


# Answers: three systems, one motion, one at a time or in pairs


ONE = Key("p", ["A", "B", "C"], ["m"], [(0, 0), (1, 0), (2, 0)], [(0,), (1,), (2,)])
GRADES = np.array([[3, 5, 8], [4, 4, 7], [2, 6, 9], [5, 6, 6], [1, 4, 7], [3, 8, 9]])


def _sheets(grades: Any) -> list[Sheet]:
    return [
        Sheet(f"r{n}", [((k,), (int(grade),)) for k, grade in enumerate(row)])
        for n, row in enumerate(grades)
    ]


def test_means_and_intervals_are_those_of_scipy() -> None:
    found = summarize(_sheets(GRADES), ONE)
    for column, name in zip(GRADES.T, "ABC", strict=True):
        row = found["systems"][name]
        assert row["mean"] == pytest.approx(column.mean())
        assert row["sd"] == pytest.approx(stats.tstd(column))
        interval = stats.ttest_1samp(column, 0).confidence_interval(0.95)
        assert row["ci95"] == pytest.approx([interval.low, interval.high])
        assert np.isnan(row["preferred"])
        assert row["motions"] == {"m": pytest.approx(column.mean())}
    pair = found["pairs"][1]
    assert pair["systems"] == ["A", "C"]
    related = stats.ttest_rel(GRADES[:, 0], GRADES[:, 2]).confidence_interval(0.95)
    assert pair["ci95"] == pytest.approx([related.low, related.high])
    assert pair["mean"] == pytest.approx((GRADES[:, 0] - GRADES[:, 2]).mean())


def test_signed_ranks_are_counted_out() -> None:
    differences = np.array([1.0, -2.0, 3.5, 4.0, 5.0, 6.5, 7.0])
    ranks = np.arange(1, 8)
    sums = [
        sum(r for r, s in zip(ranks, way, strict=True) if s)
        for way in product((0, 1), repeat=7)
    ]
    least = 2  # the rank of the only negative one
    expected = 2 * np.mean([total <= least for total in sums])
    assert wilcoxon(differences) == pytest.approx(expected)
    assert wilcoxon(np.zeros(4)) == 1.0


def test_friedmans_test_is_that_of_its_formula() -> None:
    ranks = stats.rankdata(GRADES, axis=1)
    n, k = ranks.shape
    total = 12 / (n * k * (k + 1)) * (ranks.sum(axis=0) ** 2).sum() - 3 * n * (k + 1)
    ties = sum(
        count**3 - count
        for row in ranks
        for count in np.unique(row, return_counts=True)[1]
    )
    total /= 1 - ties / (n * k * (k**2 - 1))
    p = stats.chi2.sf(total, k - 1)
    assert friedman(GRADES) == pytest.approx(p)
    assert summarize(_sheets(GRADES), ONE)["p_friedman"] == pytest.approx(p)
    assert friedman(np.ones((4, 3))) == 1.0
    assert np.isnan(friedman(GRADES[:, :2]))
    assert np.isnan(friedman(GRADES[:1]))


def test_holms_correction_steps_down() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    assert holm([0.2]) == [0.2]
    found = summarize(_sheets(GRADES), ONE)
    single = [pair["p"] for pair in found["pairs"]]
    assert [pair["p_holm"] for pair in found["pairs"]] == pytest.approx(holm(single))


def test_one_rater_has_means_but_no_intervals() -> None:
    found = summarize(_sheets(GRADES[:1]), ONE)
    assert found["systems"]["C"]["mean"] == 8
    assert np.isnan(found["systems"]["C"]["ci95"]).all()
    assert {pair["p"] for pair in found["pairs"]} == {1.0}


def test_pairs_say_who_is_preferred_and_who_contradicts_themselves() -> None:
    key = Key(
        "p",
        ["A", "B"],
        ["m", "n"],
        [(0, 0), (1, 0), (1, 1), (0, 1)],
        [(0, 1), (2, 3), (0, 1)],
    )
    sheets = [
        Sheet("sure", [((0, 1), (3, 7)), ((2, 3), (6, 6)), ((1, 0), (7, 3))]),
        Sheet("unsure", [((1, 0), (4, 2)), ((3, 2), (1, 9)), ((0, 1), (5, 1))]),
        Sheet("lazy", [((1, 0), (5, 5)), ((3, 2), (5, 5)), ((0, 1), (5, 5))]),
    ]
    found = summarize(sheets, key)
    assert found["systems"]["A"]["preferred"] == pytest.approx((1 + 4 / 2) / 9)
    assert found["systems"]["B"]["preferred"] == pytest.approx((4 + 4 / 2) / 9)
    (pair,) = found["pairs"]
    assert (pair["better"], pair["equal"]) == ([1, 4], 4)
    # A: of 3 and 3 as one, with 6; of 2 and 5 with 1; 5.
    assert found["systems"]["A"]["mean"] == pytest.approx(np.mean([4.5, 2.25, 5]))
    sure, unsure, lazy = (found["raters"][sheet.rater] for sheet in sheets)
    assert (sure["twice"], sure["reversed"], sure["apart"]) == (1, 0, 0)
    assert (unsure["twice"], unsure["reversed"], unsure["apart"]) == (1, 1, 3)
    assert lazy["same_grade"]
    assert not unsure["same_grade"]


def _answers(key: dict[str, Any], rater: str, best: str) -> dict[str, Any]:
    """Return the answers of somebody who knows better."""
    rows = [
        {
            "shown": trial[::-1],
            "grades": [
                8 if key["clips"][k]["system"] == best else 3 for k in trial[::-1]
            ],
        }
        for trial in key["trials"]
    ]
    return {"page": key["page"], "rater": rater, "answers": rows}


@pytest.fixture
def answered(folders: Path) -> Path:
    """Return a folder of systems, a page, its key, and the answers of two raters."""
    assert _rate(folders) == 0
    (folders / "answers").mkdir()
    for rater in ("Zoë", "bob"):
        text = json.dumps(_answers(_key(folders), rater, "newway"))
        (folders / "answers" / f"{rater}.json").write_text(text)
    return folders


def _ratings(folder: Path, *more: str) -> int:
    key, out = str(folder / "page.key.json"), str(folder / "figures.json")
    return main(
        ["ratings", str(folder / "answers"), "--key", key, "--json", out, *more]
    )


def test_ratings_prints_and_writes_what_raters_said(
    answered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _ratings(answered) == 0
    told = capsys.readouterr().out
    for words in ("newway", "8.00", "100 %", "2 raters", "Friedman"):
        assert words in told
    found = json.loads((answered / "figures.json").read_text(encoding="utf-8"))
    means = {name: row["mean"] for name, row in found["systems"].items()}
    assert means == {"oldway": 3, "newway": 8, "rawtakes": 3}
    assert set(found["raters"]) == {"Zoë", "bob"}


def _first(found: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    rows = [found["answers"][0] | change, *found["answers"][1:]]
    return found | {"answers": rows}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda k: k | {"page": "another"}, r"of page 'another'.*key is of page"),
        (lambda _: {}, "of no page"),
        (lambda k: k | {"rater": "Zoë"}, "second file of rater 'Zoë'"),
        (lambda k: k | {"rater": " "}, "answers of a rater"),
        (lambda k: k | {"answers": k["answers"][1:]}, "not the 8 answers"),
        (lambda k: _first(k, {"shown": [0, 99]}), "not the 8 answers"),
        (lambda k: _first(k, {"shown": ["0", None]}), "damaged"),
        (lambda k: _first(k, {"grades": [3, None]}), "answer 1 .*ask the rater"),
        (lambda k: _first(k, {"grades": [3, 10]}), "answer 1 .*from 1 to 9"),
        (lambda k: _first(k, {"grades": [3, True]}), "answer 1"),
        (lambda k: _first(k, {"grades": [3]}), "answer 1"),
        (lambda k: k | {"answers": [3]}, "damaged"),
        (lambda _: [1], "not JSON of"),
    ],
)
def test_wrong_answers_are_refused(
    answered: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[Any], Any],
    message: str,
) -> None:
    right = _answers(_key(answered), "zed", "newway")
    text = json.dumps(change(right))
    (answered / "answers" / "zed.json").write_text(text)
    assert _ratings(answered) == 2
    told = capsys.readouterr().err
    assert re.search(message, told), told
    assert "zed.json" in told
    assert not (answered / "figures.json").exists()


def test_without_answers_or_key_nothing_is_told(
    answered: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _ratings(answered, "--key", str(answered / "answers" / "bob.json")) == 2
    assert "not the key of a page" in capsys.readouterr().err
    key = str(answered / "page.key.json")
    assert main(["ratings", key, "--key", key]) == 2
    assert "no answers given" in capsys.readouterr().err
    assert _ratings(answered, "--json", key) == 2
    assert "overwrite" in capsys.readouterr().err


# The page in a browser


_PRESS = (
    "for (const key of arguments[0]) document.body.dispatchEvent("
    "new KeyboardEvent('keydown', { key, bubbles: true, cancelable: true }))"
)
_START = (
    "document.getElementById('rater').value = arguments[0];"
    "document.getElementById('start').requestSubmit()"
)
_SAVED = (  # what would be downloaded
    "return new Promise((done) => {"
    "URL.createObjectURL = (blob) => { blob.text().then(done); return 'data:,'; };"
    "document.getElementById('save').click(); })"
)


def _text(browser: Browser, name: str) -> str:
    return str(browser.run(f"return document.getElementById('{name}').textContent"))


def test_a_rater_grades_reloads_goes_back_and_saves(
    browser: Browser, folders: Path
) -> None:
    page = folders / "page.html"
    assert _rate(folders) == 0
    browser.open(page)
    seen = browser.run("return document.body.innerText")
    assert "8 steps" in seen
    browser.run(_START, "Zoë")
    assert _text(browser, "count") == "1 of 8"
    picture = "return document.querySelectorAll('canvas')[arguments[0]].toDataURL()"
    browser.run("seek(0)")
    start = browser.run(picture, 1)
    browser.run("seek(1)")
    assert browser.run(picture, 1) != start
    browser.run(_PRESS, ["Enter"])  # before both are graded
    assert _text(browser, "count") == "1 of 8"
    browser.run(_PRESS, ["7", "4", "Enter", "6", "5", "a", "9", "Enter"])
    assert _text(browser, "count") == "3 of 8"
    browser.open(page)
    browser.run(_START, "Zoë")
    assert _text(browser, "count") == "3 of 8"
    browser.run(_PRESS, ["Backspace", "b", "2", "Enter"])
    browser.run(_PRESS, ["1", "3", "Enter"] * 6)
    assert browser.run("return document.getElementById('end').hidden") is False
    saved = json.loads(browser.run(_SAVED))
    assert [answer["grades"] for answer in saved["answers"]] == [
        [7, 4],
        [9, 2],
        *[[1, 3]] * 6,
    ]
    assert [sorted(answer["shown"]) for answer in saved["answers"]] in (
        [sorted(trial) for trial in order]
        for order in (_key(folders)["trials"], _key(folders)["trials"][::-1])
    )
    (folders / "answers.json").write_text(json.dumps(saved), encoding="utf-8")
    key = str(folders / "page.key.json")
    assert main(["ratings", str(folders / "answers.json"), "--key", key]) == 0
    assert browser.console() == []
    assert set(browser.requests()) <= {page.as_uri(), "data:,"}


def test_raters_differ_in_sides_and_order_and_do_not_see_each_others_answers(
    browser: Browser, folders: Path
) -> None:
    page = folders / "page.html"
    assert _rate(folders) == 0
    browser.open(page)
    trials = _key(folders)["trials"]
    orders = [browser.run("return orderFor(arguments[0])", f"r{k}") for k in range(40)]
    ways = [
        [trial[::side] for trial in trials][::time]
        for side, time in product((1, -1), repeat=2)
    ]
    counts = [orders.count(way) for way in ways]
    assert sum(counts) == 40
    assert min(counts) >= 4
    browser.run(_START, "one")
    browser.run(_PRESS, ["7", "4", "Enter"])
    browser.open(page)
    browser.run(_START, "two")
    assert _text(browser, "count") == "1 of 8"


def test_with_a_reference_the_person_is_seen_beside_one_clip(
    browser: Browser, folders: Path
) -> None:
    assert _rate(folders, "--single", "--reference", str(folders / "newway")) == 0
    browser.open(folders / "page.html")
    browser.run(_START, "ann")
    titles = "return [...document.querySelectorAll('.pane h3')].map(e => e.textContent)"
    assert browser.run(titles) == ["What the person did", "The figure"]
    browser.run(_PRESS, ["b", "7", "Enter"] * 8)
    saved = json.loads(browser.run(_SAVED))
    assert [answer["grades"] for answer in saved["answers"]] == [[7]] * 8
    assert browser.console() == []
