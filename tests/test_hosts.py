"""Windows, macOS and Linux: nothing may need what one of them lacks."""

from __future__ import annotations

import ast
import io
import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from batch_folders import rows_of
from batch_takes import short_take
from live_session import sample_frame
from published_layouts import azure_json, msr_action3d_text, msrc_12_text, ntu_text
from test_mocap_files import ARM, ARM_MOTION
from test_packaging import SOURCES

from kinefilter.characters import KINECT_V2, Clip, InputError, Take
from kinefilter.pipeline import cli
from kinefilter.pipeline.batch.store import Store, is_url
from kinefilter.pipeline.formats import (
    files,
    guarded,
    read_bvh,
    read_contacts,
    read_recording,
    write_clip,
    write_take_csv,
)
from kinefilter.pipeline.formats.acclaim import read_amc, read_asf
from kinefilter.pipeline.live.messages import format_frame
from kinefilter.pipeline.settings import read_settings

HERE = Path(__file__).parent
KINEFILTER = [sys.executable, "-m", "kinefilter.pipeline.cli"]
QUICK = ["--method", "none", "--no-physics", "--to", "bvh", "--jobs", "1"]
BARE = {  # what makes every process do without what Windows does not have
    **os.environ,
    "PYTHONPATH": os.pathsep.join([str(HERE / "bare_host"), str(HERE)]),
    "PYTHONWARNDEFAULTENCODING": "1",
}
# Runs the batch of the command line with workers that die over some takes.
DYING = (
    "import sys, dying; from kinefilter.pipeline.batch import run; "
    "from kinefilter.pipeline import cli; run.clean_file = dying.clean_or_die; "
    "sys.exit(cli.main())"
)
# Holds an output folder until it is ended.
HOLDING = (
    "import sys; from kinefilter.pipeline.batch.manifest import open_manifest; "
    "from kinefilter.pipeline.batch.store import store_at\n"
    "with open_manifest(store_at(sys.argv[1])): print(flush=True); sys.stdin.read()"
)


def bare(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, env=BARE, capture_output=True, encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder of takes, over one of which a worker may die, with a clip."""
    (tmp_path / "takes" / "monday").mkdir(parents=True)
    for k, name in enumerate(("deadly", "monday/wave", "monday/stoß")):
        write_take_csv(short_take(20, seed=k), tmp_path / "takes" / f"{name}.csv")
    return tmp_path


def test_a_batch_goes_on_after_workers_that_died(folder: Path) -> None:
    takes, out = str(folder / "takes"), folder / "clips"
    batch = ["batch", takes, "-o", str(out), *QUICK]
    done = bare(sys.executable, "-c", DYING, *batch)
    assert done.returncode == 1, done.stderr
    assert {row.take: row.status for row in rows_of(out)} == {
        "deadly.csv": "failed",
        "monday/wave.csv": "done",
        "monday/stoß.csv": "done",
    }
    done = bare(*KINEFILTER, *batch)
    assert done.returncode == 0, done.stderr
    assert "1 take cleaned, 0 failed, 2 already done" in done.stdout
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*.*vh")) == [
        "deadly.bvh",
        "monday/stoß.bvh",
        "monday/wave.bvh",
    ]


def test_one_run_at_a_time_until_it_is_ended_or_killed(folder: Path) -> None:
    out = folder / "clips"
    first = subprocess.Popen(
        [sys.executable, "-c", HOLDING, str(out)],
        env=BARE,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with first, ExitStack() as ending:
        ending.callback(first.kill)
        assert first.stdout is not None
        first.stdout.readline()
        batch = [*KINEFILTER, "batch", str(folder / "takes"), "-o", str(out), *QUICK]
        second = bare(*batch)
        assert second.returncode == 2
        assert "another run is writing there" in second.stderr
        assert rows_of(out) == []
    third = bare(*batch)
    assert third.returncode == 0, third.stderr
    assert {row.status for row in rows_of(out)} == {"done"}


def test_live_follows_datagrams_and_pipes_and_ends_when_asked() -> None:
    known = ["--skeleton", "kinect_v1", "--height", "1.8", "--out", "-"]
    frames = [format_frame(sample_frame(row)).encode() + b"\n" for row in range(4)]
    live = [*KINEFILTER, "live", *known, "--in"]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen([*live, "udp://127.0.0.1:0"], env=BARE, **pipes)
    with process, ExitStack() as ending:
        ending.callback(process.kill)
        sender = ending.enter_context(socket.socket(type=socket.SOCK_DGRAM))
        assert process.stderr is not None
        assert process.stdout is not None
        found = re.search(rb"from udp://.*?:(\d+)", said := process.stderr.readline())
        assert found, said
        process.stdout.readline()  # the joints' names
        times = []
        for frame in frames:
            sender.sendto(frame, ("127.0.0.1", int(found[1])))
            times.append(json.loads(process.stdout.readline())["time"])
        process.terminate()
        assert process.wait() == 0
    assert times == [row / 30.0 for row in range(4)]
    done = subprocess.run(
        [*live, "-"], env=BARE, input=b"".join(frames), capture_output=True
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 1 + len(frames)


def test_c3d_and_usd_are_read_in_bounded_memory(
    tmp_path: Path, make_clip: Callable[..., Clip], monkeypatch: pytest.MonkeyPatch
) -> None:
    # On Linux the system bounds it; this is how it is bounded elsewhere.
    path = str(tmp_path / "clip.usdc")
    write_clip(make_clip(), path)
    monkeypatch.setattr(guarded, "_MEMORY", 1)
    monkeypatch.setattr(guarded, "_INTERVAL", 0.01)
    with pytest.raises(InputError, match=r"the reader failed .* too large"):
        guarded.read_guarded("usd_reader:clip_arrays", path)
    # Longer clips may take more: that of an hour needs over 2 GB of address space.
    monkeypatch.setattr(guarded, "_MEMORY_PER_BYTE", 2**20)
    assert "positions" in guarded.read_guarded("usd_reader:clip_arrays", path)


def test_a_file_that_takes_too_long_to_read_is_refused(
    tmp_path: Path, make_clip: Callable[..., Clip], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_clip(make_clip(), tmp_path / "clip.usdc")
    for seconds in ("_SECONDS", "_PER_BYTE"):
        monkeypatch.setattr(guarded, seconds, 0.0)
    monkeypatch.setattr(guarded, "_INTERVAL", 0.01)
    with pytest.raises(InputError, match=r"takes over 0 s to read"):
        guarded.read_guarded("usd_reader:clip_arrays", str(tmp_path / "clip.usdc"))


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_names_are_printed_on_consoles_that_lack_their_letters(
    tmp_path: Path, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_take_csv(short_take(20), tmp_path / "手を振る.csv")
    for arguments in (["info", "手を振る.csv"], ["--help"], ["clean", "--help"]):
        written = io.BytesIO()
        monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding))
        monkeypatch.chdir(tmp_path)
        try:
            assert cli.main(arguments) == 0
        except SystemExit as end:  # of --help
            assert not end.code  # noqa: PT017
        sys.stdout.flush()
        assert written.getvalue()


def test_what_is_open_elsewhere_is_kept_and_the_error_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "clip.bvh"
    path.write_bytes(b"old")

    def refuse(*_: object) -> None:
        raise PermissionError(13, "used by another process")

    monkeypatch.setattr(Path, "replace", refuse)
    wrong = r"clip\.bvh: .*used by another process.*close it in other programs"
    with pytest.raises(InputError, match=wrong), files.new_text(path) as file:
        file.write("new")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"clip.bvh": b"old"}


def test_names_that_windows_takes_for_devices_are_refused_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert files.check_folder(tmp_path / "aux.csv")
    monkeypatch.setattr(files, "_WINDOWS", True)
    for name in ("aux.csv", "NUL", "com1.take.bvh", "a:b.csv", "what?.usdc", "end."):
        with pytest.raises(InputError, match="Windows reserves such names"):
            files.check_folder(tmp_path / name)
    for name in ("auxiliary.csv", "com.csv", "aux-1.csv", ".hidden", "a b.csv"):
        assert files.check_folder(tmp_path / name)


def test_drives_are_no_urls() -> None:
    for path in (r"C:\takes", "C:/takes", "C://takes", r"\\host\takes", "takes/a://b"):
        assert not is_url(path)
    for url in ("s3://bucket/takes", "file:///C:/takes", "simplecache::gs://b/t"):
        assert is_url(url)


def test_a_name_from_a_store_never_leaves_the_output_folder(tmp_path: Path) -> None:
    with Store(str(tmp_path)).writing("/elsewhere/take.bvh") as path:
        assert path.is_relative_to(tmp_path)


def test_texts_with_windows_line_ends_read_the_same(
    tmp_path: Path, make_clip: Callable[..., Clip]
) -> None:
    one, clip = short_take(8), make_clip(8, KINECT_V2)
    two = Take(clip.time, clip.positions, clip.state, KINECT_V2, "made up")
    write_take_csv(one, tmp_path / "take.csv")
    write_clip(clip, tmp_path / "clip.bvh")
    for name, text in {
        "ntu.skeleton": ntu_text([two]),
        "azure.json": azure_json([two]),
        "msr.txt": msr_action3d_text(one),
        "msrc.txt": msrc_12_text(one),
        "arm.asf": ARM,
        "arm.amc": ARM_MOTION,
        "kinefilter.toml": 'method = "none" # quick\nfps = 30\n',
        "contacts.csv": "time,HeelLeft,ToeLeft,HeelRight,ToeRight\n0,1,1,0,0\n",
    }.items():
        (tmp_path / name).write_bytes(text.encode())
    before = _all_read(tmp_path)
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    after = _all_read(tmp_path)
    assert before.keys() == after.keys()
    for name, values in before.items():
        np.testing.assert_equal(after[name], values, err_msg=name)


def _all_read(folder: Path) -> dict[str, object]:
    takes = ("take.csv", "ntu.skeleton", "azure.json", "msr.txt", "msrc.txt")
    bvh = read_bvh(folder / "clip.bvh")
    amc = read_amc(folder / "arm.amc", read_asf(folder / "arm.asf"))
    read: dict[str, object] = {
        "bvh": (bvh.names, bvh.offsets, bvh.motion),
        "amc": (amc.names, amc.positions, amc.rotations),
        "contacts": read_contacts(folder / "contacts.csv", np.arange(3.0)),
        "settings": dict(read_settings(folder / "kinefilter.toml").values),
    }
    for name in takes:
        (take,) = read_recording(folder / name).takes
        read[name] = (take.time, take.positions, take.state)
    return read


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.name)
def test_texts_are_written_with_the_same_bytes_on_every_system(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            words = [a.value for a in node.args if isinstance(a, ast.Constant)]
            text = node.func.attr == "open" and {"w", "x", "a"} & {*words}
            text = text and ast.unparse(node.func) != "av.open"  # which writes videos
            if node.func.attr == "write_text" or text:
                assert "newline" in {k.arg for k in node.keywords}, ast.unparse(node)
