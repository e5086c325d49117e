"""The Blender extension: installed, used without a screen, and what it brings."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from rig_motions import ARM, SIDES, performed

from kinefilter.characters import KINECT_V1, Clip
from kinefilter.pipeline.cli import main
from kinefilter.pipeline.formats import Export, read_clip, write_clip
from kinefilter.pipeline.look.drawing import reliability_colors
from kinefilter.retarget.retargeting import retarget
from kinefilter.retarget.rig_map import load_rig_map
from kinefilter.retarget.target_rig import RestPose, TargetRig, matched_rig

Array = NDArray[np.float64]
Found = dict[str, Array]
SAMPLE = Path(__file__).parents[1] / "scenes" / "takes" / "wave_punch_bend.csv"
SHORT = 60  # frames
DISPLACED = slice(70, 220)  # frames of the sample: where the left arm is displaced
GIANT = 12.0  # times taller than people: whose bones are on Mixamo's rig
MILLIMETER = 1e-3
HALF_A_DEGREE = 0.5
UNITS = {"mixamo": GIANT}
TO_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # of Blender's z up
SLOW = """#!{python}
import os, pathlib, subprocess, sys, tempfile, threading
tempfile.mkstemp()
wait = [sys.executable, "-c", "import threading; threading.Event().wait()"]
child = subprocess.Popen(wait)
pathlib.Path({pids!r}).write_text(f"{{os.getpid()}} {{child.pid}}\\n")
threading.Event().wait()
"""

BLENDER = os.environ.get("KINEFILTER_BLENDER") or (
    sys.executable if importlib.util.find_spec("bpy") else ""
)
in_blender = pytest.mark.skipif(
    not BLENDER, reason="no Blender: see test_blender.py for how to install it"
)


def test_the_manifest_says_what_blender_asks_for(tmp_path: Path) -> None:
    path = tmp_path / "kinefilter.zip"
    assert main(["blender", "-o", str(path)]) == 0
    with zipfile.ZipFile(path) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        assert "__init__.py" in archive.namelist()
    assert manifest["version"] == version("kinefilter")
    assert manifest["blender_version_min"] == "4.2.0"
    assert [*manifest["permissions"]] == ["files"]


def test_the_same_version_is_the_same_bytes(tmp_path: Path) -> None:
    paths = [tmp_path / "one.zip", tmp_path / "two.zip"]
    for path in paths:
        assert main(["blender", "-o", str(path)]) == 0
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with zipfile.ZipFile(paths[0]) as archive:
        assert {i.date_time for i in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_other_names_and_folders_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (tmp_path / "kinefilter.py", tmp_path / "absent" / "kinefilter.zip"):
        assert main(["blender", "-o", str(path)]) == 2
        assert str(path) in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


@in_blender
def test_blenders_own_validator_finds_nothing(folder: Path) -> None:
    script = (
        "import bpy, pathlib, runpy, sys; path = next(pathlib.Path("
        "bpy.utils.system_resource('SCRIPTS')).glob('addons*/bl_pkg/cli/blender_ext.py'"
        ")); sys.argv[0] = str(path); runpy.run_path(str(path), run_name='__main__')"
    )
    command = [BLENDER, "-c", script, "validate", str(folder / "kinefilter.zip")]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "Success" in ran.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with all that the extension did in Blender."""
    if not BLENDER:
        pytest.skip("no Blender: see test_blender.py for how to install it")
    folder = tmp_path_factory.mktemp("extension")
    (folder / "temporary").mkdir()
    (folder / "user").mkdir()
    assert main(["blender", "-o", str(folder / "kinefilter.zip")]) == 0
    rows = SAMPLE.read_text(encoding="utf-8").splitlines()
    short, slow, take = (folder / name for name in ("short.csv", "slow", "take.csv"))
    take.write_text("\n".join([rows[0], *rows[1:][DISPLACED]]), encoding="utf-8")
    short.write_text("\n".join(rows[: SHORT + 1]), encoding="utf-8")
    pids = str(folder / "pids.txt")
    slow.write_text(SLOW.format(python=sys.executable, pids=pids))
    slow.chmod(0o700)
    somebody = performed("walk", seed=8).at(slice(0, 2))
    write_clip(somebody, folder / "mixamo.glb", Export(rig="mixamo"))
    program = shutil.which("kinefilter", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("kinefilter is not installed beside this Python")
    asked = {"program": program, "take": str(take), "short": str(short)}
    (folder / "asked.json").write_text(
        json.dumps(asked | {"slow": str(slow), "giant": GIANT})
    )
    script = Path(__file__).with_name("blender_extension.py")
    places = {"BLENDER_USER_RESOURCES": "user", "TMPDIR": "temporary"}
    ran = subprocess.run(
        [BLENDER, str(script), str(folder)],
        env=os.environ | {name: str(folder / place) for name, place in places.items()},
        capture_output=True,
        text=True,
        timeout=300,
    )
    # Blender 4.2 may crash on its way out if Rigify is enabled.
    assert (folder / "told.json").is_file(), ran.stdout + ran.stderr
    return folder


@pytest.fixture(scope="module")
def told(folder: Path) -> dict[str, Any]:
    """Return what Blender said."""
    found: dict[str, Any] = json.loads((folder / "told.json").read_text())
    return found


def cleaned(take: Path, folder: Path) -> Clip:
    """Return what the command line makes of a take, at 30 frames a second."""
    path = folder / f"{take.stem}.npz"
    if not path.is_file():
        assert main(["clean", str(take), "-o", str(path), "--fps", "30"]) == 0
    return read_clip(path)


def seen(folder: Path, name: str) -> Found:
    """Return what Blender has, with y up, and giants in units of their own."""
    found, unit = dict(np.load(folder / f"{name}.npz")), UNITS.get(name, 1.0)
    return found | {k: found[k] @ TO_Y_UP.T / unit for k in ("heads", "rest")}


def test_it_is_enabled_after_every_time_that_it_was_disabled(
    told: dict[str, Any],
) -> None:
    assert told["installed"]
    assert not told["left"]
    assert told["again"]


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("no take", "absent.csv: there is no such file"),
        ("no program", "absent: no such program; install kinefilter"),
        ("no armature", "no armature is active"),
        ("no rig", "choose the rig whose names the bones have"),
        ("other rig", "which rigify has; found mixamorig:Hips"),
        ("wrong option", "cutoff"),
        ("elsewhere", "leave out -o, --body all"),
        ("wrong quotes", "No closing quotation"),
    ],
)
def test_what_is_wrong_is_blenders_error_in_the_words_of_the_command_line(
    told: dict[str, Any], case: str, words: str
) -> None:
    assert "Error: " in told[case]
    assert words in told[case]
    assert told["objects"] == 0


def test_every_joint_is_where_the_clip_has_it_in_every_frame(
    folder: Path, told: dict[str, Any]
) -> None:
    clip, found = cleaned(folder / "take.csv", folder), seen(folder, "own")
    assert told["own"] == ["FINISHED"]
    assert len(found["heads"]) == len(clip)
    columns = [found["names"].tolist().index(j) for j in clip.skeleton.joints]
    away = found["heads"][:, columns] - clip.positions
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER


def test_keys_fall_on_frames_at_the_rate_of_the_take(folder: Path) -> None:
    found = seen(folder, "own")
    assert found["rate"] == 30.0
    frames = len(cleaned(folder / "take.csv", folder))
    np.testing.assert_array_equal(found["frames"], np.arange(frames))
    assert sorted(found["objects"].tolist()) == ["ARMATURE", "MESH"]


def test_bones_have_the_reliability_of_their_segments_and_its_color(
    folder: Path,
) -> None:
    clip, found = cleaned(folder / "take.csv", folder), seen(folder, "own")
    for bone, joint in (("ElbowRight", "WristRight"), ("HandLeft", "HandLeft")):
        column = found["names"].tolist().index(bone)
        wanted = clip.reliability[:, clip.skeleton.index(joint)]
        assert np.ptp(wanted) > 0.1
        np.testing.assert_allclose(found["shares"][:, column], wanted, atol=0.006)
        color = reliability_colors(np.array(round(20 * wanted.mean()) / 20))
        np.testing.assert_allclose(found["colors"][column], color, atol=1 / 255)
    assert found["colored"].all()


def test_markers_say_when_the_tracker_failed_and_a_text_has_the_figures(
    folder: Path,
) -> None:
    found, figures = seen(folder, "own"), folder / "figures.json"
    command = ["clean", str(folder / "take.csv"), "-o", str(folder / "other.npz")]
    assert main([*command, "--json", str(figures)]) == 0
    failures = json.loads(figures.read_text())["failures"]
    begin = cleaned(folder / "take.csv", folder).time[0]
    wanted = [
        round((failure[end] - begin) * 30.0)
        for failure in failures
        for end in ("start_s", "end_s")
    ]
    assert wanted
    np.testing.assert_array_equal(found["marked"], wanted)
    begins, ends = found["markers"][::2], found["markers"][1::2]
    assert all(name.startswith("left arm displaced: moved to where") for name in begins)
    assert set(ends.tolist()) == {"left arm displaced ends"}
    assert "tracker failure: left arm displaced" in str(found["text"][0])


def test_the_scenes_rate_may_stay(folder: Path) -> None:
    found = seen(folder, "slower")
    assert found["rate"] == pytest.approx(24.0 / 1.001)
    np.testing.assert_array_equal(found["frames"], np.arange(len(found["frames"])))
    clip = cleaned(folder / "short.csv", folder)
    lasts = float(clip.time[-1] - clip.time[0])
    assert found["frames"][-1] == int(lasts * 24.0 / 1.001)


def target(found: Found, name: str, clip: Clip) -> TargetRig:
    """Return an armature as Blender has it, in meters."""
    names, parents = found["names"].tolist(), found["parents"].tolist()
    rest = RestPose(tuple(names), tuple(parents), found["rest"] - found["rest"][0])
    return matched_rig(load_rig_map(name), rest, clip.body)


every_armature = pytest.mark.parametrize("name", ["mixamo", "rigify"])


@every_armature
def test_every_bone_of_an_armature_is_where_the_retargeted_motion_has_it(
    folder: Path, told: dict[str, Any], name: str
) -> None:
    """Relative to the root, and the way of the root by itself."""
    assert told[name] == ["FINISHED"]
    clip, found = cleaned(folder / "short.csv", folder), seen(folder, name)
    moved = retarget(clip, target(found, name, clip)).positions
    heads = found["heads"]
    assert heads.shape == moved.shape
    away = (heads - heads[:, :1]) - (moved - moved[:, :1])
    assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
    way = (heads[:, 0] - heads[0, 0]) - (moved[:, 0] - moved[0, 0])
    assert np.linalg.norm(way, axis=-1).max() < MILLIMETER
    assert np.ptp(heads, axis=0).max() > 0.1
    # On its floor, beside the armature's own place.
    offset = heads[0, 0] - moved[0, 0]
    np.testing.assert_allclose(offset[[0, 2]], PLACES[name], atol=MILLIMETER)


def test_the_controls_of_a_generated_rig_move_it_as_its_metarig_moves(
    folder: Path, told: dict[str, Any]
) -> None:
    assert told["controls"] == ["FINISHED"]
    assert "rig lacks ORG-hand.L" in told["no metarig"]
    metarig, rig = seen(folder, "rigify"), seen(folder, "controls")
    names = rig["names"].tolist()
    some = [name for name in metarig["names"] if f"ORG-{name}" in names]
    assert {"spine", "spine.006", "hand.L", "foot.L", "toe.R"} <= {*some}
    heads = [metarig["names"].tolist().index(name) for name in some]
    found = rig["heads"][:, [names.index(f"ORG-{name}") for name in some]]
    away = np.linalg.norm(found - metarig["heads"][:, heads], axis=-1)
    assert away.max() < MILLIMETER
    assert rig["colored"][names.index("hand_fk.L")]
    assert rig["frames"].tolist() == metarig["frames"].tolist()


PLACES = {"mixamo": (1.0 / GIANT, -2.0 / GIANT), "rigify": (0.0, 0.0)}  # x and z


@every_armature
def test_every_hand_is_where_the_clip_has_it_relative_to_the_length_of_the_arm(
    folder: Path, name: str
) -> None:
    clip, found = cleaned(folder / "short.csv", folder), seen(folder, name)
    rig = target(found, name, clip)
    parts, joints = ARM
    for side in SIDES:
        ends = [clip.skeleton.index(f"{j}{side.capitalize()}") for j in joints]
        heads = [rig.joint(f"{side} {part}") for part in parts]
        ours, theirs = clip.positions[:, ends], found["heads"][:, heads]
        lengths = [
            np.linalg.norm(np.diff(p[0], axis=0), axis=1) for p in (ours, theirs)
        ]
        ways = [p[:, 2] - p[:, 0] for p in (ours, theirs)]
        away = ways[1] - ways[0] * lengths[1].sum() / lengths[0].sum()
        assert np.linalg.norm(away, axis=-1).max() < MILLIMETER
        assert degrees(*ways).max() < HALF_A_DEGREE


def degrees(some: Array, others: Array) -> Array:
    """Return the angles between vectors (..., 3)."""
    sines = np.linalg.norm(np.cross(some, others), axis=-1)
    return np.degrees(np.arctan2(sines, np.sum(some * others, axis=-1)))


@every_armature
def test_bones_of_an_armature_are_colored_by_what_turns_them(
    folder: Path, name: str
) -> None:
    clip, found = cleaned(folder / "short.csv", folder), seen(folder, name)
    rig, names = target(found, name, clip), found["names"]
    shin = rig.joint("left shin")
    wanted = clip.reliability[:, KINECT_V1.index("AnkleLeft")]
    np.testing.assert_allclose(found["shares"][:, shin], wanted, atol=0.006)
    turned = sorted(joint for joints in rig.parts.values() for joint in joints)
    assert names[found["colored"]].tolist() == names[turned].tolist()
    assert found["objects"].tolist() == ["ARMATURE"]


def test_blender_goes_on_meanwhile_and_shows_how_long_it_takes(
    told: dict[str, Any],
) -> None:
    assert told["meanwhile"] == ["PASS_THROUGH"]
    shown, timers = told["shown"]
    assert shown[0] == "kinefilter: cleaning short.csv, 0 s (Esc to cancel)"
    assert "short.csv: 60 frames" in shown[-2]
    assert shown[-1] is None
    assert timers == []


def test_nothing_is_left_of_what_is_cancelled(
    folder: Path, told: dict[str, Any]
) -> None:
    assert told["cancelled"] == [["CANCELLED"], []]
    pids = [int(word) for word in (folder / "pids.txt").read_text().split()]
    assert len(pids) == 2
    assert not any(alive(pid) for pid in pids)
    left = [path.name for path in (folder / "temporary").iterdir()]
    assert not [name for name in left if not name.startswith("blender_")]  # its own


def alive(pid: int) -> bool:
    """Return whether a process runs; one that is only left to be reaped does not."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
