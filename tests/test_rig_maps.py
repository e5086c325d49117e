"""Maps to other people's rigs: complete, closed, and refused where they are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1, InputError, standard_body
from kinefilter.pipeline.formats.clips import read_rig_map
from kinefilter.retarget.rig_map import CHAINS, PARTS, RIGS, load_rig_map
from kinefilter.retarget.target_rig import built_rig

every_rig = pytest.mark.parametrize("name", RIGS)
BODY = standard_body(KINECT_V1, height=1.82)

NAMES = {
    "mixamo": """Hips Spine Spine1 Spine2 Neck Head LeftShoulder LeftArm LeftForeArm
        LeftHand RightShoulder RightArm RightForeArm RightHand LeftUpLeg LeftLeg
        LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase""",
    "unreal": """root pelvis spine_01 spine_02 spine_03 neck_01 head clavicle_l
        upperarm_l lowerarm_l hand_l clavicle_r upperarm_r lowerarm_r hand_r thigh_l
        calf_l foot_l ball_l thigh_r calf_r foot_r ball_r""",
    "unity": """Hips Spine Chest UpperChest Neck Head LeftShoulder LeftUpperArm
        LeftLowerArm LeftHand RightShoulder RightUpperArm RightLowerArm RightHand
        LeftUpperLeg LeftLowerLeg LeftFoot LeftToes RightUpperLeg RightLowerLeg
        RightFoot RightToes""",
    "vrm": """hips spine chest upperChest neck head leftShoulder leftUpperArm
        leftLowerArm leftHand rightShoulder rightUpperArm rightLowerArm rightHand
        leftUpperLeg leftLowerLeg leftFoot leftToes rightUpperLeg rightLowerLeg
        rightFoot rightToes""",
    "smpl": """Pelvis L_Hip R_Hip Spine1 L_Knee R_Knee Spine2 L_Ankle R_Ankle Spine3
        L_Foot R_Foot Neck L_Collar R_Collar Head L_Shoulder R_Shoulder L_Elbow R_Elbow
        L_Wrist R_Wrist L_Hand R_Hand""",
}


@every_rig
def test_joints_have_the_names_that_the_rig_is_known_for(name: str) -> None:
    rig = built_rig(load_rig_map(name), BODY)
    prefix = "mixamorig:" if name == "mixamo" else ""
    assert set(rig.rest.names) == {prefix + word for word in NAMES[name].split()}


@every_rig
def test_the_hierarchy_is_one_tree_and_every_limb_is_turned(name: str) -> None:
    rig = built_rig(load_rig_map(name), BODY)
    assert rig.rest.parents.count(-1) == 1
    assert all(parent < n for n, parent in enumerate(rig.rest.parents))
    assert set(rig.parts) == set(PARTS)
    for part, above in CHAINS.items():
        joint = rig.joint(part)
        while rig.rest.parents[joint] >= 0 and joint != rig.joint(above):
            joint = rig.rest.parents[joint]
        assert joint == rig.joint(above), part


@every_rig
def test_a_built_rig_has_the_persons_limbs_and_stands_on_the_floor(name: str) -> None:
    rig = built_rig(load_rig_map(name), BODY)
    for side in ("left", "right"):
        for limb, joints in (
            (("thigh", "shin", "foot"), ("Knee", "Ankle")),
            (("upper arm", "lower arm", "hand"), ("Elbow", "Wrist")),
        ):
            ours = [BODY.skeleton.index(f"{j}{side.capitalize()}") for j in joints]
            np.testing.assert_allclose(rig.limb(side, *limb), BODY.lengths[ours])
    feet = [rig.joint(f"{side} toes") for side in ("left", "right")]
    sole = BODY.radii[BODY.skeleton.index("FootLeft")]
    np.testing.assert_allclose(rig.rest.positions[feet, 1], sole)
    top = rig.rest.positions[:, 1].max()
    assert 0.85 * BODY.height < top < BODY.height


@every_rig
def test_left_is_the_mirror_of_right(name: str) -> None:
    rig = built_rig(load_rig_map(name), BODY)
    for part in {p.removeprefix("left ") for p in PARTS if p.startswith("left")}:
        left, right = (
            rig.rest.positions[rig.joint(f"{side} {part}")]
            for side in ("left", "right")
        )
        np.testing.assert_allclose(left * [-1, 1, 1], right, atol=1e-12)
        assert left[0] > 0.0


@pytest.mark.parametrize(("name", "slope"), [("unreal", -45), ("mixamo", 0)])
def test_unreal_rests_in_a_pose_and_mixamo_in_t_pose(name: str, slope: float) -> None:
    rig = built_rig(load_rig_map(name), BODY)
    x, y, _ = rig.bone("left upper arm", "left lower arm")
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(slope, abs=3.0)


@pytest.mark.parametrize(
    "name", ["mixamorig:LeftArm", "mixamorig9:leftarm", "mixamorig_LEFTARM", "LeftArm"]
)
def test_a_prefix_and_case_make_no_difference(name: str) -> None:
    assert load_rig_map("mixamo").plain(name) == "leftarm"


GOOD = """
[bones]
Hips = { turned_by = "pelvis", offset = [0, 0.5, 0] }
Chest = { parent = "Hips", turned_by = "spine", offset = [0, 0.3, 0] }
Head = { parent = "Chest", turned_by = "head", offset = [0, 0.1, 0] }
""" + "".join(
    f"""
{s}Arm = {{ parent = "Chest", turned_by = "{side} upper arm", offset = [{x}, 0, 0] }}
{s}Fore = {{ parent = "{s}Arm", turned_by = "{side} lower arm", offset = [{x}, 0, 0] }}
{s}Hand = {{ parent = "{s}Fore", turned_by = "{side} hand", offset = [{x}, 0, 0] }}
{s}Up = {{ parent = "Hips", turned_by = "{side} thigh", offset = [{x}, 0, 0] }}
{s}Low = {{ parent = "{s}Up", turned_by = "{side} shin", offset = [0, -1, 0] }}
{s}Foot = {{ parent = "{s}Low", turned_by = "{side} foot", offset = [0, -1, 0] }}
"""
    for s, side, x in (("L", "left", 0.1), ("R", "right", -0.1))
)


def test_a_map_without_neck_clavicles_and_toes_is_a_map(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD)
    rig = built_rig(read_rig_map(str(tmp_path / "mine.toml")), BODY)
    assert len(rig.rest) == 15
    ankle = BODY.rest_positions[BODY.skeleton.index("AnkleLeft"), 1]
    assert rig.rest.positions[rig.joint("left foot"), 1] == pytest.approx(ankle)
    assert set(PARTS) - set(rig.parts) == {
        "neck",
        *(
            f"{side} {part}"
            for side in ("left", "right")
            for part in ("clavicle", "toes")
        ),
    }


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[bones]", "[bones", "not TOML"),
        ("[bones]", "[joints]", "expected a table [bones]"),
        ("[bones]", "scale = 2\n[bones]", "unknown 'scale'"),
        ("[bones]", "prefix = 3\n[bones]", "a text 'prefix'"),
        ('turned_by = "head"', 'turns = "head"', "'Head': expected fields"),
        ('turned_by = "head"', 'turned_by = "skull"', "unknown turned_by 'skull'"),
        ('turned_by = "head"', 'turned_by = "neck"', "no bone is turned_by 'head'"),
        ('turned_by = "head"', 'turned_by = "pelvis"', "2 bones are turned_by 'pel"),
        ('Head = { parent = "Chest"', 'Head = { parent = "Top"', "parent 'Top' is not"),
        ('Head = { parent = "Chest"', "Head = { parent = 4", "parent is 4"),
        ("[0, 0.3, 0]", "[0, 0.3]", "'Chest': offset is [0, 0.3]"),
        ("[0, 0.3, 0]", "[0, nan, 0]", "'Chest': offset is [0, nan, 0]"),
        ("[0, 0.3, 0]", "7", "'Chest': offset is 7"),
        (", offset = [0, 0.3, 0]", "", "bone 'Chest' has no offset, but"),
        (", offset = [0, 0.1, 0]", "", "turned_by 'head' has no offset"),
        ('parent = "RUp", turned_by = "right shin"', 'parent = "LUp", turned_by = '
         '"right shin"', "'RLow' does not hang on 'RUp'"),
        ('"left shin", offset = [0, -1, 0]', '"left shin", offset = [0, 0, 0]',
         "'LUp' and 'LLow' are in one place"),
        ('Hips = { ', 'Floor = { offset = [0, 0, 0] }\nHips = { ', "has 2 roots"),
    ],
)  # fmt: skip
def test_a_bad_map_is_refused_naming_file_and_bone(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in GOOD
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        built_rig(read_rig_map(str(path)), BODY)
    assert str(path) in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfe\x00", "not UTF-8 text"),
        (b"a = [" + b"[" * 100_000, "not TOML"),
        (None, "there is no such file"),
    ],
)
def test_what_is_no_text_no_map_or_no_file_is_refused(
    tmp_path: Path, content: bytes | None, words: str
) -> None:
    path = tmp_path / "mine.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=rf"mine\.toml: {words}"):
        read_rig_map(str(path))


def test_an_unknown_rig_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(InputError, match="mixamo, smpl, unity, unreal, vrm"):
        read_rig_map("maya")
