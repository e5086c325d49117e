"""What README tells to type runs."""

from __future__ import annotations

import os
import re
import shlex
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from short_takes import write_short_sample
from viewing import ended, viewing

from kinefilter.characters import KINECT_V1
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.database import builtin_database
from kinefilter.pipeline.lab import training

ROOT = Path(__file__).parents[1]
BRIEF = 40  # frames of the sample, and of each clip of pairs


def test_every_command_is_in_the_readme() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for command in (
        *("clean", "info", "database build", "pair", "train", "evaluate"),
        *("simulate", "reproduce", "bench", "character", "render"),
        *("report", "view", "live", "replay", "batch", "rate", "ratings", "blender"),
    ):
        assert f"kinefilter {command}" in readme


def _commands(file: str = "README.md") -> list[str]:
    text = (ROOT / file).read_text(encoding="utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    commands = [part.strip() for line in lines for part in line.split("&&")]
    return [c for c in commands if c.startswith("kinefilter ")]


@pytest.fixture
def little(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands of the lab learn from less than they do for users."""
    monkeypatch.setattr(training, "_SIMULATED", 4)


@pytest.fixture
def takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder; return one of takes like scenes/takes, but brief."""
    monkeypatch.chdir(tmp_path)
    path = write_short_sample(tmp_path / "takes", BRIEF)
    monkeypatch.setattr("kinefilter.pipeline.lab.bench.SAMPLE", path)
    return path.parent


@pytest.mark.usefixtures("interruptible", "little", "few_for_kernels", "brief_bench")
def test_every_readme_command_runs(takes: Path, tmp_path: Path) -> None:
    commands = _commands()
    assert len(commands) >= 5
    for command in commands:
        if "cmu.npz" in command and not (tmp_path / "cmu.npz").exists():
            builtin_database(KINECT_V1).save(tmp_path / "cmu.npz")
        recorded = "shared" in command or "model" in command
        if recorded and not (ROOT.parent / "shared").is_dir():
            continue
        if command.startswith("kinefilter view "):  # which serves until it is ended
            _serves_until_ended(_arguments(command, takes)[1:])
        else:
            assert main(_arguments(command, takes)) == 0, command
        if "--pairs pairs.npz" in command:
            _few_clips(tmp_path / "pairs.npz", 1)


def test_every_command_for_a_tool_writes_what_the_tool_gets(
    takes: Path, tmp_path: Path
) -> None:
    text = (ROOT / "pipeline/formats/TOOLS.md").read_text(encoding="utf-8")
    files = set(re.findall(r"-o (\S+)", text))
    # What is said of a file in the table is of one that a command writes.
    rows = [line.split("|") for line in text.splitlines() if line[:1] == "|"]
    assert {file for row in rows for file in re.findall(r"`(.+?)`", row[2])} == files
    blender = os.environ.get("KINEFILTER_BLENDER")
    for command in _commands("pipeline/formats/TOOLS.md"):
        words = _arguments(command, takes)
        if ".fbx" in command:
            if blender is None:
                continue
            words += ["--blender", blender]
        assert main(words) == 0, command
    written = {file.name for file in tmp_path.iterdir()}
    assert written >= {f for f in files if blender or not f.endswith(".fbx")}


def _serves_until_ended(arguments: list[str]) -> None:
    with viewing(arguments) as (process, address):
        with urllib.request.urlopen(address, timeout=20) as page:
            assert page.status == 200
        assert ended(process) == (0, "")


def _arguments(command: str, takes: Path) -> list[str]:
    """Return a README command's words, its paths resolved as if in the checkout.

    The folder of takes is the one given.
    """
    words = shlex.split(command)[1:]
    paths = {"scenes/takes": takes, "../shared": ROOT.parent / "shared"}
    resolved: list[str] = []
    for word in words:
        for prefix, folder in paths.items():
            if word.startswith(prefix):
                word = f"{folder}{word.removeprefix(prefix)}"
        if "*" in word:
            matches = sorted(Path(word).parent.glob(Path(word).name))
            resolved += [str(_few_clips(p)) for p in matches[:2]]
        else:
            resolved.append(word)
    return resolved


def _few_clips(path: Path, every: int = 25) -> Path:
    """Return a file as it is, or pairs cut to a few short clips, in this folder."""
    if path.suffix != ".npz":
        return path
    with np.load(path) as file:
        arrays = dict(file)
    for name in ("clip", "start", "stop"):
        arrays[name] = arrays[name][::every]
    arrays["stop"] = np.minimum(arrays["stop"], arrays["start"] + BRIEF)
    np.savez_compressed(path.name, **arrays)
    return Path(path.name)


def test_the_readmes_python_runs(takes: Path, tmp_path: Path) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", readme, re.DOTALL)
    assert blocks
    for block in blocks:
        code = block.replace("scenes/takes", takes.as_posix())
        exec(compile(code, "README.md", "exec"), {})
    assert any(path.is_file() for path in tmp_path.iterdir())
