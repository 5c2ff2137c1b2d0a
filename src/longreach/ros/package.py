"""A ROS package of ours for roslaunch: our launch files, the URDFs that we ship, and this environment's program."""

import shlex
import sys
from importlib.resources import files
from pathlib import Path

from longreach import __version__

_MANIFEST = """<?xml version="1.0"?>
<package format="2">
  <name>longreach</name>
  <version>{version}</version>
  <description>Launch files of longreach, whose Python package is installed elsewhere.</description>
  <maintainer email="nobody@example.org">The longreach developers</maintainer>
  <license>Apache-2.0</license>
  <exec_depend>rospy</exec_depend>
  <exec_depend>robot_state_publisher</exec_depend>
</package>
"""
# roslaunch gives each node NAME:=VALUE words, which only our ROS nodes read.
_PROGRAM = """#!/bin/sh
[ "$1" = ros ] && exec {python} -m longreach "$@"
for word do
  shift
  case "$word" in *:=*) ;; *) set -- "$@" "$word" ;; esac
done
exec {python} -m longreach "$@"
"""


def write_package(folder: Path) -> Path:
    """Write the ROS package `longreach` into a folder of packages, in place of an older one; return where it is."""
    package, ours = folder / "longreach", files("longreach")
    parts = {"launch": ours / "ros" / "launch", "urdf": ours / "robot" / "descriptions"}
    for name, source in parts.items():
        (package / name).mkdir(parents=True, exist_ok=True)
        for file in source.iterdir():
            if file.name.endswith((".launch", ".urdf")):
                (package / name / file.name).write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    (package / "package.xml").write_text(_MANIFEST.format(version=__version__), encoding="utf-8")
    program = package / "longreach"
    program.write_text(_PROGRAM.format(python=shlex.quote(sys.executable)), encoding="utf-8")
    program.chmod(0o755)
    return package
