"""Recordings of several people: who is who, and a clip for each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up_people import complaint, made_up, without
from published_layouts import azure_json, ntu_text
from text_files import write_text

from kinefilter.characters import KINECT_V2, InputError, State, Take
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.contents import contents_of
from kinefilter.pipeline.formats import (
    read_clip,
    read_recording,
    read_take,
    read_takes,
    write_take_csv,
)
from kinefilter.pipeline.lab.simulation import simulate
from kinefilter.pipeline.people import Track, people_of


def test_two_people_are_two_takes_in_the_order_in_which_they_appear(
    tmp_path: Path,
) -> None:
    late, early = without(made_up(8, seed=1), [0, 1, 7]), made_up(8, seed=2)
    for text in (ntu_text([late, early]), azure_json([late, early])):
        path = write_text(tmp_path / "a", text)
        first, second = read_takes(path)
        assert (len(first), len(second)) == (8, 5)
        np.testing.assert_allclose(first.positions, early.positions, atol=1e-12)
        np.testing.assert_allclose(second.time, late.time[2:7], atol=1e-6)
        assert second.source.endswith("body 2")
        np.testing.assert_array_equal(read_take(path).positions, first.positions)
        np.testing.assert_array_equal(
            read_take(path, body=2).positions, second.positions
        )


def test_the_person_seen_in_most_frames_is_the_one_that_is_read(
    tmp_path: Path,
) -> None:
    take, other = without(made_up(9, seed=1), [3, 4, 5]), made_up(9, seed=2)
    recording = read_recording(write_text(tmp_path / "a", ntu_text([take, other])))
    assert recording.main == 1


def test_frames_that_lack_a_person_are_missing_in_their_take(tmp_path: Path) -> None:
    take = without(made_up(8), [3, 4])
    again = read_take(write_text(tmp_path / "a", ntu_text([take])))
    np.testing.assert_array_equal(again.positions, take.positions)
    np.testing.assert_array_equal(again.state, take.state)


def moving(frames: int, start: float, speed: float, size: float = 1.0) -> Take:
    """Return a body that moves along x at a speed [m/s] from a place [m]."""
    body = made_up(1).positions[0]
    shape = size * (body - body.mean(axis=0))
    time = np.arange(frames) / 30.0
    path = np.stack([start + speed * time, 0.0 * time, 2.0 + 0.0 * time], axis=-1)
    state = np.full((frames, len(KINECT_V2)), State.TRACKED, dtype=np.uint8)
    return Take(time, shape + path[:, None], state, KINECT_V2)


@pytest.mark.parametrize(
    ("gap", "jump", "size", "people"),
    [(10, 0.3, 1.0, 1), (75, 0.3, 1.0, 1), (10, 2.5, 1.0, 2), (75, 0.3, 1.6, 2)],
)
def test_who_comes_back_is_the_same_person_by_place_time_and_body_lengths(
    tmp_path: Path, gap: int, jump: float, size: float, people: int
) -> None:
    """Nobody gets 2.5 m away in a third of a second, or grows by half."""
    frames = 60 + gap + 60
    before, after = moving(frames, 0.0, 0.0), moving(frames, jump, 0.0, size)
    before = without(before, list(range(60, frames)))
    after = without(after, list(range(60 + gap)))
    path = write_text(tmp_path / "a", ntu_text([before, after]))
    recording = read_recording(path)
    assert len(recording.takes) == people
    count = (
        60 if people == 2 else frames if gap == 10 else 120
    )  # no frames in long gaps
    assert len(recording.takes[0]) == count
    told = " ".join(recording.notes)
    assert ("numbers for people change" in told) == (people == 1)


@pytest.mark.parametrize("far", [0.0, 0.35])
def test_who_is_passed_stays_who_they_are(tmp_path: Path, far: float) -> None:
    """The tracker exchanges the two, or loses both and gives them new numbers."""
    frames, hidden = 120, list(range(54, 67)) if far == 0.0 else []
    one, other = moving(frames, -2.0, 1.0), moving(frames, 2.0, -1.0)
    other = replace(other, positions=other.positions + np.array([0.0, 0.0, far]))
    one, other = without(one, hidden), without(other, hidden)
    first, last = list(range(60)), list(range(60, frames))
    bodies = [without(take, cut) for cut in (last, first) for take in (one, other)]
    numbers = (1, 2, 3, 4)
    if far:  # the same numbers, exchanged
        a, b, c, d = bodies
        bodies = [
            replace(
                a,
                positions=np.where(np.isnan(a.positions), e.positions, a.positions),
                state=np.maximum(a.state, e.state),
            )
            for a, e in ((a, d), (b, c))
        ]
        numbers = (1, 2)
    path = write_text(tmp_path / "a", ntu_text(bodies, numbers))
    takes = read_takes(path)
    assert len(takes) == 2
    for take, truth in zip(takes, (one, other), strict=True):
        np.testing.assert_allclose(take.positions, truth.positions, atol=1e-9)


def test_whoever_fills_the_place_of_another_in_a_list_is_not_a_third_person() -> None:
    """Files without numbers list bodies: if the first is lost, the next moves up."""
    one, other = moving(90, -1.0, 0.1).positions, moving(90, 1.0, -0.1).positions
    lost = np.array([20, 40, 41, 60])
    first, second = one.copy(), other.copy()
    first[lost], second[lost] = other[lost], np.nan
    time = np.arange(90) / 30.0
    tracks = [Track(time, listed, KINECT_V2) for listed in (first, second)]
    people = people_of(tracks)
    found = [
        sorted((int(row), piece.track) for piece in person for row in piece.rows)
        for person in people
    ]
    kept = [k for k in range(90) if k not in lost]
    assert found == [
        [(k, 0) for k in kept],
        [(k, int(k not in lost)) for k in range(90)],
    ]


def test_rows_of_one_time_in_two_places_are_two_people(tmp_path: Path) -> None:
    """As in tables that a tracker of several sensors wrote: a row a body."""
    one, other = moving(60, -1.0, 0.2), moving(60, 1.0, -0.2, 1.1)
    both = Take(
        np.repeat(one.time, 2),
        np.stack([one.positions, other.positions], axis=1).reshape(120, -1, 3),
        np.repeat(one.state, 2, axis=0),
        KINECT_V2,
    )
    write_take_csv(both, tmp_path / "a.csv")
    takes = read_takes(tmp_path / "a.csv")
    assert len(takes) == 2
    for take, truth in zip(takes, (one, other), strict=True):
        np.testing.assert_allclose(take.positions, truth.positions, atol=1e-8)


def test_changes_of_numbers_are_told_in_seconds_after_the_first_frame(
    tmp_path: Path,
) -> None:
    one, other = moving(60, -1.0, 0.2), moving(60, 1.0, -0.2)
    places = np.stack([one.positions, other.positions], axis=1)
    places[30:] = places[30:, ::-1]
    time, state = np.repeat(one.time, 2) + 3553.0, np.repeat(one.state, 2, axis=0)
    both = Take(time, places.reshape(120, -1, 3), state, KINECT_V2)
    write_take_csv(both, tmp_path / "a.csv")
    (note,) = read_recording(tmp_path / "a.csv").notes
    assert "change at 1.0, 1.0 s" in note


def test_a_clock_that_stands_still_makes_no_crowd(tmp_path: Path) -> None:
    take = moving(60, 0.0, 1.0)
    write_take_csv(replace(take, time=np.floor(take.time)), tmp_path / "a.csv")
    (again,) = read_takes(tmp_path / "a.csv")
    assert len(again) == 60


def test_a_frame_that_was_polled_twice_is_one_persons(tmp_path: Path) -> None:
    take = moving(60, 0.0, 1.0)
    twice = Take(
        np.repeat(take.time, 2),
        np.repeat(take.positions, 2, axis=0),
        np.repeat(take.state, 2, axis=0),
        KINECT_V2,
    )
    write_take_csv(twice, tmp_path / "a.csv")
    (again,) = read_takes(tmp_path / "a.csv")
    assert len(again) == 120


def test_two_who_come_back_at_once_go_on_as_who_was_nearest(tmp_path: Path) -> None:
    frames, lost = 40, list(range(15, 40))
    back = list(range(20))
    one, other = moving(frames, 0.0, 0.0), moving(frames, 0.45, 0.0)
    again_one, again_other = moving(frames, 0.1, 0.0), moving(frames, 0.5, 0.0)
    bodies = [without(one, lost), without(other, lost)]
    bodies += [without(again_other, back), without(again_one, back)]
    text = ntu_text(bodies, numbers=(1, 2, 3, 4))
    takes = read_takes(write_text(tmp_path / "a", text))
    assert len(takes) == 2
    for take, places in zip(takes, [(0.0, 0.1), (0.45, 0.5)], strict=True):
        centers = take.positions[[0, -1]].mean(axis=1)[:, 0]
        np.testing.assert_allclose(centers, places, atol=1e-9)


def test_bodies_that_leap_all_the_time_are_who_the_tracker_says() -> None:
    rng = np.random.default_rng(0)
    body = rng.normal(size=(1, 25, 3))
    tracks = [
        Track(np.arange(900) / 30.0, body + rng.normal(size=(900, 1, 3)), KINECT_V2)
        for _ in range(2)
    ]
    found = people_of(tracks)
    assert [[part.track for part in person] for person in found] == [[0], [1]]
    assert all(len(person[0].rows) == 900 for person in found)


def test_what_is_seen_in_one_frame_is_nobody(tmp_path: Path) -> None:
    ghost = without(made_up(6, seed=3), [0, 1, 3, 4, 5])
    path = write_text(tmp_path / "a", ntu_text([made_up(6), ghost]))
    assert len(read_takes(path)) == 1


def test_a_body_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a", ntu_text([made_up()]))
    for body in (0, 2):
        with pytest.raises(InputError, match=f"no body {body}, only body 1.*info"):
            read_take(path, body=body)
    path = write_text(tmp_path / "b", ntu_text([made_up(6), made_up(6, seed=3)]))
    with pytest.raises(InputError, match=rf"^{path}: has no body 3, expected 1 to 2"):
        read_take(path, body=3)


def test_a_body_twice_in_a_frame_is_refused(tmp_path: Path) -> None:
    text = ntu_text([made_up(3), made_up(3, seed=1)], numbers=(4, 4))
    assert "frame 1 has body 4 twice" in complaint(write_text(tmp_path / "a", text))


# Cleaned


def people(tmp_path: Path) -> Path:
    """Return an NTU file of two people, one of whom is gone for half a second."""
    takes = [
        simulate("basic", "wave", skeleton="kinect_v2", seed=seed).take
        for seed in (1, 2)
    ]
    count = min(map(len, takes))
    one, other = (
        Take(t.time[:count], t.positions[:count], t.state[:count], t.skeleton)
        for t in takes
    )
    other = without(other, [*range(10), *range(60, 75)])
    return write_text(tmp_path / "two.skeleton", ntu_text([one, other]))


def test_clean_writes_a_clip_for_each_person(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = people(tmp_path), tmp_path / "clip.npz"
    # One alone shows less of the tilt than both.
    quick = ["--no-physics", "--method", "none", "--tilt", "0"]
    assert main(["clean", str(path), "-o", str(out), "--body", "all", *quick]) == 0
    assert not out.exists()
    clips = [read_clip(tmp_path / f"clip.{k}.npz") for k in (1, 2)]
    takes = read_takes(path)
    for clip, take in zip(clips, takes, strict=True):
        np.testing.assert_array_equal(clip.time, take.time)
        assert np.isfinite(clip.positions).all()
    capsys.readouterr()
    assert main(["clean", str(path), "-o", str(out), *quick]) == 0
    assert "body 1 of 2" in capsys.readouterr().out
    np.testing.assert_array_equal(read_clip(out).positions, clips[0].positions)


def test_people_go_into_one_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = people(tmp_path), tmp_path / "clip.glb"
    quick = ["--no-physics", "--method", "none"]
    words = ["clean", str(path), "-o", str(out), "--body", "all", "--one-file", *quick]
    assert main(words) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clip.glb", path.name]
    assert contents_of(out)["people"] == 2
    assert capsys.readouterr().out.count("wrote") == 1
    out.unlink()
    for wrong, told in (
        (["--begin", "1"], "--begin"),
        (["--gaps", "split"], "--gaps split"),
        (["--body", "1"], "--body all"),
        (["-o", str(tmp_path / "clip.usdc")], ".glb"),
        (["-o", str(path)], ".glb"),
    ):
        assert main([*words, *wrong]) == 2
        assert told in capsys.readouterr().err
        assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_an_unknown_body_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a", ntu_text([made_up()]))
    assert main(["clean", str(path), "-o", str(tmp_path / "c.usda"), "--body=3"]) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("written", ["--save-contacts", "-o"])
def test_no_persons_file_overwrites_the_take(
    written: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = ntu_text([made_up(), made_up(seed=1)])
    path = write_text(tmp_path / "mine.2.csv", text)
    names = {"-o": "clip.bvh"} | {written: "mine.csv"}
    files = [part for pair in names.items() for part in pair]
    monkeypatch.chdir(tmp_path)
    assert main(["clean", path.name, "--body=all", *files]) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["mine.2.csv"]
    assert path.read_text(encoding="utf-8") == text


def test_who_is_cut_off_by_the_edge_of_the_view_stays_who_they_are() -> None:
    """A tracker that loses the legs puts them near the trunk, and then starts anew."""
    take, skeleton = moving(180, 0.0, 0.3), KINECT_V2
    positions = take.positions.copy()
    legs = [j for hip in skeleton.hips for j in skeleton.descendants(hip)]
    positions[150:, legs, 1] = 0.5 * positions[150:, legs, 1]
    numbers = np.zeros(180, dtype=int)
    numbers[150:] = 1
    tracks = [
        Track(
            take.time,
            np.where((numbers == k)[:, None, None], positions, np.nan),
            skeleton,
        )
        for k in range(2)
    ]
    assert len(people_of(tracks)) == 1
