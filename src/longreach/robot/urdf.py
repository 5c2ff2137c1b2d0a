"""URDF: the tree of links and joints of a robot, with its shapes and masses, read with the standard library's XML.

Source: the URDF specification of ROS (wiki.ros.org/urdf/XML).
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from longreach.errors import ModelError
from longreach.geometry import se3, so3
from longreach.robot.joint import Joint, Kind, Limits

ShapeKind = Literal["box", "cylinder", "sphere", "mesh"]


@dataclass(frozen=True, eq=False)
class Shape:
    """One visible or colliding body of a link, standing in it at T_link_shape.

    size [m]: box x, y, z; cylinder radius, length; sphere radius; mesh its scale, its file in `mesh`. colour: RGBA.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    T_link_shape: Float[np.ndarray, "4 4"]
    colour: tuple[float, float, float, float] | None = None
    mesh: str | None = None


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass [kg] at T_link_inertial, and the inertia (3, 3) [kg m²] about that frame's axes."""

    mass: float
    T_link_inertial: Float[np.ndarray, "4 4"]
    inertia: Float[np.ndarray, "3 3"]


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body: what it looks like, what it collides with, what it weighs."""

    name: str
    visuals: tuple[Shape, ...] = ()
    collisions: tuple[Shape, ...] = ()
    inertial: Inertial | None = None


@dataclass(frozen=True, eq=False)
class Urdf:
    """A robot as a tree: links by name, joints each after the one that carries it, and the link that is in no joint."""

    name: str
    root: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]


def read_urdf(path: Path) -> Urdf:
    """Read a URDF file.

    Raises:
        ModelError: it is not there, is no URDF, has a joint of an unknown kind, limits upside down, a number that is
            none, or its joints do not make one tree.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path} cannot be read: {error}.") from error
    try:
        return parse_urdf(text)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error


def parse_urdf(text: str) -> Urdf:
    """Read URDF from a string; see `read_urdf`."""
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ModelError(f"This is not XML ({error}).") from error
    if robot.tag != "robot":
        raise ModelError(f"A URDF's outermost element is <robot>, this one's is <{robot.tag}>.")
    if any("xacro" in str(element.tag) for element in robot.iter()):
        raise ModelError("This is xacro, not URDF; expand it first with the xacro program.")
    colours = {m.get("name", ""): colour for m in robot.findall("material") if (colour := _colour(m)) is not None}
    links = {}
    for element in robot.findall("link"):
        link = _link(element, colours)
        if link.name in links:
            raise ModelError(f"There are two links named {link.name}; a name is given once.")
        links[link.name] = link
    root, joints = _tree(list(links), [_joint(element) for element in robot.findall("joint")])
    return Urdf(robot.get("name", "robot"), root, links, tuple(joints))


def _tree(links: Sequence[str], joints: Sequence[Joint]) -> tuple[str, list[Joint]]:
    """Return the root and the joints in the order from it outward, having seen that they make one tree."""
    known, carried, names = set(links), {}, set()
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in known:
                raise ModelError(f"Joint {joint.name} names the link {link}, which is not there.")
        if joint.child in carried:
            raise ModelError(
                f"The link {joint.child} hangs on two joints, {carried[joint.child].name} and {joint.name}: "
                "a loop, where only a tree can be read; cut one of them."
            )
        if joint.name in names:
            raise ModelError(f"There are two joints named {joint.name}; a name is given once.")
        names.add(joint.name)
        carried[joint.child] = joint
    roots = [link for link in links if link not in carried]
    if not roots:
        raise ModelError("Every link hangs on a joint: a loop (or no link at all), where only a tree can be read.")
    ordered, reached = [], [roots[0]]
    for link in reached:  # grows while we walk
        below = [joint for joint in joints if joint.parent == link]
        ordered += below
        reached += [joint.child for joint in below]
    if len(roots) > 1:
        raise ModelError(
            f"The links {', '.join(roots)} hang on no joint; a tree has one root, so join the others to it."
        )
    if len(ordered) < len(joints):
        lost = next(joint for joint in joints if joint not in ordered)
        raise ModelError(f"Joint {lost.name} is in a loop, where only a tree can be read; cut it.")
    return roots[0], ordered


def _numbers(element: ElementTree.Element, key: str, default: str | None, count: int = 1) -> list[float]:
    text = element.get(key, default)
    what = f"{key} of <{element.tag}>"
    if text is None:
        raise ModelError(f"The {what} is missing.")
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ModelError(f"The {what} is {text!r}; expected {count} finite number{'s' * (count > 1)}.")
    return values


def _name(element: ElementTree.Element) -> str:
    name = element.get("name")
    if not name:
        raise ModelError(f"A <{element.tag}> has no name; give it one.")
    return name


def _origin(parent: ElementTree.Element) -> np.ndarray:
    element = parent.find("origin")
    if element is None:
        return np.eye(4)
    p = np.array(_numbers(element, "xyz", "0 0 0", 3))
    return se3.from_rotation_translation(so3.from_roll_pitch_yaw(*_numbers(element, "rpy", "0 0 0", 3)), p)


def _joint(element: ElementTree.Element) -> Joint:
    name, kinds = _name(element), {kind: kind for kind in get_args(Kind)}
    kind = kinds.get(element.get("type"))
    if kind is None:
        raise ModelError(f"Joint {name} is of the type {element.get('type')!r}; there are {', '.join(kinds)}.")
    parent, child = (_linked(element, tag) for tag in ("parent", "child"))
    if not (parent and child):
        raise ModelError(f"Joint {name} must name a parent and a child link.")
    try:
        line, mimic = element.find("axis"), element.find("mimic")
        axis = np.array([1.0, 0.0, 0.0] if line is None else _numbers(line, "xyz", "1 0 0", 3))
        if not np.linalg.norm(axis) > 0:
            raise ModelError("The axis has no direction.")
        x, y, z = (axis / np.linalg.norm(axis)).tolist()
        limits = _limits(element.find("limit"), kind)
        follows = None if mimic is None else mimic.get("joint")
        return Joint(name, kind, parent, child, _origin(element), (x, y, z), limits, follows)
    except ModelError as error:
        raise ModelError(f"Joint {name}: {error}") from error


def _linked(joint: ElementTree.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


def _limits(element: ElementTree.Element | None, kind: str) -> Limits:
    """Return the limits; a speed or an effort of 0 is how many files say that they do not know it."""
    if element is None:
        return Limits()
    (velocity,), (effort,) = _numbers(element, "velocity", "0"), _numbers(element, "effort", "0")
    lower, upper = -math.inf, math.inf
    if kind in ("revolute", "prismatic"):
        (lower,), (upper,) = _numbers(element, "lower", "0"), _numbers(element, "upper", "0")
    return Limits(lower, upper, velocity=velocity or math.inf, effort=effort or math.inf)


def _link(element: ElementTree.Element, colours: dict[str, tuple[float, float, float, float]]) -> Link:
    name = _name(element)
    try:
        visuals = tuple(_shape(shape, colours) for shape in element.findall("visual"))
        collisions = tuple(_shape(shape, colours) for shape in element.findall("collision"))
        return Link(name, visuals, collisions, _inertial(element.find("inertial")))
    except ModelError as error:
        raise ModelError(f"Link {name}: {error}") from error


def _colour(material: ElementTree.Element) -> tuple[float, float, float, float] | None:
    element = material.find("color")
    if element is None:
        return None
    r, g, b, a = _numbers(element, "rgba", None, 4)
    return r, g, b, a


def _shape(element: ElementTree.Element, colours: dict[str, tuple[float, float, float, float]]) -> Shape:
    geometry = element.find("geometry")
    body = None if geometry is None else next(iter(geometry), None)
    if body is None:
        raise ModelError(f"A <{element.tag}> has no geometry.")
    material = element.find("material")
    colour = None if material is None else _colour(material) or colours.get(material.get("name", ""))
    T = _origin(element)
    if body.tag == "box":
        return Shape("box", tuple(_numbers(body, "size", None, 3)), T, colour)
    if body.tag == "cylinder":
        size = (*_numbers(body, "radius", None), *_numbers(body, "length", None))
        return Shape("cylinder", size, T, colour)
    if body.tag == "sphere":
        return Shape("sphere", tuple(_numbers(body, "radius", None)), T, colour)
    if body.tag == "mesh":
        return Shape("mesh", tuple(_numbers(body, "scale", "1 1 1", 3)), T, colour, body.get("filename"))
    raise ModelError(f"A shape is a <{body.tag}>; there are {', '.join(get_args(ShapeKind))}.")


def _inertial(element: ElementTree.Element | None) -> Inertial | None:
    if element is None:
        return None
    mass, inertia = element.find("mass"), element.find("inertia")
    if mass is None:
        raise ModelError("An <inertial> has no mass.")
    matrix = np.zeros((3, 3))
    if inertia is not None:
        for key, i, j in (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)):
            matrix[i, j] = matrix[j, i] = _numbers(inertia, key, "0")[0]
    return Inertial(_numbers(mass, "value", None)[0], _origin(element), matrix)
