"""kinefilter view: what it refuses, who may come, and how it ends."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
import viser
from conftest import MakeClip
from short_takes import write_short_sample
from viewing import ended, viewing
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from kinefilter import CleanConfig, clean, read_take
from kinefilter.characters import InputError
from kinefilter.pipeline.batch.manifest import read_rows
from kinefilter.pipeline.batch.outcome_tables import worst_first
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.commands.view import View
from kinefilter.pipeline.formats import write_clip
from kinefilter.pipeline.formats.sheets import write_contacts
from kinefilter.pipeline.look.drawing import Drawing, read_finite_clip
from kinefilter.pipeline.look.viewer import Viewer
from kinefilter.pipeline.look.viewer_server import may_connect, opened_server
from kinefilter.scenes import SAMPLE

QUICK = CleanConfig(method="none", physics=False)


@pytest.mark.parametrize(
    ("origin", "host", "loopback", "allowed"),
    [
        ("http://127.0.0.1:80", "127.0.0.1:80", True, True),
        ("http://localhost:80", "localhost:80", True, True),
        ("http://[::1]:80", "[::1]:80", True, True),
        ("http://127.0.0.2:80", "127.0.0.2:80", True, True),  # --bind 127.0.0.2
        ("https://example.org", "127.0.0.1:80", True, False),
        ("http://127.0.0.1:81", "127.0.0.1:80", True, False),
        ("http://127.0.0.1.example.org:80", "127.0.0.1:80", True, False),
        ("http://example.org:80", "example.org:80", True, False),  # rebound DNS
        ("null", "127.0.0.1:80", True, False),
        (None, "127.0.0.1:80", True, False),
        ("http://studio:80", None, True, False),
        ("http://studio:80", "studio:80", False, True),
        ("http://example.org", "studio:80", False, False),
    ],
)
def test_only_pages_of_its_own_may_connect(
    origin: str | None, host: str | None, loopback: bool, allowed: bool
) -> None:
    assert may_connect(origin, host, loopback=loopback) is allowed


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    with opened_server("127.0.0.1", 0) as opened:
        yield opened


def test_the_server_talks_to_its_page_and_refuses_foreign_ones(
    server: viser.ViserServer,
) -> None:
    here = f"127.0.0.1:{server.get_port()}"
    words = {"subprotocols": [f"viser-v{viser.__version__}"]}
    with connect(f"ws://{here}", origin=f"http://{here}", **words) as page:
        assert page.recv(timeout=10)
    for origin in ("https://example.org", "http://127.0.0.1:1", None):
        with (
            pytest.raises(InvalidStatus) as caught,
            connect(f"ws://{here}", origin=origin, **words),
        ):
            pass
        assert caught.value.response.status_code == 403


def test_a_page_cannot_make_the_server_public(server: viser.ViserServer) -> None:
    assert server.request_share_url() is None


def test_the_server_listens_on_loopback_alone(server: viser.ViserServer) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.2", server.get_port()))  # not taken


def test_a_taken_port_is_an_error_and_no_other_is_tried() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with (
            pytest.raises(InputError, match=f"port {port} .*--port"),
            opened_server("127.0.0.1", port),
        ):
            pass


@pytest.mark.parametrize(
    ("bind", "port", "words"),
    [
        ("192.0.2.1", 0, "not an address of this machine"),
        ("127.0.0.1", 65536, "--port 65536"),
        ("127.0.0.1", -1, "--port -1"),
    ],
)
def test_an_impossible_address_is_refused(bind: str, port: int, words: str) -> None:
    with pytest.raises(InputError, match=words), opened_server(bind, port):
        pass


def _refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["view", *arguments]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1
    return printed


@pytest.fixture(scope="module")
def clip_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "clip.npz"
    write_clip(clean(read_take(SAMPLE).at(slice(60)), QUICK).clip, path)
    return path


def test_what_cannot_be_viewed_is_refused_in_one_line(
    clip_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip, take = str(clip_path), str(SAMPLE)
    contacts, vrma = tmp_path / "take.contacts.csv", tmp_path / "clip.vrma"
    write_clip(read_finite_clip(clip_path), vrma)
    write_contacts(read_finite_clip(clip_path), contacts)
    copied = tmp_path / "malformed.csv"
    copied.write_bytes(SAMPLE.read_bytes())
    copied.with_suffix(".edits.toml").write_text("oddly = 1", encoding="utf-8")
    for arguments, words in (
        ([str(tmp_path / "absent.npz")], "no such file"),
        ([str(tmp_path / "absent.csv")], "no such file"),
        ([str(tmp_path / "absent"), "--take", take], "no such file"),
        ([str(tmp_path)], "no manifest.jsonl"),
        ([clip, "--method", "none"], "cleaning options are for takes"),
        ([clip, "--body", "2"], "--body does not apply to a clip"),
        ([clip, "--take", take, "--take-fps", "30"], "--take-fps does not apply"),
        ([clip, "--take", take, "--format", "bvh"], "--format does not apply"),
        ([str(vrma)], "VRMA and FBX are for other tools"),
        ([take, "--take", take], "requires a clip"),
        ([take, "--edits", take], "would overwrite"),
        ([clip, "--edits", clip], "would overwrite"),
        ([clip, "--edits", str(contacts / "e.toml")], "is a file"),
        ([take, "--contacts", str(contacts), "--edits", str(contacts)], "overwrite"),
        ([str(copied)], "malformed.edits.toml: unknown 'oddly'"),
        ([clip, "--bind", "192.0.2.1"], "not an address of this machine"),
        ([clip, "--port", "70000"], "--port 70000"),
        ([], "nothing to view"),
        ([clip, clip], "only one clip can be shown"),
        ([take, clip], "only one clip can be shown"),
        ([take, "--calibration", clip], "takes of several sensors"),
        ([clip, "--take", take, "--calibration", take], "takes of several sensors"),
        ([take, take], "the takes are identical"),
    ):
        assert words in _refused(arguments, capsys), arguments


def test_the_clips_of_a_batch_are_listed_and_opened_in_turn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    takes, clips = tmp_path / "takes", tmp_path / "clips"
    takes.mkdir()
    for name in ("one", "two", "three"):
        write_short_sample(takes).rename(takes / f"{name}.csv")
    quick = ["--method", "none", "--no-physics", "--to", "npz"]
    assert main(["batch", str(takes), "-o", str(clips), "--jobs", "1", *quick]) == 0
    listed = worst_first(read_rows(clips))
    worst, _, last = (Path(clip.output).stem for _, clip in listed)
    (clips / f"{worst}.npz").unlink()
    opened: list[Viewer] = []

    def run(viewer: Viewer) -> int | None:
        opened.append(viewer)
        wanted = {1: worst, 2: last}.get(len(opened))
        if wanted is None:
            return None
        (name,) = (x for x in viewer._listed if x.startswith(f"{wanted}.csv (force"))
        viewer._requests.put((viewer._choose_take, name))
        return run_page(viewer)

    run_page = Viewer.run
    monkeypatch.setattr(Viewer, "run", run)
    capsys.readouterr()
    assert main(["view", str(clips), "--take", str(takes)]) == 0
    printed = capsys.readouterr()
    assert f"{worst}.npz" in printed.err
    assert printed.out.count("shows") == 1
    first, again, other = opened
    assert len(first._listed) == 3
    assert again._clip.source == first._clip.source  # what could not be opened
    assert other._file.path == takes / f"{last}.edits.toml"
    assert "raw" in other._scene._layers
    assert sorted(takes.iterdir()) == sorted(
        takes / f"{name}.csv" for name in ("one", "two", "three")
    )
    for arguments, words in (
        ([str(clips), "--method", "none"], "apply to a folder"),
        ([str(clips), "--take-fps", "30"], "apply to a folder"),
        ([str(clips), "--take", str(clips)], "has no take of these clips"),
        ([str(takes)], "no manifest.jsonl"),
    ):
        assert words in _refused(arguments, capsys), arguments


def test_another_take_is_not_opened_over_unsaved_edits(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    with opened_server() as server:
        names = ["first", "second"]
        drawing, save = Drawing(make_clip(9)), tmp_path / "e.toml"
        viewer = Viewer(server, drawing, save, listed=names)
        viewer._edit("planted")
        viewer._take.value = "second"
        with pytest.raises(InputError, match="save or undo"):
            viewer._choose_take("second")
        assert viewer._take.value == "first"
        viewer._save()
        viewer._choose_take("second")
        assert viewer.run() == 1


def test_csv_and_bvh_are_clips_only_beside_a_take() -> None:
    take = Path("take.csv")
    for name, alone in (
        *(("clip.npz", True), ("clip.usda", True), ("clip.USDZ", True)),
        *(("clip.csv", False), ("clip.csv.gz", False), ("clip.bvh", False)),
    ):
        assert View((Path(name),))._is_clip is alone
        assert View((Path(name),), take=(take,))._is_clip
    assert not View((take,), take=(take,))._is_clip


def test_without_viser_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert 'pip install "kinefilter[view]"' in _refused([str(SAMPLE)], capsys)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_viewer_says_where_it_is_and_ends_in_peace(
    clip_path: Path, sent: signal.Signals
) -> None:
    before = sorted(clip_path.parent.iterdir())
    with viewing([str(clip_path)]) as (process, address):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+", address)
        with urllib.request.urlopen(address, timeout=10) as page:
            assert page.status == 200
        assert ended(process, sent) == (0, "")
    assert sorted(clip_path.parent.iterdir()) == before


def test_help_and_the_other_commands_do_not_load_viser() -> None:
    code = (
        "import sys, kinefilter.pipeline, kinefilter.pipeline.look\n"
        "from kinefilter.pipeline.cli import main\n"
        "try: main(['view', '--help'])\n"
        "except SystemExit: pass\n"
        "print([m for m in ('viser', 'websockets', 'mujoco') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"
