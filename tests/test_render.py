"""``kinefilter render``: the files it writes, and those it does not."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import MakeClip
from dying import draw_or_die

from kinefilter.characters import InputError
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.commands import view as command
from kinefilter.pipeline.formats import write_clip, write_take_csv
from kinefilter.pipeline.look import video, video_files
from kinefilter.pipeline.look.options import Look
from kinefilter.pipeline.look.video import render_clips
from kinefilter.pipeline.look.video_opengl import Backend, find_backend

SMALL = Look(size="96x54")
TINY = ["--size", "32x18", "--jobs", "1"]


@pytest.fixture(scope="session")
def found() -> Backend:
    try:
        return find_backend()
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture
def backend(found: Backend, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """Return what draws here, found once for all tests."""
    monkeypatch.setattr(video, "find_backend", lambda: found)
    return found


@pytest.fixture
def no_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let tests go on that do not get as far as drawing."""
    monkeypatch.setattr(video, "find_backend", lambda: Backend("none", "nothing"))


def _decoded(path: Path) -> tuple[list[np.ndarray], list[Any], Any]:
    """Return the pictures of a video, its frames and their rate [1/s]."""
    import av

    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        frames = list(file.decode(stream))
        rate = stream.average_rate  # of an open file only
        return [f.to_ndarray(format="rgb24") for f in frames], frames, rate


@pytest.mark.usefixtures("backend")
def test_a_video_is_the_same_whatever_the_processes(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = tmp_path / "clip.npz"
    write_clip(make_clip(70), clip)
    for jobs in (1, 2):
        render_clips([clip], tmp_path / f"{jobs}.mp4", SMALL, jobs=jobs)
    one, two = ((tmp_path / f"{jobs}.mp4").read_bytes() for jobs in (1, 2))
    assert one == two
    pictures, frames, rate = _decoded(tmp_path / "2.mp4")
    assert len(pictures) == 70
    assert rate == 30
    assert pictures[0].shape == (54, 96, 3)
    assert [k for k, frame in enumerate(frames) if frame.key_frame] == [0, 60]
    times = [float(frame.pts * frame.time_base) for frame in frames]
    assert times == pytest.approx(np.arange(70) / 30.0, abs=1e-3)
    for before, after in zip(pictures[::20], pictures[20::20], strict=False):
        assert np.abs(after.astype(int) - before).max() > 30  # somebody moves


def test_a_video_is_the_same_with_and_without_vector_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    y, x = np.mgrid[:54, :96]
    waves = [127 + 100 * np.sin((x + 2 * k) / 9 + y / 7) for k in range(20)]
    pictures = [np.stack([wave.astype(np.uint8)] * 3, axis=-1) for wave in waves]
    coded = video_files.encode_video(pictures, (96, 54), 30.0)
    plain = {**video_files._X264, "x264-params": "asm=0"}
    monkeypatch.setattr(video_files, "_X264", plain)
    assert coded == video_files.encode_video(pictures, (96, 54), 30.0)


@pytest.mark.usefixtures("backend")
def test_a_gif_plays_for_ever_as_fast_as_the_clip(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip, out = tmp_path / "clip.npz", tmp_path / "clip.gif"
    write_clip(make_clip(31), clip)
    render_clips([clip], out, replace(SMALL, fps=15), jobs=1)
    assert b"NETSCAPE2.0\x03\x01\x00\x00\x00" in out.read_bytes()
    pictures, frames, _ = _decoded(out)
    assert len(pictures) == 16
    times = [frame.pts * frame.time_base for frame in frames]
    for k, time in enumerate(times):
        assert abs(time - times[0] - Fraction(k, 15)) <= Fraction(1, 100)


@pytest.mark.usefixtures("backend")
def test_numbered_pictures_are_the_same_whatever_the_processes(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = tmp_path / "clip.npz"
    write_clip(make_clip(4), clip)
    drawn = []
    for jobs in (1, 2):
        out = tmp_path / str(jobs) / "%03d.png"
        render_clips([clip], out, SMALL, jobs=jobs)
        drawn.append({f.name: f.read_bytes() for f in out.parent.iterdir()})
    assert sorted(drawn[0]) == [f"{k:03d}.png" for k in range(4)]
    assert drawn[0] == drawn[1]


@pytest.mark.usefixtures("backend")
def test_seams_are_dark_lines_on_the_body_alone(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip, out = tmp_path / "clip.npz", tmp_path / "%d.png"
    write_clip(make_clip(1), clip)
    pictures = []
    for seams in (False, True):
        look = Look(size="320x180", seams=seams)
        render_clips([clip], out.with_name(f"{seams}-%d.png"), look, jobs=1)
        pictures.append(_decoded(tmp_path / f"{seams}-0.png")[0][0].astype(int))
    darker = pictures[0].sum(axis=2) - pictures[1].sum(axis=2)
    assert darker.min() >= 0
    skin = np.ptp(pictures[0], axis=2) > 10  # the floor is gray
    assert 0.02 < np.mean(darker[skin] > 60) < 0.4
    assert np.mean(darker[~skin] > 60) < 0.002


@pytest.mark.usefixtures("backend")
def test_a_broken_clip_does_not_keep_others_from_being_drawn(
    make_clip: MakeClip, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "c"):
        write_clip(make_clip(3), tmp_path / f"{name}.npz")
    (tmp_path / "b.npz").write_text("no clip")
    clips_given = [str(tmp_path / f"{name}.npz") for name in "abc"]
    out = str(tmp_path / "{clip}-drawn.mp4")
    assert main(["render", *clips_given, "-o", out, *TINY]) == 1
    printed = capsys.readouterr()
    assert "b.npz: cannot be read" in printed.err
    assert "drawn with" in printed.out
    drawn = sorted(path.name for path in tmp_path.glob("*.mp4"))
    assert drawn == ["a-drawn.mp4", "c-drawn.mp4"]
    for name in drawn:
        assert len(_decoded(tmp_path / name)[0]) == 3


@pytest.mark.usefixtures("no_backend")
def test_a_clip_that_kills_its_process_is_told_from_the_others(
    make_clip: MakeClip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["deadly", "first", "second"]
    for name in names:
        write_clip(make_clip(3), tmp_path / f"{name}.npz")
    monkeypatch.setattr(video, "draw_parts", draw_or_die)
    files = [tmp_path / f"{name}.npz" for name in names]
    done = render_clips(files, tmp_path / "{clip}-%d.png", SMALL, jobs=2)
    assert len(done.failures) == 1
    assert "deadly.npz: a process drawing it died" in done.failures[0]
    assert [path.name for path in done.written] == ["first-%d.png", "second-%d.png"]
    assert (tmp_path / "second.drawn").exists()


@pytest.mark.usefixtures("backend")
def test_an_interrupted_video_leaves_nothing(
    make_clip: MakeClip,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from contextlib import contextmanager

    def interrupted(_: str, count: int) -> Iterable[int]:
        yield from range(count // 2)
        raise KeyboardInterrupt

    @contextmanager
    def bars() -> Any:
        yield interrupted

    monkeypatch.setattr(command, "progress_bars", bars)
    clip, out = tmp_path / "clip.npz", tmp_path / "clip.mp4"
    write_clip(make_clip(70), clip)
    out.write_text("older")
    assert main(["render", str(clip), "-o", str(out), *TINY]) == 130
    assert capsys.readouterr().err == "kinefilter: interrupted\n"
    assert sorted(tmp_path.iterdir()) == [out, clip]
    assert out.read_text() == "older"


def test_a_full_disk_leaves_nothing(
    found: Backend, make_clip: MakeClip, tmp_path: Path
) -> None:
    clip, folder = tmp_path / "clip.npz", tmp_path / "clip.npz.d"
    write_clip(make_clip(5), clip)
    folder.mkdir()
    # No file may be longer than a kilobyte: the system then says so, as a full disk.
    code = (
        "import resource, sys; from kinefilter.pipeline.cli import main\n"
        "if __name__ == '__main__':\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))\n"
        "    for name in ('clip.mp4', '%d.png'):\n"
        "        print(main([*sys.argv[1:], '-o', sys.argv[2] + '.d/' + name]))\n"
    )
    script = tmp_path / "limited.py"
    script.write_text(code)
    flags = ["--size", "96x54", "--jobs", "1"]
    done = subprocess.run(
        [sys.executable, script, "render", clip, *flags],
        env={**os.environ, **found.environment},
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines() == ["2", "2"], done.stderr
    assert ["cannot be written" in line for line in done.stderr.splitlines()] == [
        True,
        True,
    ]
    assert not any(folder.iterdir())


def test_without_opengl_what_to_install_is_said(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    clip = tmp_path / "clip.npz"
    write_clip(make_clip(3), clip)
    command = [sys.executable, "-m", "kinefilter.pipeline.cli", "render", clip]
    done = subprocess.run(
        [*command, "-o", tmp_path / "clip.mp4"],
        env={**os.environ, "MUJOCO_GL": "nonsense"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1
    assert "libosmesa6" in done.stderr
    assert "unset MUJOCO_GL" in done.stderr
    assert list(tmp_path.iterdir()) == [clip]


def test_who_only_waits_for_pictures_loads_no_opengl() -> None:
    code = (
        "import sys, kinefilter.pipeline.look.video\n"
        "print([m for m in ('mujoco', 'OpenGL', 'av', 'pxr') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.usefixtures("no_backend")
@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["-o", "clip.avi"], "unknown extension '.avi'"),
        (["-o", "clip.png"], "%05d"),
        (["-o", "clip.npz/clip.mp4"], "is a file"),
        (["-o", "clip.npz"], "would overwrite"),
        (["-o", "a.mp4", "--size", "97x54"], "even"),
        (["-o", "a.mp4", "--size", "wide"], "such as 1280x720"),
        (["-o", "a.mp4", "--fps", "0"], "--fps 0"),
        (["-o", "a.gif", "--fps", "60"], "at most 50 frames"),
        (["-o", "a.mp4", "--begin", "3", "--end", "2"], "--begin 3 --end 2"),
        (["-o", "a.mp4", "--begin", "99"], "clip.npz: no frames from 99 s"),
        (["-o", "a.mp4", "--camera", "above"], "three-quarter"),
        (["-o", "a.mp4", "--camera", "absent.toml"], "absent.toml"),
        (["-o", "a.mp4", "--scene", "moon"], "unknown scene 'moon'"),
        (["-o", "a.mp4", "--jobs", "0"], "--jobs 0"),
        (["-o", "a.mp4", "--compare", "absent.csv"], "absent.csv"),
        (["-o", "a.mp4", "--compare", "v2.csv"], "kinect_v2"),
        (["-o", "a.mp4", "--compare", "late.csv"], "clip was made from"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(
    flags: list[str],
    words: str,
    make_clip: MakeClip,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from kinefilter.characters import KINECT_V2

    monkeypatch.chdir(tmp_path)
    write_clip(make_clip(10), "clip.npz")
    write_take_csv(make_clip(10, KINECT_V2), Path("v2.csv"))
    late = make_clip(10)
    write_take_csv(replace(late, time=late.time + 9.0), Path("late.csv"))
    before = sorted(tmp_path.iterdir())
    assert main(["render", "clip.npz", *flags]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.usefixtures("no_backend")
def test_a_clip_of_an_unknown_skeleton_is_refused(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    path = tmp_path / "clip.npz"
    write_clip(make_clip(3), path)
    with np.load(path) as arrays:
        changed = {**arrays, "skeleton": np.array("octopus")}
    np.savez(path, **changed)
    with pytest.raises(InputError, match=r"clip\.npz: unknown skeleton 'octopus'"):
        render_clips([path], tmp_path / "clip.mp4")
