"""Have a simulated character follow a performer frame by frame, and push it.

    python follow_and_push.py TAKE

In a game, frames come from a sensor; here they come from a recorded take.
"""

import sys
from argparse import ArgumentParser
from pathlib import Path

import kinefilter
from kinefilter.characters import Tracking, standard_body


def main(path: Path) -> None:
    """Follow a take, with a push to the chest after two seconds."""
    take = kinefilter.read_take(path)
    body = standard_body(take.skeleton, height=1.75)
    # A soft pull lets the character yield; the default keeps it close to the performer.
    avatar = kinefilter.Avatar(body, tracking=Tracking(natural_frequency=15.0))
    chest = take.skeleton.girdle
    pushed = False
    for time, joints, state in zip(take.time, take.positions, take.state, strict=True):
        if time - take.time[0] > 2.0 and not pushed:
            avatar.push(take.skeleton.joints[chest], force=[0, 0, 300], seconds=0.3)
            pushed = True
        pose = avatar.step(joints, time, state)
        print(f"{time:6.2f} s: chest at {pose.positions[chest].round(2)} m")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        ArgumentParser(usage="%(prog)s TAKE").error("give a take")
    try:
        main(Path(sys.argv[1]))
    except kinefilter.InputError as error:
        sys.exit(str(error))
