"""``kinefilter live`` and ``replay`` as processes: pipes, signals, endings."""

from __future__ import annotations

import asyncio
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tyro
from live_session import PATIENCE, SAMPLE, Sender, sample_frame

from kinefilter import read_take, scenes
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.commands.live import Live, Replay, _show, status, summary
from kinefilter.pipeline.commands.terminal import stopped_by_signals
from kinefilter.pipeline.live.endpoints import Address
from kinefilter.pipeline.live.live_config import AccessConfig, LiveConfig
from kinefilter.pipeline.live.live_session import Session
from kinefilter.pipeline.live.messages import Reason, format_frame
from kinefilter.pipeline.live.tally import Event

KINEFILTER = [sys.executable, "-m", "kinefilter.pipeline.cli"]
KNOWN = ["--skeleton", "kinect_v1", "--height", "1.8"]


@contextmanager
def recording(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], Sender]]:
    """Run live from UDP to its standard output, with a recording."""
    command = [*KINEFILTER, "live", "--in", "udp://127.0.0.1:0", "--out", "-", *KNOWN]
    process = subprocess.Popen(
        [*command, "--record", str(folder / "take.csv")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stderr is not None
    found = re.search(rb":(\d+)", process.stderr.readline())
    assert found is not None
    try:
        yield process, Sender(Address("udp", "127.0.0.1", int(found[1])))
    finally:
        process.kill()
        process.communicate()


def test_sigterm_finishes_the_recording(tmp_path: Path) -> None:
    with recording(tmp_path) as (process, sender):
        assert process.stdout is not None
        process.stdout.readline()  # the joints' names
        for row in range(12):
            sender.send(sample_frame(row))
            process.stdout.readline()
        process.terminate()
        _, said = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0
        assert b"wrote" in said
    assert [path.name for path in tmp_path.iterdir()] == ["take.csv"]
    take = read_take(tmp_path / "take.csv")
    np.testing.assert_allclose(take.positions, SAMPLE.positions[:12], atol=1e-5)


def test_a_kill_leaves_a_take_that_clean_reads(tmp_path: Path) -> None:
    part = tmp_path / "take.1.part.csv"
    with recording(tmp_path) as (process, sender):
        until, row = time.monotonic() + PATIENCE, 0
        while not part.exists() or part.read_bytes().count(b"\n") < 10:
            assert time.monotonic() < until
            sender.send(sample_frame(row % 290, time=row / 30.0))
            assert process.stdout is not None
            os.read(process.stdout.fileno(), 2**16)
            row += 1
        process.kill()
        process.wait()
    take = read_take(part)
    assert 9 <= len(take) <= row
    arguments = ["clean", str(part), "-o", str(tmp_path / "clip.npz")]
    assert main([*arguments, "--no-physics", "--method", "none"]) == 0


def test_help_and_import_load_neither_sockets_nor_physics() -> None:
    code = """if True:
        import sys
        import kinefilter.pipeline
        from kinefilter.pipeline.cli import main
        try:
            main(["live", "--help"])
        except SystemExit:
            pass
        loaded = {"websockets", "pythonosc", "mujoco", "sklearn"} & set(sys.modules)
        sys.exit(f"loaded {loaded}" if loaded else 0)
    """
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["live", "--in", "udp://0.0.0.0:0", "--out", "-"],
        ["live", "--in", "-", "--out", "udp://127.0.0.1:1"],
        ["live", "--in", "-", "--out", "-", "--record", "take.bvh"],
        ["live", "--in", "-", "--out", "-", "--token-file", "absent"],
        ["live", "--in", "-", "--out", "-", "--floor", "nan"],
        ["replay", "absent.csv", "--out", "-"],
        ["replay", str(scenes.SAMPLE), "--out", "vmc://127.0.0.1:1"],
        ["replay", str(scenes.SAMPLE), "--out", "-", "--speed", "0"],
        ["replay", str(scenes.SAMPLE), "--out", "udp://no.such.host.invalid:1"],
    ],
)
def test_what_cannot_be_done_is_told_in_one_line_with_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.startswith("kinefilter: ")
    assert said.count("\n") == 1


def test_a_replay_that_nobody_takes_is_not_done(
    capsys: pytest.CaptureFixture[str],
) -> None:
    nobody = ["--out", "ws://127.0.0.1:1", "--speed", "99"]
    assert main(["replay", str(scenes.SAMPLE), *nobody]) == 2
    assert "start the receiver" in capsys.readouterr().err


def test_the_commands_of_the_readme_are_possible() -> None:
    readme = Path(__file__).parents[1].joinpath("README.md").read_text(encoding="utf-8")
    (live,) = map(shlex.split, re.findall(r"`(kinefilter live .*?)`", readme))
    (replay,) = map(shlex.split, re.findall(r"^kinefilter replay .*$", readme, re.M))
    following = tyro.cli(Live, args=live[2:])
    session = Session(replace(following.config, record=None), following.access)
    ends = session.endpoints
    schemes = [place.scheme for place in (*ends.sources, *ends.targets)]
    assert schemes == ["udp", "vmc", "ws"]
    sending = tyro.cli(Replay, args=replay[2:])
    assert str(ends.sources[0]) == sending.out


@pytest.mark.parametrize(
    ("out", "bind", "given", "told", "warned"),
    [
        ("ws://127.0.0.1:1", None, True, False, False),
        ("ws://127.0.0.1:1", "127.0.0.1", True, False, False),
        ("ws://127.0.0.1:1", "0.0.0.0", True, False, True),
        ("ws://127.0.0.1:1", "0.0.0.0", False, True, True),
        ("vmc://127.0.0.1:1", "0.0.0.0", False, False, False),
    ],
)
def test_a_token_is_printed_where_nobody_knows_it_yet(
    out: str,
    bind: str | None,
    given: bool,
    told: bool,
    warned: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    secret = tmp_path / "token"
    secret.write_text("0123456789abcdef", encoding="utf-8")
    access = AccessConfig(bind, secret if given else None)
    live = Live(LiveConfig(("udp://127.0.0.1:1",), (out,)), access)
    session = Session(live.config, live.access)
    ends = session.endpoints
    live._print_places(session, [*ends.sources, *ends.targets])
    said = capsys.readouterr().err
    assert ("\ntoken " in said) is told
    assert "0123456789abcdef" not in said
    assert ("anyone on the network" in said) is warned


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_each_way_of_asking_to_end_is_heard_and_then_forgotten(name: str) -> None:
    number = getattr(signal, name)
    before = signal.getsignal(number)

    async def waiting() -> None:
        stop = asyncio.Event()
        with stopped_by_signals(stop):
            signal.raise_signal(number)
            async with asyncio.timeout(PATIENCE):
                await stop.wait()

    asyncio.run(waiting())
    assert signal.getsignal(number) is before


def test_status_and_summary_tell_what_happened() -> None:
    session = Session(LiveConfig(("-",), ("-",), skeleton="kinect_v1"))
    session.receive(format_frame(sample_frame(0)))
    session.receive("nonsense")
    session.receive('{"time": 1.0, "joints": [null]}')
    session.tally.events[Event.POSES] += 1
    session.tally.latency.add(0.0042)
    line = status(session)
    for words in (
        "1 person, measuring 1",
        "1 frame in, 1 pose out",
        "4.2 ms",
        "2 malformed",
    ):
        assert words in line
    table = summary(session.tally)
    cells = [str(cell) for column in table.columns for cell in column.cells]
    assert f"malformed: {Reason.NOT_JSON}" in cells
    assert "1 joint, but kinect_v1 has 20" in cells
    assert str(Event.LATE) not in cells


def test_frames_of_another_skeleton_are_told_at_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    session = Session(LiveConfig(("-",), ("-",)))
    session.receive(format_frame(sample_frame(0)))

    async def show() -> None:
        with suppress(TimeoutError):
            await asyncio.wait_for(_show(session), 1.0)

    asyncio.run(show())
    said = capsys.readouterr().err
    assert said == "20 joints, but kinect_v2 has 25: give --skeleton kinect_v1\n"
