"""Long gaps between frames: no stage looks across them, and they cost nothing."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinefilter import CleanConfig, Cleaner, clean, read_clip, write_clip
from kinefilter.characters import (
    KINECT_V1,
    InputError,
    Origin,
    State,
    Take,
    standard_body,
)
from kinefilter.characters.gaps import LONG_GAP, long_gaps, parts_of
from kinefilter.characters.rotations import IDENTITY
from kinefilter.pipeline.avatar import Avatar
from kinefilter.pipeline.batch.plan import clip_names, find_sources, plan_jobs
from kinefilter.pipeline.batch.store import store_at
from kinefilter.pipeline.batch.task import clean_file
from kinefilter.pipeline.clean_result import CleanResult
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import Export
from kinefilter.pipeline.formats.export import even_frames, resampled
from kinefilter.pipeline.formats.files import numbered, part_paths
from kinefilter.pipeline.formats.sheets import write_take_csv
from kinefilter.pipeline.look.comparison import compare
from kinefilter.pipeline.look.page import page_contents
from kinefilter.pipeline.physics import Targets, pull_through
from kinefilter.pipeline.physics.pulled_character import PulledCharacter
from kinefilter.pipeline.settings import Settings
from kinefilter.scenes.library import perform

FRAMES = 40  # of each part


def a_walk() -> Take:
    act = perform("walk", standard_body(KINECT_V1), seed=3)
    some = slice(30, 30 + FRAMES)
    state = np.full((FRAMES, len(KINECT_V1)), State.TRACKED, dtype=np.uint8)
    noise = np.random.default_rng(0).normal(0.0, 0.005, act.positions[some].shape)
    return Take(act.time[some], act.positions[some] + noise, state, KINECT_V1, "walk")


def _with_gap(seconds: float, first: Take, second: Take | None = None) -> Take:
    second = first if second is None else second
    later = second.time - second.time[0] + first.time[-1] + seconds
    return replace(
        first,
        time=np.concatenate([first.time, later]),
        positions=np.concatenate([first.positions, second.positions]),
        state=np.concatenate([first.state, second.state]),
    )


# Twice the stances may tell a tilt where once is too few.
LEVEL = CleanConfig(tilt=0.0)


@pytest.fixture(scope="module")
def held() -> CleanResult:
    """A walk, a gap of a minute, and the same walk again."""
    return clean(_with_gap(60.0, a_walk()), LEVEL)


def test_gaps_of_over_two_seconds_part_a_take() -> None:
    time = np.array([0.0, 0.0, LONG_GAP, 5.0, 5.1, 9.0])
    assert parts_of(time) == [slice(0, 3), slice(3, 5), slice(5, 6)]
    assert long_gaps(time) == [(2.0, 5.0), (5.1, 9.0)]
    assert parts_of(time[:0]) == [slice(0, 0)]


def test_each_side_of_a_gap_is_a_motion_of_its_own(held: CleanResult) -> None:
    """The same frames, before and after: the same clip, and that of one walk alone."""
    clip = held.clip
    before, after = clip.positions[:FRAMES], clip.positions[FRAMES:]
    np.testing.assert_allclose(after, before, atol=1e-6)
    np.testing.assert_array_equal(clip.contacts[:FRAMES], clip.contacts[FRAMES:])
    alone = clean(a_walk(), LEVEL).clip
    np.testing.assert_allclose(before, alone.positions, atol=1e-3)
    assert alone.positions.shape == before.shape
    assert held.trace is not None
    assert not held.trace.reset.any()
    steps = np.vecdot(clip.rotations[1:], clip.rotations[:-1])
    assert (steps >= 0.0).all()


def test_one_side_does_not_depend_on_how_long_ago_the_other_was(
    held: CleanResult,
) -> None:
    """Nor does a gap of thirty years take any longer than one of a minute."""
    far = clean(_with_gap(1e9, a_walk()), LEVEL).clip
    np.testing.assert_allclose(far.positions, held.clip.positions, atol=1e-5)


def test_one_side_does_not_depend_on_what_the_other_does(held: CleanResult) -> None:
    """Body, tilt and floor given: nothing else is shared."""
    fixed = CleanConfig(height=1.75, tilt=0.0, floor=0.0, method="none")
    walk = a_walk()
    back = replace(walk, positions=np.add(walk.positions[::-1], [0.3, 0.0, 0.2]))
    one, other = (
        clean(_with_gap(3.0, walk, second), fixed).clip.positions[:FRAMES]
        for second in (walk, back)
    )
    np.testing.assert_allclose(one, other, atol=5e-3)
    assert held.clip.floor == pytest.approx(clean(walk, LEVEL).clip.floor, abs=1e-3)


def test_no_figure_is_measured_across_a_gap(held: CleanResult) -> None:
    """Who flies over the gap and lands elsewhere neither skates nor falls."""
    alone = clean(a_walk(), LEVEL)
    for name, quality in held.stages.items():
        other = alone.stages[name]
        for figure in ("jitter", "peak_hand_speed", "skate_max_m_per_s"):
            value = getattr(quality, figure)
            assert value == pytest.approx(getattr(other, figure), rel=0.02)
    assert len(held.failures) == 2 * len(alone.failures)
    for failure in held.failures:
        assert failure.end - failure.start < LONG_GAP


def test_a_part_of_one_frame_or_with_nobody_is_a_part_all_the_same() -> None:
    walk = a_walk()
    nobody = replace(
        walk,
        positions=np.full_like(walk.positions, np.nan),
        state=np.zeros_like(walk.state),
    )
    lone = replace(
        walk, time=walk.time[:1], positions=walk.positions[:1], state=walk.state[:1]
    )
    pca = CleanConfig("local-pca", physics=False)
    for take, config in (
        (_with_gap(5.0, walk, lone), CleanConfig()),
        (_with_gap(5.0, lone, walk), CleanConfig(physics=False)),
        (_with_gap(5.0, walk, nobody), CleanConfig(physics=False)),
        (_with_gap(5.0, nobody, walk), pca),
    ):
        clip = clean(take, config).clip
        assert len(clip) == len(take)
        assert np.isfinite(clip.positions).all()


def test_things_stay_where_they_are_when_the_character_starts_again() -> None:
    body = standard_body(KINECT_V1)
    character = PulledCharacter(body, scene="basketball")
    joint = character.model.body("ball").jntadr[0]
    ball = slice(*(character.model.jnt_qposadr[joint] + [0, 2]))

    def frames(_count: int) -> Iterator[int]:
        """Put the ball elsewhere before the gap."""
        yield from range(2)
        character.data.qpos[ball] = [2.0, 3.0]
        yield 2

    still = Targets(
        np.array([0.0, 0.03, 60.0]),
        np.tile(body.rest_positions, (3, 1, 1)),
        np.tile(IDENTITY, (3, len(KINECT_V1), 1)),
    )
    (result,) = pull_through([character], [still], frames)
    np.testing.assert_allclose(character.data.qpos[ball], [2.0, 3.0], atol=0.1)
    assert not result.trace.reset.any()


def test_gaps_are_told_in_seconds_since_the_first_frame(
    held: CleanResult, tmp_path: Path
) -> None:
    note = next(note for note in held.notes if "no frames" in note)
    start, end = long_gaps(held.clip.time)[0]
    assert held.clip.time[0] == pytest.approx(1.0)
    words = f"no frames from {start - 1.0:.1f} to {end - 1.0:.1f} s (60 s)"
    assert note == f"{words}: the character holds still"
    many = np.cumsum(np.tile([0.03, 0.03, 3.0], 40))
    crowd = replace(
        a_walk(),
        time=many[:FRAMES],
    )
    assert "and 8 more such gaps" in clean(crowd, CleanConfig(physics=False)).notes
    path = tmp_path / "walk.csv"
    write_take_csv(_with_gap(60.0, a_walk()), path)
    assert contents_of(path)["bodies"][0]["gaps"] == [{"start_s": start, "end_s": end}]
    page = page_contents(compare(held.clip, _with_gap(60.0, a_walk())), ())
    assert list(page["damage"]) == [words]


def test_info_and_clean_tell_the_gap(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "walk.csv", tmp_path / "walk.usda"
    write_take_csv(_with_gap(60.0, a_walk()), path)
    assert main(["info", str(path)]) == 0
    assert "(60 s)" in capsys.readouterr().out
    figures = tmp_path / "figures.json"
    assert main(["clean", str(path), "-o", str(out), "--json", str(figures)]) == 0
    assert "(60 s): the character holds still" in capsys.readouterr().out
    (gap,) = json.loads(figures.read_text())["gaps"]
    assert gap["end_s"] - gap["start_s"] == pytest.approx(60.0)


def test_a_take_with_a_gap_can_be_refused(held: CleanResult) -> None:
    strict = Cleaner(CleanConfig(gaps="refuse"))
    assert len(strict.clean(a_walk()).clips) == 1
    with pytest.raises(InputError, match=r"no frames from .* \(60 s\).*--gaps"):
        strict.without("physics").clean(_with_gap(60.0, a_walk()))
    assert held.clips == (held.clip,)


def test_a_take_is_split_at_its_gaps(held: CleanResult, tmp_path: Path) -> None:
    take = tmp_path / "walk.csv"
    write_take_csv(_with_gap(60.0, a_walk()), take)
    out = tmp_path / "walk.bvh"
    words = ["clean", str(take), "-o", str(out), "--gaps", "split", "--tilt", "0"]
    assert main(words) == 0
    clips = [read_clip(tmp_path / f"walk.part{k}.bvh") for k in (1, 2)]
    assert not out.exists()
    for clip in clips:
        assert len(clip) == FRAMES
        np.testing.assert_allclose(
            clip.positions, held.clip.positions[:FRAMES], atol=1e-3
        )
        assert clip.fps == pytest.approx(held.clip.fps, rel=1e-3)
    split = Cleaner(CleanConfig(gaps="split", tilt=0.0)).clean(
        _with_gap(60.0, a_walk())
    )
    np.testing.assert_array_equal(split.clips[1].time, held.clip.time[FRAMES:])
    assert split.notes[0].endswith(": the next clip begins")


def test_a_span_within_a_gap_is_told_and_with_parts_it_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    take = tmp_path / "walk.csv"
    write_take_csv(_with_gap(60.0, a_walk()), take)
    out = tmp_path / "walk.bvh"
    words = ["clean", str(take), "-o", str(out), "--begin", "10", "--end", "20"]
    assert main(words) == 2
    told = capfd.readouterr().err
    assert re.search(r"walk.csv: no frames from [\d.]+ to 6\d[\d.]* s; choose", told)
    # Seconds of the take would be counted from the beginning of each part.
    assert main([*words, "--gaps", "split"]) == 2
    assert "--gaps split cannot be combined with --begin" in capfd.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [take.name]


def test_no_part_overwrites_what_the_user_has(tmp_path: Path) -> None:
    take = tmp_path / "walk.part2.csv"
    write_take_csv(_with_gap(60.0, a_walk()), take)
    before = take.read_bytes()
    command = ["clean", str(take), "-o", str(tmp_path / "walk.csv"), "--gaps", "split"]
    assert main(command) == 2
    assert take.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == [take.name]


def test_names_of_parts_and_people_go_together() -> None:
    clip = Path("clips/walk.usda")
    assert part_paths(clip, 1) == [clip]
    second = [path.name for path in part_paths(numbered(clip, 2), 2)]
    assert second == ["walk.2.part1.usda", "walk.2.part2.usda"]
    names = clip_names(["walk.csv", "walk.part1.csv"], ".usda", several=True)
    assert names == ["walk.csv.usda", "walk.part1.csv.usda"]


def test_batch_splits_and_misses_a_part_that_is_gone(tmp_path: Path) -> None:
    folder, out = tmp_path / "takes", tmp_path / "clips"
    folder.mkdir()
    write_take_csv(_with_gap(60.0, a_walk()), folder / "walk.csv")
    (folder / "kinefilter.toml").write_text('gaps = "split"\nphysics = false\n')
    store = store_at(str(out))
    sources = find_sources([str(folder)], str(out))
    (job,) = plan_jobs(sources, store, Settings(), ".csv")
    row = clean_file(job)
    written = {file.name: file for file in store.files()}
    assert written.keys() == {"walk.part1.csv", "walk.part2.csv"}
    assert [clip.frames for clip in row.clips] == [FRAMES, FRAMES]
    assert job.is_done(row, written)
    assert not job.is_done(row, {"walk.part1.csv": written["walk.part1.csv"]})


def test_resampled_frames_hold_still_in_a_gap(held: CleanResult) -> None:
    even = resampled(held.clip, 10.0)
    start, end = long_gaps(held.clip.time)[0]
    inside = (even.time > start) & (even.time < end - 0.04)
    assert inside.sum() > 590
    still = np.broadcast_to(held.clip.positions[FRAMES - 1], (inside.sum(), 20, 3))
    np.testing.assert_allclose(even.positions[inside], still, atol=1e-9)
    assert (even.origin[inside] == Origin.FILLED).all()
    assert (even.origin[even.time < start] < Origin.FILLED).all()


def test_a_gap_hardly_too_long_is_not_rounded_to_the_limit() -> None:
    with pytest.raises(InputError, match=r"600\.1 s in all, expected 600 s at most"):
        even_frames(np.array([0.0, 1.0, 601.03]), 30.0, "gap.csv")


@pytest.mark.usefixtures("usd_here")
@pytest.mark.parametrize("suffix", [".bvh", ".usda", ".npz"])
def test_written_clips_hold_still_in_a_gap(
    held: CleanResult, suffix: str, tmp_path: Path
) -> None:
    path = tmp_path / f"walk{suffix}"
    write_clip(held.clip, path)
    clip = read_clip(path)
    shift = clip.time[0] - held.clip.time[0]
    start, end = (stamp + shift for stamp in long_gaps(held.clip.time)[0])
    assert clip.time[-1] == pytest.approx(held.clip.time[-1] + shift, abs=0.04)
    if suffix == ".bvh":
        inside = (clip.time > start + 0.05) & (clip.time < end - 0.08)
        assert np.ptp(clip.positions[inside], axis=0).max() < 1e-4
        assert clip.fps == pytest.approx(held.clip.fps, rel=1e-3)
        return
    assert len(clip) == len(held.clip)
    if suffix == ".usda":
        from pxr import Usd, UsdSkel

        stage = Usd.Stage.Open(str(path))
        animation = UsdSkel.Animation(stage.GetPrimAtPath("/Character/Animation"))
        rate = stage.GetTimeCodesPerSecond()
        last, late = (
            np.array(animation.GetTranslationsAttr().Get(code))
            for code in (start * rate, (end - 0.1) * rate)
        )
        np.testing.assert_array_equal(last, late)


def test_which_files_can_be_compared_across_a_gap_is_told(
    held: CleanResult, tmp_path: Path
) -> None:
    take = _with_gap(60.0, a_walk())
    write_clip(held.clip, tmp_path / "walk.bvh")
    for clip in (read_clip(tmp_path / "walk.bvh"), held.clip.at(np.s_[:FRAMES])):
        with pytest.raises(InputError, match=r"\(60 s\).*--gaps hold to \.npz"):
            compare(clip, take)
    for suffix in (".npz", ".usdc", ".glb"):
        write_clip(held.clip, tmp_path / f"walk{suffix}")
        compare(read_clip(tmp_path / f"walk{suffix}"), take)


@pytest.mark.parametrize(("suffix", "fps"), [(".bvh", None), (".npz", 30.0)])
def test_no_file_holds_still_for_years(
    held: CleanResult, suffix: str, fps: float | None, tmp_path: Path
) -> None:
    time = held.clip.time.copy()
    time[FRAMES:] += 1e9
    path = tmp_path / f"walk{suffix}"
    with pytest.raises(InputError, match=r"no frames from .* --gaps split"):
        write_clip(replace(held.clip, time=time), path, Export(fps=fps))
    assert not path.exists()


def test_what_cannot_be_written_is_refused_before_it_is_cleaned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("kinefilter.pipeline.cleaner.clean", None)
    take = tmp_path / "walk.csv"
    write_take_csv(_with_gap(1e6, a_walk()), take)
    assert main(["clean", str(take), "-o", str(tmp_path / "walk.bvh")]) == 2
    assert "--gaps split" in capsys.readouterr().err


def test_a_long_clip_at_a_high_rate_is_refused(held: CleanResult) -> None:
    slow = replace(held.clip, time=np.linspace(0.0, 100.0, len(held.clip)))
    many = replace(slow, time=slow.time * 1.2)
    resampled(many, 100.0)
    hour = np.linspace(0.0, 3600.0, 3601)
    rows = np.zeros(3601, dtype=int)
    with pytest.raises(InputError, match="1,000,000 at most"):
        resampled(replace(held.clip.at(rows), time=hour), 1000.0)


def test_live_a_pause_of_years_is_a_pause() -> None:
    walk, avatar = a_walk(), Avatar(standard_body(KINECT_V1))
    for shift in (0.0, 60.0, 1e9):
        for k in range(10):
            pose = avatar.step(walk.positions[k], walk.time[k] + shift)
            assert np.isfinite(pose.positions).all()
    away = np.linalg.norm(pose.positions - walk.positions[9], axis=1)
    assert away.max() < 0.4
