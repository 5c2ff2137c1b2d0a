"""How many of the URDFs in a folder load, each in a process of its own with limits of time and memory.

python benchmarks/urdfs.py FOLDER --seconds 10 --megabytes 1000

A file loads where the chain to its farthest link does, as an arm on a base that drives. Otherwise the other ends are
tried, from far to near, and the sentence about the farthest is printed.
"""

import argparse
import os
import resource
import signal
import sys
from collections import Counter
from pathlib import Path

import numpy as np

import longreach as lr
from longreach.errors import LongreachError
from longreach.robot.description import Arm, RobotDescription
from longreach.robot.footprint import footprint_of
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.robot.urdf import read_urdf


def ends_of(path):
    """Return the links that carry no other, from those with most joints before them on."""
    urdf = read_urdf(path)
    moving = {urdf.root: 0}
    for joint in urdf.joints:
        moving[joint.child] = moving[joint.parent] + joint.moves
    parents = {joint.parent for joint in urdf.joints}
    return sorted((link for link in moving if link not in parents), key=lambda link: -moving[link])


def load(path, end):
    robot = RobotDescription(name="survey", drive="differential", arm=Arm(urdf=path.name, end=end))
    robot = MobileManipulator.from_description(robot, path.parent)
    footprint_of(robot)
    if not np.all(np.isfinite(robot.forward(robot.home))):
        raise ValueError("The tool is nowhere.")


def outcome(path):
    """Return what came of a file, and the sentence about it."""
    said = ""
    try:
        for end in ends_of(path):
            try:
                load(path, end)
            except LongreachError as error:
                said = said or str(error)
                continue
            return ("loads, with another end" if said else "loads"), said
    except LongreachError as error:
        said = str(error)
    except Exception as error:
        return "crashes", repr(error)
    return "is refused", said


def limited(path, seconds, megabytes):
    """Return the same from a process with limits; one that is ended by a signal hangs."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        signal.alarm(seconds)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + megabytes * 2**20,) * 2)
        os.write(writing, "\0".join(outcome(path)).encode()[:60000])
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        answer = pipe.read().decode(errors="replace")
    os.waitpid(child, 0)
    what, _, said = (answer or "hangs\0").partition("\0")
    return what, said


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=int, default=10)
    parser.add_argument("--megabytes", type=int, default=1000)
    arguments = parser.parse_args()
    thing = lr.load_robot("thing")
    thing.forward(thing.home)  # compiles what all of them use
    counts = Counter()
    for path in sorted(arguments.folder.rglob("*.urdf")):
        what, said = limited(path, arguments.seconds, arguments.megabytes)
        counts[what] += 1
        if said or what == "hangs":
            print(f"{path.relative_to(arguments.folder)} {what}: {said.replace(str(path) + ': ', '')[:300]}")
    print(", ".join(f"{count} {what}" for what, count in counts.most_common()) or "There is no .urdf.")
    sys.exit(bool(counts["hangs"] + counts["crashes"]))


if __name__ == "__main__":
    main()
