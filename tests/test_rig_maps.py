"""Maps to other people's rigs: complete, closed, and refused where they are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinefilter.characters import KINECT_V1, InputError, standard_body
from kinefilter.characters.rotations import IDENTITY, matrix_from_wxyz
from kinefilter.pipeline.formats.clips import read_rig_map
from kinefilter.retarget.rig_map import CHAINS, PARTS, RIGS, WORDS, load_rig_map
from kinefilter.retarget.target_rig import built_rig

every_rig = pytest.mark.parametrize("name", RIGS)
BODY = standard_body(KINECT_V1, height=1.82)

NAMES = {
    "mixamo": """Hips Spine Spine1 Spine2 Neck Head LeftShoulder LeftArm LeftForeArm
        LeftHand RightShoulder RightArm RightForeArm RightHand LeftUpLeg LeftLeg
        LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase""",
    "unreal": """root pelvis spine_01 spine_02 spine_03 spine_04 spine_05 neck_01
        neck_02 head clavicle_l upperarm_l lowerarm_l hand_l clavicle_r upperarm_r
        lowerarm_r hand_r thigh_l calf_l foot_l ball_l thigh_r calf_r foot_r ball_r
        upperarm_twist_01_l upperarm_twist_02_l lowerarm_twist_01_l lowerarm_twist_02_l
        upperarm_twist_01_r upperarm_twist_02_r lowerarm_twist_01_r lowerarm_twist_02_r
        thigh_twist_01_l thigh_twist_02_l calf_twist_01_l calf_twist_02_l
        thigh_twist_01_r thigh_twist_02_r calf_twist_01_r calf_twist_02_r
        ik_foot_root ik_foot_l ik_foot_r ik_hand_root ik_hand_gun ik_hand_l
        ik_hand_r""",
    "unreal4": """root pelvis spine_01 spine_02 spine_03 neck_01 head clavicle_l
        upperarm_l lowerarm_l hand_l clavicle_r upperarm_r lowerarm_r hand_r thigh_l
        calf_l foot_l ball_l thigh_r calf_r foot_r ball_r upperarm_twist_01_l
        lowerarm_twist_01_l thigh_twist_01_l calf_twist_01_l upperarm_twist_01_r
        lowerarm_twist_01_r thigh_twist_01_r calf_twist_01_r
        ik_foot_root ik_foot_l ik_foot_r ik_hand_root ik_hand_gun ik_hand_l
        ik_hand_r""",
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
    "smplx": """pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle
        right_ankle spine3 left_foot right_foot neck left_collar right_collar head
        left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist""",
    "lafan1": """Hips LeftUpLeg LeftLeg LeftFoot LeftToe RightUpLeg RightLeg RightFoot
        RightToe Spine Spine1 Spine2 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand
        RightShoulder RightArm RightForeArm RightHand""",
    "rigify": """spine spine.001 spine.002 spine.003 spine.004 spine.005 spine.006
        shoulder.L upper_arm.L forearm.L hand.L shoulder.R upper_arm.R forearm.R hand.R
        thigh.L shin.L foot.L toe.L thigh.R shin.R foot.R toe.R""",
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
def test_a_built_rig_has_the_persons_limbs_and_trunk_and_stands_on_the_floor(
    name: str,
) -> None:
    rig = built_rig(load_rig_map(name), BODY)
    for side in ("left", "right"):
        for limb, joints in (
            (("thigh", "shin", "foot"), ("Knee", "Ankle")),
            (("upper arm", "lower arm", "hand"), ("Elbow", "Wrist")),
        ):
            ours = [BODY.skeleton.index(f"{j}{side.capitalize()}") for j in joints]
            np.testing.assert_allclose(rig.limb(side, *limb), BODY.lengths[ours])
    for part, joint in (("thigh", "Hip"), ("upper arm", "Shoulder")):
        width = rig.bone(f"right {part}", f"left {part}")[0]
        ends = BODY.rest_positions[BODY.skeleton.sides(joint), 0]
        assert width == pytest.approx(np.ptp(ends))
    up = BODY.rest_positions[:, 1]
    shoulder, hip, ankle = (
        up[BODY.skeleton.index(f"{j}Left")] for j in ("Shoulder", "Hip", "Ankle")
    )
    trunk = rig.bone("left thigh", "left upper arm")[1]
    assert trunk == pytest.approx(shoulder - hip)
    assert rig.rest.positions[rig.joint("left foot"), 1] == pytest.approx(ankle)
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


@pytest.mark.parametrize(("name", "slope"), [("unreal", -41), ("mixamo", 0)])
def test_unreal_rests_in_a_pose_and_mixamo_in_t_pose(name: str, slope: float) -> None:
    rig = built_rig(load_rig_map(name), BODY)
    x, y, _ = rig.bone("left upper arm", "left lower arm")
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(slope, abs=1.0)


def test_axes_point_along_the_bone_and_where_the_map_says() -> None:
    rig = built_rig(load_rig_map("mixamo"), BODY)
    assert rig.rest.axes is not None
    for bone, (x, y, z) in {
        "Hips": ("left", "up", "ahead"),
        "LeftArm": ("back", "left", "down"),
        "RightForeArm": ("ahead", "right", "down"),
        "LeftHand": ("back", "left", "down"),
        "LeftToeBase": ("right", "ahead", "up"),
    }.items():
        turn = rig.rest.axes[rig.rest.names.index(f"mixamorig:{bone}")]
        wanted = np.stack([WORDS[word] for word in (x, y, z)], axis=1)
        np.testing.assert_allclose(matrix_from_wxyz(turn), wanted, atol=1e-12)
    # As Mixamo's X Bot rests.
    for bone, y in {
        "Spine1": (0.0, 0.989, -0.147),
        "Head": (0.0, 0.993, -0.121),
        "LeftShoulder": (0.977, -0.048, -0.206),
        "LeftLeg": (0.0, -0.998, -0.068),
        "LeftFoot": (0.0, -0.632, 0.775),
    }.items():
        turn = rig.rest.axes[rig.rest.names.index(f"mixamorig:{bone}")]
        assert matrix_from_wxyz(turn)[:, 1] @ y > np.cos(np.radians(2.0))
    for name in set(RIGS) - {"smpl", "smplx", "unity", "vrm"}:
        axes = built_rig(load_rig_map(name), BODY).rest.axes
        assert axes is not None
        np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0)


def test_bones_without_axes_have_those_of_the_world(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    assert built_rig(read_rig_map(str(path)), BODY).rest.axes is None
    path.write_text(GOOD.replace('"head", ', '"head", axes = "-z up, x right", '))
    axes = built_rig(read_rig_map(str(path)), BODY).rest.axes
    assert axes is not None
    np.testing.assert_allclose(axes[[0, 1]], [IDENTITY, IDENTITY])
    wanted = [[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]]  # a row is a coordinate
    np.testing.assert_allclose(matrix_from_wxyz(axes[2]), wanted, atol=1e-12)


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
        ("[bones]", 'axes = "y on"\n[bones]', "axes are 'y on', expected two such"),
        ("[bones]", 'axes = "y on, y up"\n[bones]', "axes are 'y on, y up'"),
        ("[bones]", "axes = 3\n[bones]", "axes are 3, expected"),
        ("[bones]", 'axes = "y 0 0 0, z up"\n[bones]', "its axis y has no direction"),
        ("[bones]", 'axes = "y 0 0, z up"\n[bones]', "axes are 'y 0 0, z up'"),
        ("[bones]", "axes_in_bvh = 1\n[bones]", "axes_in_bvh is 1, expected true"),
        ("[bones]", 'axes = "y up, z on"\n[bones]', "its axis z has no direction"),
        ('turned_by = "head"', 'axes = "w up", turned_by = "head"', "'Head': axes"),
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
         '"right shin"', "'RLow' (right shin) must descend from 'RUp'"),
        ('Head = {', 'T = { parent = "Chest", at = 0.5 }\nHead = {',
         "'T': a twist bone has only"),
        ('Head = {', 'T = { parent = "Chest", twist_of = "spine", at = 1.5 }\nHead = {',
         "'T': a twist bone has only"),
        ('Head = {', 'T = { parent = "Chest", twist_of = "head", at = 0.5 }\nHead = {',
         "'T': twist_of is 'head', expected"),
        ('Head = {', 'T = { parent = "Chest", follows = "Head" }\nHead = {',
         "'T': follows 'Head', which is not listed before it"),
        ('Head = {', 'T = { parent = "Chest", follows = "Hips", at = 0 }\nHead = {',
         "'T': a twist bone has only"),
        ('Head = {', 'T = { follows = "Hips" }\nHead = {', "'T': an IK bone has only"),
        ('Head = {', 'T = { parent = "Hips", follows = 4 }\nHead = {',
         "'T': an IK bone has only"),
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
    with pytest.raises(
        InputError, match="lafan1, mixamo, rigify, smpl, smplx, unity, unreal"
    ):
        read_rig_map("maya")
