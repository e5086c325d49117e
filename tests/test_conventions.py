"""Tests named by CONVENTIONS.md and TOOLS.md exist; here are those of no other file."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from skeletons import every_skeleton

from kinefilter import CleanConfig, Cleaner, Clip, Export, InputError, write_clip
from kinefilter.characters import (
    CONTACTS,
    KINECT_V1,
    KINECT_V2,
    Origin,
    Skeleton,
    State,
    Term,
    standard_body,
)
from kinefilter.characters.rotations import about_y, multiply, rotate
from kinefilter.pipeline.formats import read_bvh
from kinefilter.pipeline.target.floor import find_placement, leveled
from kinefilter.scenes.sensor import Sensor, in_sensor_frame, sample_take

MakeClip = Callable[..., Clip]

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "CONVENTIONS.md").read_text(encoding="utf-8")
TOOLS = (ROOT / "pipeline/formats/TOOLS.md").read_text(encoding="utf-8")
NAMED = re.findall(r"`(tests/\w+\.py)::(test_\w+)`", TEXT + TOOLS)


def rows(heading: str) -> list[list[str]]:
    """Return the cells of all tables under a heading of CONVENTIONS.md."""
    section = TEXT.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = [line.strip("|") for line in section.splitlines() if line[:1] == "|"]
    return [[cell.strip(" `") for cell in line.split("|")] for line in lines]


@pytest.mark.parametrize("file", sorted({file for file, _ in NAMED}))
def test_every_test_that_is_named_exists(file: str) -> None:
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    there = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert {name for path, name in NAMED if path == file} - there == set()


def test_every_convention_names_a_test() -> None:
    sections = TEXT.split("\n## ")[1:]
    assert len(sections) > 10
    for section in sections:
        assert "\nTests: `tests/" in section, section.partition("\n")[0]


@pytest.mark.parametrize(
    ("heading", "words"),
    [
        ("Joint states", [state.name.lower().replace("_", " ") for state in State]),
        ("How certain a joint is", [origin.name.lower() for origin in Origin]),
        ("How certain a joint is", [term.words for term in Term]),
        ("Contacts", list(CONTACTS)),
    ],
)
def test_codes_mean_what_the_tables_say(heading: str, words: list[str]) -> None:
    listed = {tuple(row[:2]) for row in rows(heading) if row[0].isdigit()}
    assert {(str(code), word) for code, word in enumerate(words)} <= listed


def test_in_a_scene_the_person_begins_at_the_origin_and_faces_plus_z() -> None:
    rest = standard_body(KINECT_V1).rest_positions
    posture = rotate(about_y(2.0), rest) + np.array([1.5, 0.0, 2.5])
    place = find_placement(posture[None], KINECT_V1)
    np.testing.assert_allclose(place.remove(posture[None])[0], rest, atol=1e-12)


def test_a_row_turns_the_segment_that_ends_at_its_joint(make_clip: MakeClip) -> None:
    clip = make_clip(1)
    elbow = KINECT_V1.index("ElbowLeft")
    rotations = clip.rotations.copy()
    rotations[:, elbow] = multiply(about_y(1.0), rotations[:, elbow])
    moved = replace(clip, rotations=rotations).positions - clip.positions
    upper_arm = rotate(clip.rotations[:, elbow], clip.body.rest_offsets[elbow])
    turned = rotate(about_y(1.0), upper_arm) - upper_arm
    # What hangs on the elbow goes along, but does not turn.
    for joint, name in enumerate(KINECT_V1.joints):
        goes = name in ("ElbowLeft", "WristLeft", "HandLeft")
        np.testing.assert_allclose(moved[:, joint], turned * goes, atol=1e-12)


@every_skeleton
def test_in_files_a_joint_turns_what_hangs_on_it(
    make_clip: MakeClip, tmp_path: Path, skeleton: Skeleton
) -> None:
    clip = make_clip(3, skeleton)
    write_clip(clip, tmp_path / "clip.bvh")
    bvh = read_bvh(tmp_path / "clip.bvh")
    turned_by = {}  # of each joint in the file, the segment that it turns with
    for joint, children in enumerate(skeleton.children):
        name = skeleton.joints[joint]
        turned_by[name] = joint
        if joint != skeleton.root and len(children) == 1:
            turned_by[name] = children[0]
        elif children:
            turned_by |= {f"{skeleton.joints[child]}Pivot": child for child in children}
    assert {name for name in bvh.names if not name.endswith("End")} == set(turned_by)
    for name, segment in turned_by.items():
        node = bvh.names.index(name)
        same = np.abs(np.vecdot(bvh.rotations[:, node], clip.rotations[:, segment]))
        np.testing.assert_allclose(same, 1.0, atol=1e-6)
        if name.endswith("Pivot"):
            above = bvh.names.index(skeleton.joints[skeleton.parents[segment]])
            assert bvh.parents[node] == above
            np.testing.assert_array_equal(bvh.offsets[node], 0.0)


def test_confidence_decides_the_origin_and_all_shares_are_in_range() -> None:
    found = Cleaner(CleanConfig(physics=False)).until("correct").whole(sample_take())
    missing, measured = found.missing, found.confidence >= 1.0
    assert missing.any()
    assert measured.any()
    expected = np.where(measured, Origin.MEASURED, Origin.CORRECTED)
    expected[missing] = Origin.FILLED
    np.testing.assert_array_equal(found.origin, expected)
    np.testing.assert_array_equal(found.confidence[missing], 0.0)
    for share in (found.reliability, found.geometry, found.confidence, found.coverage):
        assert 0.0 <= share.min() <= share.max() <= 1.0
    assert (found.geometry >= found.reliability - 1e-12).all()


def test_a_sensor_that_looks_down_has_a_positive_tilt() -> None:
    floor = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, -1.0], [0.0, 0.0, -2.0]])
    seen = in_sensor_frame(floor, Sensor(tilt=-0.2, height=1.0))
    assert np.polyfit(seen[:, 2], seen[:, 1], 1)[0] > 0.1  # rises away
    np.testing.assert_allclose(leveled(seen, 0.2)[:, 1], -1.0, atol=1e-12)


def test_options_go_with_the_files_that_the_table_says() -> None:
    chosen: dict[str, Any] = {
        "--fps": {"fps": 24.0},
        "--begin": {"begin": 1.0},
        "--end": {"end": 2.0},
        "--loop": {"loop": True},
        "--root": {"root": "in-place"},
        "--keys": {"keys": 1.0},
        "--up": {"up": "z"},
        "--units": {"units": "cm"},
        "--rest": {"rest": "t"},
        "--rig": {"rig": "unreal"},
        "--target": {"rig": "unreal", "target": Path("sam.bvh")},
        "--character": {"character": Path("sam.usda")},
        "--blender": {"blender": "blender"},
        "--rotation-order": {"rotation_order": "zxy"},
    }
    table = rows("Files that are written")
    (header,) = (row for row in table if row[0] == "option")
    listed = {row[0]: row[1:] for row in table if re.match("--[a-z]", row[0])}
    assert set(listed) == set(chosen)
    for option, answers in listed.items():
        for suffixes, answer in zip(header[1:], answers, strict=True):
            for suffix in suffixes.split():
                assert follows(Export(**chosen[option]), suffix) == (answer == "yes")


def follows(export: Export, suffix: str) -> bool:
    """Tell whether a kind of file can follow what was chosen."""
    try:
        export.check(suffix)
    except InputError:
        return False
    return True


def test_both_skeletons_are_in_the_table() -> None:
    listed = {row[0]: row for row in rows("Skeletons and joint names")}
    for skeleton in (KINECT_V1, KINECT_V2):
        row = listed[skeleton.name]
        assert row[1].startswith(f"{len(skeleton)},")
        assert row[2] == skeleton.joints[skeleton.root]
