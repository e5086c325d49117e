"""What is installed is what is in the folders."""

from __future__ import annotations

import ast
import importlib.util
import pkgutil
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Collection, Iterator
from dataclasses import fields, is_dataclass
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType

import pytest

import kinefilter

ROOT = Path(__file__).parents[1]
FLOORS = ("characters", "retarget", "scenes", "pipeline")  # imports go down
LAB = tuple(
    f"kinefilter.{part}" for part in ("pipeline.lab", "scenes.library", "scenes.sensor")
)
DOOR = "kinefilter.pipeline.api"  # gives evaluate too, when it is asked for
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = CONFIG["tool"]["setuptools"]["packages"]
EXAMPLES = ROOT / "scenes" / "examples"  # scripts, in no package
SOURCES = [
    path
    for floor in FLOORS
    for path in sorted((ROOT / floor).rglob("*.py"))
    if path.parent != EXAMPLES
]


def test_every_folder_with_code_is_a_listed_package() -> None:
    folders = {
        ".".join(("kinefilter", *p.parent.relative_to(ROOT).parts)) for p in SOURCES
    }
    # What the package itself gives lies among the floors, so that no folder is added.
    assert folders - {"kinefilter.pipeline.api"} == set(PACKAGES) - {"kinefilter"}


def test_the_sdist_and_the_wheel_made_of_it_hold_every_file(tmp_path: Path) -> None:
    command = ["git", "ls-files", "--", ".", ":!.gitignore", ":!.types"]
    tracked = set(
        subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout.split()
    )
    if not tracked:
        pytest.skip("not a git checkout")
    subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path, ROOT],
        check=True,
        capture_output=True,
    )
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        given = {name.partition("/")[2] for name in archive.getnames()}
    assert tracked <= given
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        installed = set(packed.namelist())
    code = {f"kinefilter/{name}" for name in tracked if name.startswith(FLOORS)}
    code = {name for name in code if "/examples/" not in name}
    code = {name.replace("kinefilter/pipeline/api/", "kinefilter/") for name in code}
    assert code <= installed


def test_every_data_file_has_an_origin_and_every_dependency_a_license() -> None:
    text = (ROOT / "pipeline/embedded/LICENSES.md").read_text(encoding="utf-8")
    data, dependencies = text.split("\n## ")[2:]
    cells = [line.split("|")[1] for line in data.splitlines() if line.startswith("|")]
    named = [name for cell in cells for name in re.findall(r"`(.+?)`", cell)]
    found = {name: set(ROOT.glob(name)) for name in named}
    assert all(found.values()), found
    shipped = {
        path
        for pattern in CONFIG["tool"]["setuptools"]["package-data"]["*"]
        for folder in {path.parent for path in SOURCES}
        for path in folder.glob(pattern)
        if path.suffix not in (".md", ".typed")
    }
    assert shipped == set().union(*found.values())
    assert not [name for name in named if name.endswith("*.npz")]
    extras = CONFIG["project"]["optional-dependencies"]
    wanted = [CONFIG["project"]["dependencies"]]
    wanted += [extras[extra] for extra in extras.keys() - {"test", "release"}]
    packages = {re.split(r"[^\w-]", one)[0] for group in wanted for one in group}
    listed = [line.split("|")[1] for line in dependencies.splitlines() if "|" in line]
    assert packages <= set(re.findall(r"[\w-]+", " ".join(listed)))


def test_every_python_and_system_that_is_promised_is_tested() -> None:
    yaml = pytest.importorskip("yaml")
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    matrix = yaml.safe_load(text)["jobs"]["test"]["strategy"]["matrix"]
    promised = "\n".join(CONFIG["project"]["classifiers"])
    assert matrix["python"] == re.findall(r"Python :: (3\.\d+)$", promised, re.M)
    named = {"ubuntu": "Linux", "windows": "Windows", "macos": "MacOS"}
    assert [named[system.partition("-")[0]] for system in matrix["os"]] == sorted(
        re.findall(r"System :: .*?(\w+)$", promised, re.M),
        key=list(named.values()).index,
    )
    quick = (ROOT / ".ci" / "quick").read_text(encoding="utf-8").split()
    for name in quick:
        path, _, test = name.removeprefix("--deselect=").partition("::")
        assert f"def {test}" in (ROOT / path).read_text(encoding="utf-8")


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
    names = getattr(module, "__all__", [])  # many packages export nothing
    assert len(set(names)) == len(names)
    for name in names:
        assert hasattr(module, name)
    folders = {file.name for file in pkgutil.iter_modules(module.__path__)}
    for name in folders & set(names):
        assert isinstance(getattr(module, name), ModuleType), f"{name} hides its file"


def test_help_tells_what_every_field_is() -> None:
    kinds = [getattr(kinefilter, name) for name in kinefilter.__all__]
    for kind in filter(is_dataclass, kinds):
        if f"``{kind.__name__}``" not in kinefilter.__doc__:  # or a command's help does
            told = "".join(base.__doc__ or "" for base in kind.__mro__)
            names = [f.name for f in fields(kind) if f.name[0] != "_"]
            assert [name for name in names if f"    {name}: " not in told] == []
    take = kinefilter.read_take(ROOT / "scenes" / "takes" / "wave_punch_bend.csv")
    assert repr(take).endswith("wave_punch_bend.csv': 298 frames of kinect_v1>")


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_what_holds_arrays_is_compared_as_an_object(path: Path) -> None:
    # Arrays have no truth: the equality that dataclasses write would raise ValueError.
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef):
            made = [ast.unparse(one) for one in node.decorator_list]
            fields = [ast.unparse(f) for f in node.body if isinstance(f, ast.AnnAssign)]
            if any(one.startswith("dataclass") for one in made):
                arrays = [field for field in fields if "Array" in field]
                assert not arrays or "eq=False" in " ".join(made), node.name


def test_no_files_import_each_other_in_a_circle() -> None:
    modules = {_name(path): path for path in SOURCES}
    TopologicalSorter(
        {name: _imported(name, path, modules) for name, path in modules.items()}
    ).prepare()  # raises CycleError, which names the circle


def test_no_file_imports_what_another_keeps_to_itself() -> None:
    modules = {_name(path): path for path in SOURCES}
    for name, path in modules.items():
        for source, wanted in _imports(name, path):
            assert source not in modules or not wanted.startswith("_"), (name, wanted)


def test_the_product_does_not_import_the_lab() -> None:
    modules = {_name(path): path for path in SOURCES}
    for name, path in modules.items():
        if name.startswith((*LAB, DOOR)):
            continue
        for source, _ in _imports(name, path):
            assert not source.startswith(LAB), f"{name} imports {source}"


def _name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("kinefilter", *parts)).removesuffix(".__init__")


def _imported(name: str, path: Path, modules: Collection[str]) -> set[str]:
    """Return the files that a file imports of ours."""
    pairs = {(source, f"{source}.{name}") for source, name in _imports(name, path)}
    return {whole if whole in modules else source for source, whole in pairs} & set(
        modules
    )


def _imports(name: str, path: Path) -> Iterator[tuple[str, str]]:
    """Yield module and name of what a file imports from, in functions too."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            source = importlib.util.resolve_name(
                "." * node.level + (node.module or ""), package
            )
            yield from ((source, alias.name) for alias in node.names)
