"""What is installed is what is in the folders."""

from __future__ import annotations

import ast
import importlib
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = ("characters", "retarget", "scenes", "pipeline")  # imports go down
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = CONFIG["tool"]["setuptools"]["packages"]
SOURCES = [p for floor in FLOORS for p in sorted((ROOT / floor).rglob("*.py"))]


def test_every_folder_with_code_is_a_listed_package() -> None:
    folders = {
        ".".join(("kinefilter", *p.parent.relative_to(ROOT).parts)) for p in SOURCES
    }
    assert folders == set(PACKAGES)


def test_the_wheel_holds_every_file(tmp_path: Path) -> None:
    shutil.rmtree(ROOT / "build", ignore_errors=True)  # it keeps deleted modules
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation"]
    subprocess.run(
        [*command, "--outdir", str(tmp_path), str(ROOT)],
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        packed = {n for n in archive.namelist() if n.startswith("kinefilter/")}
    tracked = subprocess.run(
        ["git", "ls-files", *FLOORS], cwd=ROOT, capture_output=True, text=True
    ).stdout.split()
    if not tracked:
        pytest.skip("not a git checkout")
    assert {f"kinefilter/{name}" for name in tracked} <= packed


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_down_and_name_the_package(path: Path) -> None:
    floor = FLOORS.index(path.relative_to(ROOT).parts[0])
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        modules = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            modules = [node.module or ""]
        for module in modules:
            assert module.partition(".")[0] not in FLOORS, f"import kinefilter.{module}"
            if module.startswith("kinefilter."):
                assert FLOORS.index(module.split(".")[1]) <= floor, module


@pytest.mark.parametrize("package", PACKAGES)
def test_all_names_are_there(package: str) -> None:
    module = importlib.import_module(package)
    assert len(set(module.__all__)) == len(module.__all__)
    for name in module.__all__:
        assert hasattr(module, name)
