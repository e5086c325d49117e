"""``kinefilter rate``: the page on which people grade clips, in a browser too."""

from __future__ import annotations

import base64
import json
import re
import shutil
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

from kinefilter.characters import KINECT_V2, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import write_clip, write_take_csv
from kinefilter.pipeline.lab.rating import planned
from kinefilter.pipeline.target.floor import leveled
from kinefilter.scenes.library import perform

FLOOR = -0.8  # m, of the sensor's frame


@pytest.fixture
def folders(written: Path, tmp_path: Path) -> Path:
    """Return a copy of a folder of two systems and a sensor, with two motions each."""
    shutil.copytree(written, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture(scope="module")
def written(make_clip: MakeClip, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("written")
    for name in ("oldway", "newway", "rawtakes"):
        (folder / name / "day").mkdir(parents=True)
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
        write_clip(clip, folder / "newway" / f"{motion}.npz")
        write_clip(clip, folder / "oldway" / f"{motion}.bvh")
        raw = leveled(clip.positions + np.array([0.0, FLOOR, 0.0]), -0.1)
        state = np.full(raw.shape[:2], 2, dtype=np.uint8)
        state[10, 3] = 0
        take = Take(clip.time + 7.0, raw, state, clip.skeleton)
        write_take_csv(take, folder / "rawtakes" / f"{motion}.csv")
    (folder / "newway" / "manifest.csv").write_text("take,status\n")
    return folder


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
        data = np.frombuffer(base64.b64decode(clip["positions"]["i2"]), "<i2")
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
    assert "oldway: left out 1 motion that other systems lack" in told
    assert "1 motion, 5 trials" in told


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
        (None, "newway=rawtakes", "another system is also called .newway"),
        (None, "name=", "NAME=PATH"),
        (None, "absent", "absent: there is no such file"),
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


def _opened(browser: Browser, folders: Path, *options: str) -> Path:
    page = folders / "page.html"
    assert _rate(folders, *options) == 0
    browser.open(page)
    return page


def _text(browser: Browser, name: str) -> str:
    return str(browser.run(f"return document.getElementById('{name}').textContent"))


def test_a_rater_grades_reloads_goes_back_and_saves(
    browser: Browser, folders: Path
) -> None:
    page = _opened(browser, folders)
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
    page = _opened(browser, folders)
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
    _opened(browser, folders, "--single", "--reference", str(folders / "newway"))
    browser.run(_START, "ann")
    titles = "return [...document.querySelectorAll('.pane h3')].map(e => e.textContent)"
    assert browser.run(titles) == ["What the person did", "The figure"]
    browser.run(_PRESS, ["b", "7", "Enter"] * 8)
    saved = json.loads(browser.run(_SAVED))
    assert [answer["grades"] for answer in saved["answers"]] == [[7]] * 8
    assert browser.console() == []
