"""FBX by somebody's own Blender: what is said where there is none, and what is left.

Where Blender puts joints, skin and props of the FBX is in ``test_blender.py``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinefilter.characters import Clip, InputError
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import Export, check_writable, fbx, write_clip

MakeClip = Callable[..., Clip]
SAMPLE = Path(__file__).parents[1] / "scenes" / "takes" / "wave_punch_bend.csv"
PYTHON = Export(blender=sys.executable)
COPIED = """
import shutil, sys
folder = sys.argv[sys.argv.index("--") + 1]
shutil.copy(f"{folder}/clip.glb", f"{folder}/clip.fbx")
"""


@pytest.fixture
def scripted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Return what lets a Python stand for Blender, and where temporary files go."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))

    def stand_in(text: str) -> Path:
        (tmp_path / "script.py").write_text(text)
        monkeypatch.setattr(fbx, "_SCRIPT", tmp_path / "script.py")
        return folder

    return stand_in


def test_what_blender_makes_takes_its_place_and_nothing_else_is_left(
    make_clip: MakeClip, tmp_path: Path, scripted: Callable[[str], Path]
) -> None:
    temporary, out = scripted(COPIED), tmp_path / "out"
    out.mkdir()
    write_clip(make_clip(12), out / "clip.fbx", PYTHON)
    assert (out / "clip.fbx").read_bytes()[:4] == b"glTF"
    assert [*out.iterdir()] == [out / "clip.fbx"]
    assert [*temporary.iterdir()] == []


def test_frames_are_even_and_the_rate_is_the_whole_one_that_the_stamps_mean(
    make_clip: MakeClip, tmp_path: Path, scripted: Callable[[str], Path]
) -> None:
    out = tmp_path / "told.txt"
    scripted(COPIED + f"open({str(out)!r}, 'w').write(' '.join(sys.argv[-3:]))")
    steps = np.resize([0.0333, 0.0334, 0.0333, 0.0667], 19)
    clip = make_clip(20, time=np.concatenate([[3.0], 3.0 + np.cumsum(steps)]))
    write_clip(clip, tmp_path / "clip.fbx", PYTHON)
    frames, rate, _ = out.read_text().split()
    assert (int(frames), float(rate)) == (int(steps.sum() * 30) + 1, 30.0)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("print('Error: no such operator')\nprint('bye')", "Error: no such operator"),
        ("raise SystemExit(3)", "wrote no FBX"),
        ("import time; time.sleep(600)", "took over 1 s and was ended"),
    ],
)
def test_where_blender_fails_an_older_file_stays(
    make_clip: MakeClip,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    scripted: Callable[[str], Path],
    script: str,
    words: str,
) -> None:
    temporary, out = scripted(script), tmp_path / "out" / "clip.fbx"
    out.parent.mkdir()
    out.write_text("older")
    if "sleep" in script:
        monkeypatch.setattr(fbx, "_SECONDS", 1.0)
        monkeypatch.setattr(fbx, "_PER_FRAME", 0.0)
    with pytest.raises(InputError, match=words) as caught:
        write_clip(make_clip(4), out, PYTHON)
    assert str(out) in str(caught.value)
    assert out.read_text() == "older"
    assert [*out.parent.iterdir()] == [out]
    assert [*temporary.iterdir()] == []


def test_without_blender_nothing_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("KINEFILTER_BLENDER", raising=False)
    out = tmp_path / "clip.fbx"
    with pytest.raises(InputError, match=r"blender\.org.*--blender.*, or write \.glb"):
        check_writable(out, Export())
    monkeypatch.setenv("KINEFILTER_BLENDER", sys.executable)
    check_writable(out, Export())
    flags = ["--blender", str(tmp_path / "blender")]
    assert main(["clean", str(SAMPLE), "-o", str(out), *flags]) == 2
    assert "no such program" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


def test_a_program_that_does_not_start_is_told(
    make_clip: MakeClip, tmp_path: Path
) -> None:
    program = tmp_path / ("blender.exe" if os.name == "nt" else "blender")
    program.write_bytes(b"\0")
    program.chmod(0o700)
    with pytest.raises(InputError, match="cannot be run"):
        write_clip(make_clip(4), tmp_path / "clip.fbx", Export(blender=str(program)))


def test_no_file_beside_takes_says_what_program_is_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "kinefilter.toml").write_text('blender = "evil"\n')
    (tmp_path / "take.csv").write_bytes(SAMPLE.read_bytes())
    out = tmp_path / "clips"
    assert main(["batch", str(tmp_path), "-o", str(out), "--to", "fbx"]) == 2
    assert "unknown key 'blender'" in capsys.readouterr().err


def test_it_ends_and_tidies_up_when_nobody_waits_any_more(tmp_path: Path) -> None:
    folder, modules = tmp_path / "folder", tmp_path / "modules"
    folder.mkdir()
    modules.mkdir()
    (modules / "bpy.py").write_text(
        "import threading\nprint('begun', flush=True)\nthreading.Event().wait()\n"
    )
    command = [*fbx.blender_command(sys.executable), str(folder), "4", "30.0", "24"]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(modules)},
    ) as blender:
        try:
            assert blender.stdin is not None
            assert blender.stdout is not None
            assert blender.stdout.readline().strip() == b"begun"
            blender.stdin.close()
            assert blender.wait(30) == 1
        finally:
            blender.kill()
    assert not folder.exists()
