"""The model that MuJoCo runs: a robot of a URDF on mecanum wheels, in a world, written as MJCF.

Source: MuJoCo's XML reference (mujoco.readthedocs.io/en/stable/XMLreference.html).
"""

import ctypes
import os
import sys
from contextlib import suppress
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.robot.bases import MecanumBase
from longreach.robot.description import Mount
from longreach.robot.joint import Joint
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.robot.urdf import Inertial, Link, Shape, Urdf
from longreach.sim.mecanum import ROLLERS, add_rollers, numbers
from longreach.sim.worlds import World

STEP = 1e-3  # [s]
GRAVITY = 9.81  # [m/s²]
WRENCH_LINK = "ft300"  # what hangs on this link is felt by the force-torque sensor
# Where the picture's right and up point in a camera's link: x forward on the body, z forward on the gripper.
_CAMERAS = {"kinect2": "0 -1 0 0 0 1", "realsense": "1 0 0 0 -1 0"}

_WHEEL_GAIN = 30.0  # torque for an error in speed [N m s]; ours: 230 kg follow within 13 ms
# A wheel's motor behind its gear of 35 [kg m²]; ours. It is needed, too: the integrator damps a wheel by its gain times
# the step, of which the contacts know nothing; where that outweighs the inertia, wheels slip forward under load.
_WHEEL_ARMATURE = 0.06
_ROLLER_MASS_PART = 0.2  # of a wheel's mass that is its rollers'; ours
_ARMATURE = 1.0 / 300.0  # a motor's inertia behind its gear for each N m that the joint can give [kg m²]; ours
THING = "thing_"  # begins the names of the world's bodies, before their numbers
_ROBOT = "2"  # bit of contact: the robot but for its rollers meets the world's things


@cache
def engine(part: str = "") -> ModuleType:
    """Return mujoco, or a part of it, imported when it is first needed.

    Raises:
        ConfigError: it is not installed.
    """
    _draw_without_a_screen()
    try:
        return import_module(f"mujoco.{part}".strip("."))
    except ImportError as error:
        raise ConfigError('The physics needs MuJoCo: run pip install "longreach[sim]".') from error


def _draw_without_a_screen() -> None:
    """Where there is no screen, choose EGL for MuJoCo, if that is there; MuJoCo looks when it is imported."""
    if sys.platform == "linux" and not any(os.environ.get(n) for n in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY")):
        with suppress(OSError):
            ctypes.CDLL("libEGL.so.1")
            os.environ["MUJOCO_GL"] = "egl"


def mjcf(robot: MobileManipulator, world: World, settings: dict[str, str] | None = None) -> str:
    """Return a robot in a world as MJCF; the robot stands at the origin, its arm at 0.

    settings: attributes of <option> beside ours.

    Raises:
        ConfigError: the robot has no mecanum base or no URDF, or its URDF lacks a wheel of its base.
    """
    base, urdf = robot.description.base, robot.urdf
    if not isinstance(base, MecanumBase) or urdf is None:
        raise ConfigError(
            f"Only robots of a URDF on mecanum wheels have physics (thing), and {robot.name} is none; "
            "simulate it without forces (--hardware kinematic)."
        )
    lost = set(base.wheel_names) - {joint.name for joint in urdf.joints}
    if lost:
        raise ConfigError(f"The URDF of {robot.name} has no joint {', '.join(sorted(lost))} for a wheel of its base.")
    root = Element("mujoco", model=robot.name)
    SubElement(root, "compiler", angle="radian", autolimits="true")
    option = {"timestep": numbers(STEP), "integrator": "implicitfast", "cone": "elliptic", "jacobian": "sparse"}
    # A dozen contacts and 67 speeds: the dual solver is a fifth faster than Newton's, and ends up in the same place.
    option |= {"solver": "PGS", "iterations": "30", "impratio": "10", "gravity": f"0 0 {-GRAVITY}"}
    SubElement(root, "option", option | (settings or {}))
    visual = SubElement(root, "visual")
    SubElement(visual, "global", offwidth="1920", offheight="1080")
    SubElement(visual, "headlight", ambient="0.4 0.4 0.4")
    _defaults(root)
    place = _world(root, world)
    actuators, sensors = Element("actuator"), Element("sensor")
    body = SubElement(place, "body", name=urdf.root)
    SubElement(body, "freejoint", name=urdf.root)
    _add_link(body, urdf.links[urdf.root])
    SubElement(body, "camera", name="overview", mode="trackcom", pos="-3.5 -3 3", xyaxes="0.65 -0.76 0 0.42 0.36 0.83")
    _Tree(urdf, robot, base, world.friction, actuators).grow(body, urdf.root)
    _add_sensors(body, robot, urdf, sensors)
    root.append(_contacts(body, world.friction))
    root.extend([actuators, sensors])
    return tostring(root, encoding="unicode")


def compiled(text: str) -> Any:
    """Return MuJoCo's model of MJCF text."""
    return engine().MjModel.from_xml_string(text)


def _defaults(root: Element) -> None:
    defaults = SubElement(root, "default")
    SubElement(defaults, "geom", contype=_ROBOT, conaffinity="0", group="3")
    roller = SubElement(defaults, "default", {"class": "roller"})
    SubElement(roller, "geom", contype="0", conaffinity="0", group="2", rgba="0.2 0.2 0.2 1")
    # Stiff enough that 230 kg sink by 0.1 mm; rollers do not touch each other, else it could not move sideways.
    SubElement(defaults, "pair", solref="0.003 1", solimp="0.95 0.99 0.001", condim="3")


def _world(root: Element, world: World) -> Element:
    """Add floor, light and everything that stands about; return where bodies go."""
    asset = SubElement(root, "asset")
    colours = {"rgb1": "0.78 0.78 0.76", "rgb2": "0.70 0.70 0.68", "width": "256", "height": "256"}
    SubElement(asset, "texture", colours, name="tiles", type="2d", builtin="checker")
    SubElement(asset, "material", name="tiles", texture="tiles", texrepeat="1 1", texuniform="true")
    place = SubElement(root, "worldbody")
    SubElement(place, "light", pos="0 0 4", dir="0 0 -1", directional="true", diffuse="0.6 0.6 0.6")
    meets = {"contype": "0", "group": "0"}
    SubElement(place, "geom", meets, type="plane", size="0 0 1", material="tiles", conaffinity="0", name="floor")
    for i, (x, y, yaw, length, width, low, high) in enumerate(world.solids.tolist()):
        # Each in a body of its own: then the broad phase leaves out what is far away, a sixth of a step's time.
        stands = {"pos": numbers([x, y, 0.5 * (low + high)]), "euler": numbers([0.0, 0.0, yaw])}
        kind, tall = ("box", [length, width]) if width > 0 else ("cylinder", [length]), 0.5 * (high - low)
        shape = {"type": kind[0], "size": numbers([*kind[1], tall]), "rgba": "0.85 0.83 0.78 1"}
        body = SubElement(place, "body", stands, name=f"{THING}{i}")
        SubElement(body, "geom", meets | shape, conaffinity=_ROBOT)
    return place


def _contacts(body: Element, friction: float) -> Element:
    """Let rollers meet the floor: that each pair is named saves the search for them, a fifth of a step's time."""
    contacts = Element("contact")
    for tread in [str(geom.get("name")) for geom in body.iter("geom") if geom.get("class") == "roller"]:
        pair = {"geom1": "floor", "geom2": tread, "friction": numbers([friction, friction, 0.0, 0.0, 0.0])}
        SubElement(contacts, "pair", pair)
    return contacts


class _Tree:
    """The links of a URDF as nested bodies, with a motor at each joint that moves."""

    def __init__(
        self, urdf: Urdf, robot: MobileManipulator, base: MecanumBase, friction: float, actuators: Element
    ) -> None:
        self._urdf, self._base, self._friction, self._actuators = urdf, base, friction, actuators
        self._arm = robot.joint_names[robot.arm]

    def grow(self, parent: Element, link: str, carried: bool = False) -> None:
        """Add the bodies of all links beyond one; the weight of those that the arm moves is carried by its motors."""
        for joint in self._urdf.joints:
            if joint.parent != link:
                continue
            beyond = carried or joint.name in self._arm
            weight = {"gravcomp": "1"} if beyond else {}
            body = SubElement(parent, "body", weight | _placed(joint.origin), name=joint.child)
            if joint.name in self._base.wheel_names:
                self._add_wheel(body, joint)
            else:
                if joint.driven:
                    self._add_motor(body, joint)
                _add_link(body, self._urdf.links[joint.child])
            self.grow(body, joint.child, beyond)

    def _add_wheel(self, body: Element, joint: Joint) -> None:
        inertial = self._urdf.links[joint.child].inertial
        mass = 2.0 if inertial is None else inertial.mass
        sign = self._base.roller_signs[self._base.wheel_names.index(joint.name)]
        add_rollers(body, joint.name, sign, self._base.wheel_radius, self._friction, _ROLLER_MASS_PART * mass / ROLLERS)
        hub, radius = (1 - _ROLLER_MASS_PART) * mass, 0.7 * self._base.wheel_radius
        inertia = numbers(hub * radius**2 * np.array([0.25, 0.5, 0.25]))
        SubElement(body, "inertial", pos="0 0 0", mass=numbers(hub), diaginertia=inertia)
        SubElement(body, "joint", name=joint.name, axis=numbers(joint.axis), armature=numbers(_WHEEL_ARMATURE))
        motor = {"kv": numbers(_WHEEL_GAIN)} | _force(joint, "forcerange")
        SubElement(self._actuators, "velocity", motor, name=joint.name, joint=joint.name)

    def _add_motor(self, body: Element, joint: Joint) -> None:
        """Hold a joint at an angle; the gains are set when the masses are known, see `set_gains`."""
        kind = "slide" if joint.kind == "prismatic" else "hinge"
        effort = joint.limits.effort
        inertia = _ARMATURE * effort if np.isfinite(effort) else 0.1
        known = {"type": kind, "axis": numbers(joint.axis), "armature": numbers(inertia), "actuatorgravcomp": "true"}
        known |= _force(joint, "actuatorfrcrange")
        if np.isfinite(joint.limits.lower):
            known["range"] = numbers([joint.limits.lower, joint.limits.upper])
        SubElement(body, "joint", known, name=joint.name)
        SubElement(self._actuators, "position", name=joint.name, joint=joint.name, kp="1", kv="1")


def _force(joint: Joint, name: str) -> dict[str, str]:
    effort = joint.limits.effort
    return {name: numbers([-effort, effort])} if np.isfinite(effort) else {}


def _placed(T: Float[np.ndarray, "4 4"]) -> dict[str, str]:
    """Return where something stands, as attributes."""
    return {"pos": numbers(T[:3, 3]), "xyaxes": numbers(T[:3, :2].T)}


def _add_link(body: Element, link: Link) -> None:
    if link.inertial is not None:
        SubElement(body, "inertial", _weighed(link.inertial))
    for shape in link.collisions:
        _add_shape(body, shape, {})
    for shape in link.visuals:
        _add_shape(body, shape, {"contype": "0", "group": "2"})
    if link.name in _CAMERAS:
        SubElement(body, "camera", name=link.name, xyaxes=_CAMERAS[link.name], fovy="50")


def _weighed(inertial: Inertial) -> dict[str, str]:
    R = inertial.T_link_inertial[:3, :3]
    about = R @ inertial.inertia @ R.T
    full = numbers([about[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
    return {"pos": numbers(inertial.T_link_inertial[:3, 3]), "mass": numbers(inertial.mass), "fullinertia": full}


def _add_shape(body: Element, shape: Shape, meets: dict[str, str]) -> None:
    if shape.kind == "mesh":
        return  # a primitive shape beside it is what collides
    size = np.array(shape.size) * (0.5 if shape.kind == "box" else [1.0, 0.5] if shape.kind == "cylinder" else 1.0)
    colour = {} if shape.colour is None else {"rgba": numbers(shape.colour)}
    known = meets | colour | _placed(shape.T_link_shape)
    SubElement(body, "geom", known, type=str(shape.kind), size=numbers(size))


def _add_sensors(body: Element, robot: MobileManipulator, urdf: Urdf, sensors: Element) -> None:
    """Add IMU and wrench at their sites, where the arm's last link is, and the torques of the motors."""
    imu = robot.description.imu
    SubElement(body, "site", _placed(((imu and imu.mount) or Mount()).matrix()), name="imu")
    SubElement(sensors, "gyro", name="gyro", site="imu")
    SubElement(sensors, "accelerometer", name="accelerometer", site="imu")
    if WRENCH_LINK in urdf.links:
        link = next(b for b in body.iter("body") if b.get("name") == WRENCH_LINK)
        SubElement(link, "site", name="wrench")
        SubElement(sensors, "force", name="force", site="wrench")
        SubElement(sensors, "torque", name="torque", site="wrench")
        up = {"objtype": "xbody", "objname": "world", "reftype": "site", "refname": "wrench"}
        SubElement(sensors, "framezaxis", up, name="up")
    arm = robot.joint_names[robot.arm]
    last = next((j.child for j in urdf.joints if arm and j.name == arm[-1]), urdf.root)
    for kind in ("pos", "xaxis", "yaxis"):
        SubElement(sensors, f"frame{kind}", {"name": f"last_{kind}", "objtype": "xbody", "objname": last})
    for joint in urdf.joints:
        if joint.driven:
            SubElement(sensors, "jointactuatorfrc", name=f"{joint.name}_effort", joint=joint.name)


def set_gains(model: Any, data: Any, frequency: float = 80.0) -> None:
    """Make every position motor critically damped at `frequency` [rad/s] for the masses as they now stand.

    The motors' force is k (u - q) - d q̇, with k = M ω² and d = 2 M ω, M the joint's entry of the mass matrix.
    """
    mujoco = engine()
    mujoco.mj_forward(model, data)
    column = np.zeros(model.nv)
    for i in range(model.nu):
        joint = model.actuator_trnid[i, 0]
        if model.actuator_biasprm[i, 1] == 0.0:
            continue  # a wheel's motor holds a speed
        dof = model.jnt_dofadr[joint]
        mujoco.mj_mulM(model, data, column, np.eye(model.nv)[dof])
        m = column[dof]
        k, d = m * frequency**2, 2.0 * m * frequency
        model.actuator_gainprm[i, 0], model.actuator_biasprm[i, 1:3] = k, (-k, -d)
