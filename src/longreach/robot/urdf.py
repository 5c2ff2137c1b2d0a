"""URDF: the tree of links and joints of a robot, with its shapes and masses, read with the standard library's XML.

Source: the URDF specification of ROS (wiki.ros.org/urdf/XML).
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args
from xml.parsers import expat

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

    def renamed(self, names: Mapping[str, str]) -> "Urdf":
        """Return the same robot with other names for some of its links."""

        def new(link: str) -> str:
            return names.get(link, link)

        links = {new(link.name): replace(link, name=new(link.name)) for link in self.links.values()}
        joints = (replace(joint, parent=new(joint.parent), child=new(joint.child)) for joint in self.joints)
        return Urdf(self.name, new(self.root), links, tuple(joints))


def read_urdf(path: Path, end: str | None = None) -> Urdf:
    """Read a URDF file; where it holds several trees, the one with the link `end`.

    What URDF gives no meaning is ignored: elements of other tools, the axis of a fixed joint, limits of a continuous
    one; so is a visual that cannot be read. What is wrong with one joint (its kind, axis, limits, origin) is its
    `fault`, which matters only in a chain.

    Raises:
        ModelError: it is not there, is no URDF, or its joints do not make a tree.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path} cannot be read: {error}.") from error
    try:
        urdf = parse_urdf(content, end)
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error
    joints = (replace(joint, fault=f"{path}: {joint.fault}") if joint.fault else joint for joint in urdf.joints)
    return replace(urdf, joints=tuple(joints))


def parse_urdf(content: str | bytes, end: str | None = None) -> Urdf:
    """Read URDF from a string, or from the bytes of a file; see `read_urdf`."""
    robot = _parsed(content)
    if robot.tag != "robot":
        raise ModelError(f"A URDF's outermost element is <robot>, this one's is <{robot.tag}>.")
    leftover = _xacro_in(robot)
    if leftover:
        raise ModelError(
            f"This is xacro, not URDF ({leftover}); expand it first with the xacro program: xacro IN > OUT.urdf."
        )
    if robot.find("robot") is not None:
        raise ModelError("A <robot> stands inside of another one; put each into a file of its own.")
    colours = {m.get("name", ""): colour for m in robot.findall("material") if (colour := _colour(m)) is not None}
    links = {}
    for element in robot.findall("link"):
        link = _link(element, colours)
        if link.name in links:
            raise ModelError(f"There are two links named {link.name}; a name is given once.")
        links[link.name] = link
    root, joints = _tree(list(links), [_joint(element) for element in robot.findall("joint")], end)
    kept = {root, *(joint.child for joint in joints)}
    return Urdf(robot.get("name", "robot"), root, {n: links[n] for n in links if n in kept}, tuple(joints))


def _parsed(content: str | bytes) -> ElementTree.Element:
    """Return the outermost element. Namespaces are not looked up: a prefix that nobody declared is no fault."""
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    content = content.lstrip("\ufeff \t\r\n") if isinstance(content, str) else content.lstrip()
    try:
        parser.Parse(content, True)
        return builder.close()
    except expat.ExpatError as error:
        if isinstance(content, bytes) and not _is_utf8(content):
            return _parsed(content.decode("latin-1"))  # an old editor's comments; names and numbers are ASCII
        raise ModelError(f"This is not XML ({error}).") from error


def _is_utf8(content: bytes) -> bool:
    try:
        content.decode()
    except UnicodeDecodeError:
        return False
    return True


def _xacro_in(robot: ElementTree.Element) -> str:
    """Return what xacro would have replaced, or nothing."""
    for element in robot.iter():
        if element.tag.startswith("xacro:"):
            return f"<{element.tag}>"
    described = [*robot.iter("link"), *robot.iter("joint")]
    values = (value for part in described for element in part.iter() for value in element.attrib.values())
    return next((value for value in values if "${" in value or "$(" in value), "")


def _tree(links: Sequence[str], joints: Sequence[Joint], end: str | None) -> tuple[str, list[Joint]]:
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
    if not links:
        raise ModelError("There is no <link> in it; a robot has one at least.")
    if not roots:
        raise ModelError("Every link hangs on a joint: a loop, where only a tree can be read; cut it.")
    trees = {root: outward(joints, root) for root in roots}
    ordered = {joint for tree in trees.values() for joint in tree}
    if len(ordered) < len(joints):
        lost = next(joint for joint in joints if joint not in ordered)
        raise ModelError(f"Joint {lost.name} is in a loop, where only a tree can be read; cut it.")
    # A link without a joint is what many files have as their world.
    meant = [root for root in roots if end == root or any(joint.child == end for joint in trees[root])]
    meant = meant or [root for root in roots if trees[root]] or roots
    if len(meant) > 1:
        raise ModelError(
            f"The links {', '.join(meant)} hang on no joint, so there are {len(meant)} trees; say which link ends the "
            "chain (end), and its tree is taken, or join them."
        )
    return meant[0], trees[meant[0]]


def outward(joints: Sequence[Joint], root: str) -> list[Joint]:
    """Return the joints beyond a link, each after the one that carries it; one in a loop is taken once."""
    below: dict[str, list[Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    ordered, reached = [], [root]
    for link in reached:  # grows while we walk
        beyond = below.pop(link, [])
        ordered += beyond
        reached += [joint.child for joint in beyond]
    return ordered


def _numbers(
    element: ElementTree.Element, key: str, default: str | None, count: int = 1, largest: float = 1e300
) -> list[float]:
    text = element.get(key, default)
    what = f"{key} of <{element.tag}>"
    if text is None:
        raise ModelError(f"The {what} is missing.")
    try:
        values = [float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) <= largest for value in values):
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
    parent, child = (_linked(element, tag) for tag in ("parent", "child"))
    if not (parent and child):
        raise ModelError(f"Joint {name} must name a parent and a child link.")
    kind, mimic = kinds.get(element.get("type")), element.find("mimic")
    origin, axis, limits, fault = np.eye(4), (1.0, 0.0, 0.0), Limits(), ""
    try:
        origin = _origin(element)
        if kind is None:
            raise ModelError(f"It is of the type {element.get('type')!r}; there are {', '.join(kinds)}.")
        if kind in ("revolute", "continuous", "prismatic"):
            axis, limits = _axis(element.find("axis")), _limits(element.find("limit"), kind)
    except ModelError as error:
        fault = f"Joint {name}: {error}"
    follows = None if mimic is None or kind == "fixed" else mimic.get("joint")
    return Joint(name, kind or "floating", parent, child, origin, axis, limits, follows, fault)


def _axis(element: ElementTree.Element | None) -> tuple[float, float, float]:
    axis = np.array([1.0, 0.0, 0.0] if element is None else _numbers(element, "xyz", "1 0 0", 3))
    if not np.linalg.norm(axis) > 0:
        raise ModelError("The axis has no direction.")
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    return x, y, z


def _linked(joint: ElementTree.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


def _limits(element: ElementTree.Element | None, kind: str) -> Limits:
    """Return the limits; a speed or an effort of 0 is how many files say that they do not know it."""
    if element is None:
        return Limits()
    known = {}
    for key in ("velocity", "effort"):
        known[key] = _numbers(element, key, "0", largest=math.inf)[0] or math.inf
        if known[key] < 0:
            raise ModelError(f"Its {key} limit is {known[key]:g}; give one above 0, or 0 where it is not known.")
    if kind == "continuous":
        return Limits(**known)
    (lower,), (upper,) = (_numbers(element, key, "0", largest=math.inf) for key in ("lower", "upper"))
    if lower == upper:
        raise ModelError(
            f"Its lower and upper limit are both {lower:g} (0 where none is given), so it cannot move; give "
            "its limits, or make it fixed or continuous."
        )
    return Limits(lower, upper, **known)


def _link(element: ElementTree.Element, colours: dict[str, tuple[float, float, float, float]]) -> Link:
    name = _name(element)
    try:
        visuals = tuple(seen for shape in element.findall("visual") if (seen := _visual(shape, colours)) is not None)
        collisions = tuple(_shape(shape, colours) for shape in element.findall("collision"))
        return Link(name, visuals, collisions, _inertial(element.find("inertial")))
    except ModelError as error:
        raise ModelError(f"Link {name}: {error}") from error


def _colour(material: ElementTree.Element) -> tuple[float, float, float, float] | None:
    element = material.find("color")
    if element is None:
        return None
    try:
        r, g, b, a = _numbers(element, "rgba", None, 4)
    except ModelError:
        return None
    return r, g, b, a


def _visual(element: ElementTree.Element, colours: dict[str, tuple[float, float, float, float]]) -> Shape | None:
    try:
        return _shape(element, colours)
    except ModelError:
        return None


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
