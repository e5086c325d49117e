"""What is shown on the page, without a browser: frames, edits, files, who may come."""

from __future__ import annotations

import re
import urllib.request
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import MakeClip
from hypothesis import given
from hypothesis import strategies as st

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import KINECT_V1, KINECT_V2, Clip, InputError, Skeleton
from kinefilter.characters.arrays import Flags
from kinefilter.pipeline.edits import (
    FEET,
    Edit,
    EditHistory,
    EditsFile,
    read_edits,
    with_contacts,
)
from kinefilter.pipeline.failures import Failure, FailureKind
from kinefilter.pipeline.formats import write_clip
from kinefilter.pipeline.look.comparison import read_comparison, same_times
from kinefilter.pipeline.look.drawing import Drawing
from kinefilter.pipeline.look.timelines import Curves, Playback, timeline_html
from kinefilter.pipeline.look.viewer import Viewer, status_html
from kinefilter.pipeline.look.viewer_server import opened_server
from kinefilter.scenes import SAMPLE

QUICK = CleanConfig(method="none", physics=False)
TIME = np.array([5.0, 5.1, 5.2, 5.2, 5.5, 5.6])  # a repeated stamp and a gap


def test_every_frame_is_shown_from_its_time_to_the_next_ones() -> None:
    playback = Playback(TIME)
    playback.play(100.0)
    shown = [playback.frame(100.0 + s) for s in (0.0, 0.05, 0.15, 0.25, 0.45, 0.55)]
    assert shown == [0, 0, 1, 3, 3, 4]
    assert playback.frame(100.65) == 5
    assert playback.frame(100.75) == 0  # and so on from the beginning


@given(st.integers(0, 5), st.floats(0.1, 4.0), st.floats(0.0, 10.0))
def test_a_pause_keeps_the_frame_and_playing_goes_on_from_it(
    frame: int, speed: float, clock: float
) -> None:
    playback = Playback(TIME)
    playback.change_speed(speed, clock)
    playback.seek(frame)
    assert playback.frame(clock) == frame
    playback.play(clock)
    later = clock + 0.03 / speed
    seen = playback.frame(later)
    playback.pause(later)
    assert playback.frame(later + 99.0) == seen
    assert seen == {5: 0, 2: 3}.get(frame, frame)


def test_a_change_of_speed_keeps_the_frame() -> None:
    playback = Playback(np.arange(100) / 10.0)
    playback.play(0.0)
    assert playback.frame(2.05) == 20
    playback.change_speed(2.0, 2.05)
    assert playback.frame(2.05) == 20
    assert playback.frame(3.06) == 40


def test_a_picture_waits_for_the_next_frame_and_at_rest_for_ever() -> None:
    playback = Playback(TIME)
    assert playback.until_next(7.0) is None
    playback.play(7.0)
    assert playback.until_next(7.02) == pytest.approx(0.08)
    assert playback.until_next(7.30) == pytest.approx(0.20)
    assert playback.until_next(7.60) == pytest.approx(0.10)  # then the beginning


@pytest.mark.parametrize(("asked", "got"), [(-3, 0), (4, 4), (99, 5)])
def test_stepping_stays_within_the_motion(asked: int, got: int) -> None:
    playback = Playback(TIME)
    playback.seek(asked)
    assert playback.frame(0.0) == got


def test_a_motion_of_one_frame_plays() -> None:
    playback = Playback(np.array([3.0]))
    playback.play(0.0)
    assert playback.frame(12.3) == 0


@given(st.sampled_from(list(FEET)), st.integers(0, 9), st.integers(0, 9))
def test_a_contact_changes_its_part_in_its_frames_and_nothing_else(
    part: str, one: int, other: int
) -> None:
    before = np.random.default_rng(0).random((10, 4)) < 0.5
    first, last = sorted((one, other))
    since = np.arange(10) / 30.0
    for stands in (True, False):
        told = Edit("contact", since[first], since[last], part=part, stands=stands)
        inside = np.zeros((10, 4), dtype=bool)
        inside[first : last + 1, list(FEET[part])] = True
        found = with_contacts(before, [told], since)
        np.testing.assert_array_equal(found, np.where(inside, stands, before))


def test_edits_are_undone_in_turn_and_redone_until_another_is_made(
    make_clip: MakeClip,
) -> None:
    clip = make_clip(30)
    one, two, three = (Edit("exchange", 0.0, 0.1 * k) for k in (1, 2, 3))
    history = EditHistory([one], clip)
    assert not history.unsaved
    history.replace([one, two])
    history.replace([one, two])  # changes nothing: no step
    history.mark_saved()
    history.undo()
    assert history.edits == (one,)
    assert history.unsaved
    history.redo()
    assert history.edits == (one, two)
    assert not history.unsaved
    history.undo()
    history.undo()  # there is nothing more
    assert history.edits == (one,)
    assert history.edited.sum() == (clip.time - clip.time[0] <= 0.1005).sum()
    history.replace([three])
    history.redo()
    assert history.edits == (three,)


def test_what_somebody_wrote_by_hand_is_kept_when_a_page_saves(tmp_path: Path) -> None:
    path, told = tmp_path / "take.edits.toml", [Edit("exchange", 1.0, 2.0)]
    file = EditsFile(path)
    assert file.read() == ()
    assert file.write(told) is None
    assert file.write([]) is None  # its own is replaced
    by_hand = "# the left one, surely\n[[exchange]]\nbegin = 3\nend = 4\n"
    path.write_text(by_hand, encoding="utf-8")
    other = EditsFile(path)
    assert other.read() == (Edit("exchange", 3.0, 4.0),)
    kept = other.write(told)
    assert kept == tmp_path / "take.edits.1.toml"
    assert kept.read_text(encoding="utf-8") == by_hand
    assert file.write(told) is None  # the same
    path.write_text(by_hand, encoding="utf-8")
    assert other.write([]) == tmp_path / "take.edits.2.toml"
    assert read_edits(path) == ()


def test_failures_and_what_is_hardly_reliable_are_doubtful(make_clip: MakeClip) -> None:
    clip = make_clip(90)
    rates = np.full_like(clip.reliability, 0.9)
    rates[40:60, clip.skeleton.index("KneeLeft")] = 0.1
    rates[70:, clip.skeleton.index("HandLeft")] = 0.0  # as mostly
    rates[5, 3] = 0.0  # a frame alone
    clip = replace(clip, reliability=rates)
    time = clip.time
    bent = FailureKind.BENT_BACKWARDS
    failed = Failure(bent, "left leg", 10, 12, time[10], time[12])
    found = Drawing(clip, failures=(failed,)).doubtful
    assert found[10:13].all()
    assert found[44:56].all()
    assert not found[np.r_[:10, 13:34, 67:90]].any()


def named(contacts: Flags) -> dict[str, Flags]:
    names = ("Heel L", "Toe L", "Heel R", "Toe R")
    return dict(zip(names, contacts.T, strict=True))


def test_the_timeline_has_a_bar_for_each_stance_and_a_mark_at_the_frame() -> None:
    contacts = np.zeros((100, 4), dtype=bool)
    contacts[10:30, 0] = contacts[50:100, 0] = contacts[20:25, 3] = True
    html = timeline_html(named(contacts), 75, (20, 39))
    rows = re.findall(r'class="row" d="([^"]*)"', html)
    bars = [re.findall(r"M([\d.]+) \d+h([\d.]+)", row) for row in rows]
    assert [len(row) for row in bars] == [2, 0, 0, 1]
    spans = [(float(x) / 6.0, float(w) / 6.0) for x, w in bars[0]]  # 600 wide
    assert spans == [(10.0, 20.0), (50.0, 50.0)]
    assert 'd="M453.0 0V' in html  # the middle of frame 75
    assert '<rect x="120.0" width="120.0"' in html


def test_of_a_long_motion_the_frames_around_are_shown_closer() -> None:
    contacts = np.zeros((3000, 4), dtype=bool)
    contacts[1000:1030, 1] = True
    html = timeline_html(named(contacts), 1010, (1005, 2999))
    assert timeline_html(named(contacts[:600]), 10, (0, 599)).count("<svg") == 1
    near = html.split('id="close-up"')[1]
    # 300 frames around the marked one, from 860 on, two steps each.
    assert re.findall(r'class="row" d="([^"]*)"', near)[1] == "M280.0 24h60.0"
    assert 'd="M301.0 0V' in near
    assert '<rect x="290.0" width="310.0"' in near
    whole = html.split('id="close-up"')[0]
    assert re.findall(r'class="row" d="([^"]*)"', whole)[1] == "M200.0 24h6.0"
    for frame, first in ((0, 0), (2999, 2700)):  # it stays within the motion
        near = timeline_html(named(contacts), frame, (0, 2999)).split('id="close-up"')[
            1
        ]
        assert f'd="M{2 * (frame - first) + 1}.0 0V' in near


def test_the_picture_of_an_hour_stays_small() -> None:
    contacts = np.random.default_rng(0).random((108_000, 4)) < 0.5
    assert len(timeline_html(named(contacts), 70_000, (0, 107_999))) < 50_000


def _curves(html: str) -> dict[str, list[list[tuple[float, float]]]]:
    """Return the strokes of each color in a picture of curves."""
    found = {}
    for path, color in re.findall(r'class="curve" d="([^"]*)" stroke="([^"]*)"', html):
        strokes = [stroke for stroke in path.split("M") if stroke]
        found[color] = [
            [(float(x), float(y)) for x, y in (p.split() for p in stroke.split("L"))]
            for stroke in strokes
        ]
    return found


def test_curves_are_the_paths_of_a_joint_with_gaps_where_it_was_not_seen(
    make_clip: MakeClip,
) -> None:
    clip, joint = make_clip(100), "WristLeft"
    j = clip.skeleton.index(joint)
    raw = clip.positions + np.array([0.0, 0.02, 0.0])
    raw[40:50, j] = np.nan
    html = Curves(Drawing(clip, raw), joint, "y (up)").html(25)
    before, after = _curves(html)["rgb(130, 130, 130)"]
    assert [len(before), len(after)] == [40, 50]
    (whole,) = _curves(html)["rgb(237, 120, 33)"]
    x, y = np.transpose(whole)
    np.testing.assert_allclose(x, 6.0 * np.arange(100) + 3.0)
    low, high = map(float, re.search(r"(-?\d+) to (-?\d+) cm", html).groups())
    heights = high - y / 150.0 * (high - low)  # cm
    np.testing.assert_allclose(heights, 100.0 * clip.positions[:, j, 1], atol=1.0)
    assert (np.array([y for _, y in before]) < y[:40]).all()  # 2 cm higher
    assert 'd="M153.0 0V' in html  # frame 25


def test_the_curves_of_an_hour_stay_small_and_another_clip_is_one_of_them(
    make_clip: MakeClip,
) -> None:
    clip = make_clip(20_000)
    drawing = Drawing(clip, clip.positions, other=clip)
    assert "other" in drawing.layers
    html = Curves(drawing, "Head", "x (left)").html(7)
    assert len(_curves(html)) == 3
    assert len(html) < 50_000


def test_clips_are_compared_at_the_same_times(make_clip: MakeClip) -> None:
    clip = make_clip(61)
    late = replace(clip.at(slice(None, None, 2)), time=9.0 + clip.time[::2])
    found = same_times(late, clip, Path("late.npz"))
    assert len(found) == 61
    np.testing.assert_array_equal(found.root[::2], clip.root[::2])
    with pytest.raises(InputError, match=r"late\.npz: lasts 1\.00 s, the motion 2\.00"):
        same_times(clip.at(slice(31)), clip, Path("late.npz"))


def test_the_status_names_the_least_reliable_joint_and_the_force(
    make_clip: MakeClip,
) -> None:
    clip = make_clip(4)
    html = status_html(clip, 2)
    worst = int(np.argmin(clip.reliability[2]))
    assert clip.skeleton.joints[worst] in html
    assert f"{clip.reliability[2, worst]:.2f}" in html
    assert f"{clip.external_force[2]:.2f} body weights" in html


def test_a_take_is_viewed_with_its_target_where_the_clip_is() -> None:
    take = read_take(SAMPLE)
    result = clean(take, CleanConfig())
    drawing = Drawing.of(result, take)
    assert drawing.target is not None
    assert drawing.raw is not None
    np.testing.assert_array_equal(drawing.target, result.target)
    moved = np.linalg.norm(drawing.clip.positions - drawing.target, axis=2)
    np.testing.assert_allclose(moved, drawing.clip.moved_by_physics, atol=1e-9)
    moved = np.linalg.norm(drawing.target - drawing.raw, axis=2)
    known = np.isfinite(moved)
    np.testing.assert_allclose(
        moved[known], drawing.clip.moved_by_correction[known], atol=1e-9
    )
    assert drawing.layers.keys() == {
        *("skin", "raw", "cleaned", "physics", "contacts", "forces"),
    }


def test_without_physics_there_is_no_force_and_no_second_figure() -> None:
    take = read_take(SAMPLE)
    drawing = Drawing.of(clean(take, QUICK), take)
    assert drawing.target is None
    assert drawing.layers.keys() == {"skin", "raw", "cleaned", "contacts"}


def test_the_take_beside_a_clip_never_touches_it(make_clip: MakeClip) -> None:
    clip = make_clip(30)
    aside = Drawing(clip, raw=clip.positions).raw_offset
    assert aside[1] == 0.0
    along = aside / np.linalg.norm(aside)
    reach = clip.positions @ along
    assert ((reach + aside @ along).min(axis=1) > reach.max(axis=1)).all()
    assert not Drawing(clip).raw_offset.any()


def test_a_clip_is_read_with_its_take(tmp_path: Path) -> None:
    take = read_take(SAMPLE)
    result = clean(take, QUICK)
    clip, expected = result.clip, Drawing.of(result, take).raw
    for suffix, off in (
        (".npz", 1e-9),
        (".usdc", 1e-6),
        (".bvh", 0.02),
        (".csv", 0.02),
    ):
        path = tmp_path / f"clip{suffix}"
        write_clip(clip, path)
        drawing = read_comparison(path, SAMPLE)
        np.testing.assert_allclose(drawing.raw, expected, atol=off)
        away = np.linalg.norm(drawing.clip.positions - clip.positions, axis=2)
        assert away.mean() < off, suffix


@pytest.mark.parametrize(
    ("skeleton", "frames"), [(KINECT_V1, 9), (KINECT_V2, 9), (KINECT_V1, 1)]
)
def test_a_motion_with_things_and_gaps_is_put_on_a_page(
    skeleton: Skeleton,
    frames: int,
    make_clip: MakeClip,
    furnish: Callable[[Clip], Clip],
    tmp_path: Path,
) -> None:
    clip = furnish(make_clip(frames, skeleton))
    raw = clip.positions.copy()
    raw[0], raw[frames // 2, 4], raw[frames // 2, 2, 1] = np.nan, np.nan, np.nan
    with opened_server() as server:
        drawing = Drawing(clip, raw, clip.positions)
        viewer = Viewer(server, drawing, tmp_path / "c.toml")
        viewer.stop()
        viewer.run()
        with urllib.request.urlopen(viewer.address, timeout=10) as page:
            assert b"<html" in page.read()
    assert list(tmp_path.iterdir()) == []
