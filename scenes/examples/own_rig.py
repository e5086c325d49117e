"""Write a clip on your own skeleton.

    python own_rig.py TAKE CLIP

The map gives the part of the body that turns each bone, and the bone's rest position as
a share of the person's height. ``retarget/rigs`` has the built-in maps, and
``retarget/rig_map.py`` describes their fields.
"""

import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

import kinefilter

MAP = """
[bones]
Root = { turned_by = "pelvis", offset = [0.0, 0.53, 0.0] }
Belly = { parent = "Root", turned_by = "spine", offset = [0.0, 0.08, 0.0] }
Chest = { parent = "Belly", turned_by = "spine", offset = [0.0, 0.10, 0.0] }
Skull = { parent = "Chest", turned_by = "head", offset = [0.0, 0.17, 0.0] }
"""
LIMB = """
{S}Arm = {{ parent = "Chest", turned_by = "{s} upper arm", offset = [{x}0.1, 0.1, 0] }}
{S}Forearm = {{ parent = "{S}Arm", turned_by = "{s} lower arm", offset = [{x}1, 0, 0] }}
{S}Hand = {{ parent = "{S}Forearm", turned_by = "{s} hand", offset = [{x}1, 0, 0] }}
{S}Thigh = {{ parent = "Root", turned_by = "{s} thigh", offset = [{x}0.05, 0, 0] }}
{S}Shin = {{ parent = "{S}Thigh", turned_by = "{s} shin", offset = [0, -1, 0] }}
{S}Foot = {{ parent = "{S}Shin", turned_by = "{s} foot", offset = [0, -1, 0] }}
"""


def main(take: Path, clip: Path) -> None:
    """Clean a take and write it on the rig above, as ``.bvh`` or USD."""
    limbs = [LIMB.format(S="L", s="left", x=""), LIMB.format(S="R", s="right", x="-")]
    result = kinefilter.clean(kinefilter.read_take(take))
    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "stick.toml"
        rig.write_text("".join([MAP, *limbs]), encoding="utf-8", newline="\n")
        export = kinefilter.Export(rig=str(rig), units="cm")
        kinefilter.write_clip(result.clip, clip, export)
    print(f"wrote {clip}")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        ArgumentParser(usage="%(prog)s TAKE CLIP").error("give a take and a clip")
    try:
        main(Path(sys.argv[1]), Path(sys.argv[2]))
    except kinefilter.InputError as error:
        sys.exit(str(error))
