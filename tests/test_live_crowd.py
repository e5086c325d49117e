"""Who is there, how they are measured, and what is recorded of them."""

from __future__ import annotations

import errno
import os
import threading
from collections import Counter
from dataclasses import replace
from io import FileIO
from pathlib import Path

import numpy as np
import pytest
from live_session import SAMPLE, sample_frame

from kinefilter import Avatar, Cleaner, read_take
from kinefilter.characters import KINECT_V1, InputError, standard_body
from kinefilter.pipeline.correct import Hold, LocalPCA
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.live import recorder as recording
from kinefilter.pipeline.live.crowd import Crowd, Person
from kinefilter.pipeline.live.live_config import LiveConfig
from kinefilter.pipeline.live.messages import Frame
from kinefilter.pipeline.live.recorder import Recorder
from kinefilter.pipeline.live.tally import Event, Latency, Tally


def crowd(most: int = 6) -> tuple[Crowd, Tally]:
    tally = Tally()
    return Crowd(most, tally), tally


def test_the_newest_frame_wins_and_older_ones_are_counted() -> None:
    people, tally = crowd()
    for row in range(5):
        people.arrive(sample_frame(row), row / 30.0)
    turn = people.next()
    assert turn is not None
    assert turn[1].time == 4 / 30.0
    assert people.next() is None
    assert tally.events[Event.DROPPED] == 4


def test_who_waits_longest_is_next() -> None:
    people, _ = crowd()
    people.arrive(sample_frame(0, "b"), 0.1)
    people.arrive(sample_frame(0, "a"), 0.2)
    turns = [people.next(), people.next()]
    assert [turn[0].id for turn in turns if turn is not None] == ["b", "a"]


def test_where_poses_are_late_everybody_is_posed_as_often() -> None:
    people, _ = crowd()
    posed: Counter[str] = Counter()
    for row in range(100):
        people.arrive(sample_frame(row, *"abcdef"), row / 30.0)
        for _ in range(3):
            turn = people.next()
            assert turn is not None
            assert turn[1].arrived == row / 30.0  # the newest frame all the same
            posed[turn[0].id] += 1
    assert posed == dict.fromkeys("abcdef", 50)


def test_late_and_repeated_frames_get_no_pose_and_are_counted() -> None:
    people, tally = crowd()
    for row in (0, 1, 1, 0, 2):
        people.arrive(sample_frame(row), 0.0)
        people.next()
    assert tally.events[Event.REPEATED] == tally.events[Event.LATE] == 1
    assert tally.events[Event.DROPPED] == 0


def test_a_clock_that_begins_anew_is_no_late_frame_even_if_it_was_not_posed() -> None:
    people, tally = crowd()
    for time in (1000.0, 0.0, 0.033):
        people.arrive(sample_frame(0, time=time), 0.0)
    turn = people.next()
    assert turn is not None
    assert turn[1].restarted
    assert tally.events[Event.RESTARTED] == 1
    assert tally.events[Event.LATE] == 0


def test_stamps_in_milliseconds_are_told_and_a_pause_in_seconds_is_not() -> None:
    people, tally = crowd()
    for row in range(40):
        pause = 10.0 if row > 20 else 0.0
        people.arrive(sample_frame(row, time=row / 30.0 + pause), row / 30.0)
    assert tally.all_notes() == []
    people, tally = crowd()
    for row in range(20):
        people.arrive(sample_frame(row, time=1e3 * row / 30.0), row / 30.0)
    (note,) = tally.all_notes()
    assert note == ("by their stamps, frames are 33.33 s apart: send times in seconds")


def test_who_is_unseen_for_two_seconds_rests_and_the_number_is_used_again() -> None:
    people, tally = crowd()
    people.arrive(sample_frame(0, "a", "b"), 10.0)
    people.arrive(sample_frame(1, "b"), 11.5)
    assert people.drop_gone(11.9) == []
    (gone,) = people.drop_gone(12.1)
    assert (gone.id, gone.slot) == ("a", 0)
    people.arrive(sample_frame(2, "c", "b"), 12.2)
    turns = {}
    while (turn := people.next()) is not None:
        turns[turn[0].id] = turn[0].slot
    assert turns == {"b": 1, "c": 0}
    assert tally.events[Event.RESTED] == 1
    # Who comes back is a new person, whatever the clock said before.
    people.arrive(sample_frame(0, "a", time=-50.0), 12.3)
    assert tally.events[Event.RESTARTED] == 0


def test_a_frame_without_a_joint_keeps_nobody_here() -> None:
    people, tally = crowd()
    people.arrive(sample_frame(0), 0.0)
    unseen = sample_frame(1)
    unseen.bodies[0].state[:] = 0
    people.arrive(unseen, 1.9)
    assert len(people.drop_gone(2.1)) == 1
    assert tally.events[Event.UNSEEN] == 1


def test_there_is_room_for_as_many_as_allowed_and_ids_do_not_pile_up() -> None:
    people, tally = crowd(2)
    for n in range(1000):
        people.arrive(sample_frame(0, str(n)), n * 1e-3)
    assert len(people) == 2
    assert tally.events[Event.CROWDED] == 998


def _beside(row: int, *bodies: str) -> Frame:
    """Return people who stand side by side, 1.2 m apart, and sway."""
    frame = sample_frame(row, *bodies)
    aside, sway = np.array([1.2, 0.0, 0.0]), 0.05 * (row % 3)
    moved = [
        replace(seen, positions=seen.positions + k * aside + sway)
        for k, seen in enumerate(frame.bodies)
    ]
    return replace(frame, bodies=tuple(moved))


@pytest.mark.parametrize("ids", ["12", "123"])
def test_people_whose_ids_a_tracker_exchanges_stay_who_they_are(ids: str) -> None:
    people, tally = crowd()
    others = {"12": ["21", "12", "21"], "123": ["213", "231", "123"]}[ids]
    for row in range(80):
        given = others[row // 20 - 1] if row >= 20 else ids
        seen = people.arrive(_beside(row, *given), row / 30.0)
        assert [body.id for body in seen] == [*ids]
        at = [float(np.nanmean(body.positions[:, 0])) for body in seen]
        assert (np.diff(at) > 1.0).all()
    assert tally.events[Event.EXCHANGED] >= 3
    assert len(people) == len(ids)


def test_who_walks_past_another_or_comes_back_keeps_the_own_id() -> None:
    people, tally = crowd()
    for row in range(60):
        frame = sample_frame(row, "a", "b")
        shift = [[0.04 * row - 1.2, 0.0, 0.0], [1.2 - 0.04 * row, 0.0, 0.3]]
        moved = [
            replace(seen, positions=seen.positions + by)
            for seen, by in zip(frame.bodies, shift, strict=True)
        ]
        people.arrive(replace(frame, bodies=tuple(moved)), row / 30.0)
    people.arrive(_beside(60, "b", "a"), 4.0)  # both away for two seconds
    assert not tally.events[Event.EXCHANGED]


def test_a_person_is_measured_in_the_first_second_as_the_whole_take_would() -> None:
    person = Person(LiveConfig(("-",), ("-",), skeleton="kinect_v1"))
    poses = []
    for row in range(60):
        (seen,) = sample_frame(row).bodies
        poses.append(person.step(seen, float(SAMPLE.time[row])))
    began = next(k for k, pose in enumerate(poses) if pose is not None)
    assert 1.0 <= SAMPLE.time[began] <= 1.2
    assert all(pose is not None for pose in poses[began:])
    whole = Cleaner().whole(SAMPLE).body
    assert person.avatar is not None
    away = np.abs(person.avatar.body.lengths - whole.lengths)
    assert away.mean() < 0.005
    assert abs(person.avatar.body.height - whole.height) < 0.03


def test_the_correction_of_live_people_can_be_chosen() -> None:
    body = standard_body(KINECT_V1, height=1.8)
    chosen = {
        "local-pca": LocalPCA(builtin_database(KINECT_V1)),
        "none": Hold(KINECT_V1),
    }
    for method, corrector in chosen.items():
        config = LiveConfig(("-",), ("-",), skeleton="kinect_v1", height=1.8)
        person, default = Person(replace(config, method=method)), Person(config)
        avatar = Avatar(body, corrector=corrector)
        for row in range(20):
            (seen,), time = sample_frame(row).bodies, float(SAMPLE.time[row])
            pose, other = person.step(seen, time), default.step(seen, time)
            assert pose is not None
            assert other is not None
            expected = avatar.step(seen.positions, time, seen.state)
            np.testing.assert_array_equal(pose.positions, expected.positions)
        assert np.abs(pose.positions - other.positions).max() > 0.01


def test_who_is_half_hidden_is_measured_after_three_seconds_all_the_same() -> None:
    person = Person(LiveConfig(("-",), ("-",), skeleton="kinect_v1"))
    legs = [
        KINECT_V1.index(f"{j}{s}")
        for j in ("Knee", "Ankle", "Foot", "Hip")
        for s in ("Left", "Right")
    ]
    poses = []
    for row in range(100):
        (seen,) = sample_frame(row).bodies
        seen.positions[legs], seen.state[legs] = np.nan, 0
        poses.append(person.step(seen, row / 30.0))
    began = next(k for k, pose in enumerate(poses) if pose is not None)
    assert 90 <= began <= 92
    assert all(np.isfinite(p.positions).all() for p in poses[began:] if p is not None)


def test_latencies_are_told_to_a_tenth_of_a_millisecond() -> None:
    latency = Latency()
    times = np.random.default_rng(0).gamma(4.0, 1e-3, 5000)
    for seconds in times.tolist():
        latency.add(seconds)
    for share in (0.5, 0.99):
        assert latency.quantile(share) == pytest.approx(
            np.quantile(times, share), abs=2e-4
        )
    assert latency.most == times.max()


def record(recorder: Recorder, rows: range, *bodies: str) -> None:
    for row in rows:
        for seen in sample_frame(row, *bodies).bodies:
            recorder.add(row / 30.0, seen)


def test_a_recording_reads_back_as_it_came(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "take.csv", KINECT_V1, Tally())
    record(recorder, range(50), "1")
    recorder.flush()
    record(recorder, range(50, 80), "1")
    assert recorder.finish() == [tmp_path / "take.csv"]
    take = read_take(tmp_path / "take.csv")
    np.testing.assert_array_equal(take.time, np.arange(80) / 30.0)
    np.testing.assert_allclose(take.positions, SAMPLE.positions[:80], atol=1e-9)
    np.testing.assert_array_equal(take.state, SAMPLE.state[:80])
    assert [path.name for path in tmp_path.iterdir()] == ["take.csv"]


def test_each_of_several_bodies_has_a_file_that_no_id_names(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "take.csv", KINECT_V1, Tally())
    record(recorder, range(20), "../../etc/passwd", "b/*")
    recorder.finish()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["take.1.csv", "take.2.csv"]
    assert all(len(read_take(tmp_path / name)) == 20 for name in names)


def test_what_a_kill_leaves_is_a_take_and_is_not_overwritten(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "take.csv", KINECT_V1, Tally())
    record(recorder, range(30), "1")
    recorder.flush()
    part = tmp_path / "take.1.part.csv"
    assert len(read_take(part)) == 30
    with pytest.raises(InputError, match=r"take\.1\.part\.csv: exists already"):
        Recorder(tmp_path / "take.csv", KINECT_V1, Tally())


def test_a_clock_that_begins_anew_begins_another_file(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "take.csv", KINECT_V1, Tally())
    record(recorder, range(10, 30), "1")
    record(recorder, range(5), "1")
    assert [len(read_take(path)) for path in recorder.finish()] == [20, 5]


def test_a_full_disk_ends_the_recording_and_leaves_whole_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tally = Tally()
    recorder = Recorder(tmp_path / "take.csv", KINECT_V1, tally)
    record(recorder, range(20), "1")
    recorder.flush()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)  # of rows that seem to be written
    record(recorder, range(20, 40), "1")
    recorder.flush()
    assert recorder.failure is not None
    assert "No space left" in recorder.failure
    record(recorder, range(40, 45), "1")
    assert tally.events[Event.UNRECORDED] == 20 + 5
    recorder.finish()
    assert len(read_take(tmp_path / "take.csv")) == 20


def test_the_end_waits_for_what_is_being_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(tmp_path / "take.csv", KINECT_V1, Tally())
    record(recorder, range(10), "1")
    write, overtaken, ends = recording.append_whole, threading.Event(), []

    def slow(file: FileIO, data: bytes) -> None:
        if ends:
            overtaken.set()
        else:
            record(recorder, range(10, 20), "1")
            ends.append(threading.Thread(target=recorder.finish))
            ends[0].start()
            assert not overtaken.wait(0.1)
        write(file, data)

    monkeypatch.setattr(recording, "append_whole", slow)
    recorder.flush()
    ends[0].join()
    take = read_take(tmp_path / "take.csv")
    np.testing.assert_array_equal(take.time, np.arange(20) / 30.0)


def test_a_recording_goes_where_it_can(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name, words in (("take.bvh", "ends in .csv"), ("file/take.csv", "is a file")):
        with pytest.raises(InputError, match=words):
            Recorder(tmp_path / name, KINECT_V1, Tally())
