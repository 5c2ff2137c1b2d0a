"""Base and arm as one redundant chain: q = [x, y, θ, q1..qn], base first."""

from collections.abc import Container
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.errors import ModelError
from longreach.robot.chain import JointLimits, KinematicChain, only_end
from longreach.robot.description import RobotDescription
from longreach.robot.dh import joints_of
from longreach.robot.joint import Joint, Limits
from longreach.robot.kinematics import Kinematics
from longreach.robot.urdf import Urdf, read_urdf

WORLD = "world"
_BASE_LINK = "base_link"
_OURS = ("map", "odom", WORLD, "base_x_link", "base_y_link")  # frames a URDF's link of that name is not


@dataclass(frozen=True, eq=False)
class MobileManipulator(Kinematics):
    """A planar base (or none, where it is bolted down), an arm (or none), frames, limits; its end is the tool.

    `robot.forward(q)` is T_world_tool; a bolted arm's world is its root. `urdf`: links with shapes and masses, where
    the description has a URDF. Whether the base can move sideways stands in the description.
    """

    description: RobotDescription
    chain: KinematicChain
    urdf: Urdf | None = None

    def __post_init__(self) -> None:
        self._hold(self.chain.fixed, self.chain.prismatic)

    @property
    def name(self) -> str:
        """What the robot is called."""
        return self.description.name

    @property
    def base(self) -> slice:
        """Where q holds x, y, θ; nowhere for a bolted arm."""
        return slice(0, 0 if self.description.bolted else 3)

    @property
    def arm(self) -> slice:
        """Where q holds the arm's joints."""
        return slice(self.base.stop, self.dof)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints in the order of q."""
        return self.chain.joint_names

    @property
    def frames(self) -> tuple[str, ...]:
        """The names that `frame` and `with_tool` know."""
        return tuple(self.chain.frames)

    @property
    def tool(self) -> str:
        """The frame that `forward` tells of."""
        return self.chain.end

    @property
    def limits(self) -> JointLimits:
        """Limits of position, velocity, acceleration and effort, each (n,)."""
        return self.chain.limits

    @property
    def lower(self) -> Float[np.ndarray, " n"]:
        """The lower limits of q [m or rad]."""
        return self.limits.lower

    @property
    def upper(self) -> Float[np.ndarray, " n"]:
        """The upper limits of q [m or rad]."""
        return self.limits.upper

    @property
    def home(self) -> Float[np.ndarray, " n"]:
        """The configuration at the start: the base at the origin, the arm as its description says, within limits."""
        q = np.zeros(self.dof)
        arm = self.description.arm
        if arm is not None and arm.home is not None:
            q[self.arm] = arm.home
        return np.clip(q, self.lower, self.upper)

    def with_tool(self, frame: str) -> "MobileManipulator":
        """Return this robot with another of its frames as the tool.

        Raises:
            ModelError: there is no such frame; the sentence names those there are.
        """
        return replace(self, chain=self.chain.ending(frame))

    def with_limits(self, lower: Float[np.ndarray, " n"], upper: Float[np.ndarray, " n"]) -> "MobileManipulator":
        """Return this robot with other limits of q [m or rad].

        Raises:
            ModelError: a length that does not fit, a NaN, or a lower limit that is not below its upper one.
        """
        if np.shape(lower) != (self.dof,) or np.shape(upper) != (self.dof,):
            raise ModelError(
                f"The limits have the shapes {np.shape(lower)} and {np.shape(upper)}, but q has {self.dof} numbers."
            )
        return replace(self, chain=self.chain.with_limits(replace(self.limits, lower=lower, upper=upper)))

    def frame(self, name: str, q: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch 4 4"]:
        """Return T_world_frame of any frame, at one configuration or at many; (3.8)."""
        return self.chain.ending(name).forward(q)

    def frame_and_jacobian(
        self, name: str, q: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 n"]]:
        """Return T_world_frame and its Jacobian, whose columns are 0 for joints beyond the frame."""
        return self.chain.ending(name).forward_and_jacobian(q)

    @classmethod
    def from_description(cls, description: RobotDescription, folder: Path) -> "MobileManipulator":
        """Return the robot of a description; a URDF's file is looked for in `folder`.

        Raises:
            ModelError: the URDF cannot be used, a frame's parent is not there, or the URDF and the description place
                a sensor differently.
        """
        arm, urdf = description.arm, None
        root, end, joints = _BASE_LINK, _BASE_LINK, []
        if arm is not None and arm.urdf is not None:
            urdf = read_urdf(folder / arm.urdf, arm.end)
            names = _free_names(urdf, description.bolted)
            urdf = urdf.renamed(names)
            root, joints = urdf.root, list(urdf.joints)
            end = names.get(arm.end or "", arm.end) or only_end(joints, root)
        elif arm is not None and arm.dh is not None:
            joints = joints_of(arm.dh, root)
            end = arm.end or joints[-1].child
        if not description.bolted:
            joints = [*_planar(description, root, {joint.name for joint in joints}), *joints]
        chain = KinematicChain.from_joints(joints, root if description.bolted else WORLD, end)
        moving = len(chain.joint_names) - (0 if description.bolted else 3)
        if arm is not None and arm.home is not None and len(arm.home) != moving:
            raise ModelError(
                f"home has {len(arm.home)} numbers, but the arm of {description.name} has {moving} joints."
            )
        if arm is not None and arm.accelerations is not None:
            chain = _accelerated(chain, arm.accelerations)
        chain = _with_frames(chain, description, _BASE_LINK if _BASE_LINK in chain.frames else root)
        return cls(description, chain.ending(description.tool or end), urdf)


def turned_like(robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> MobileManipulator:
    """Return the robot with its heading's limits moved by the whole turns that it has made at q: it has no stops."""
    heading = float(q[2]) if robot.base.stop and len(q) > 2 else 0.0
    turns = round(heading / (2 * np.pi)) if np.isfinite(heading) else 0
    return robot if turns == 0 else _turned(robot, turns)


@lru_cache(maxsize=64)
def _turned(robot: MobileManipulator, turns: int) -> MobileManipulator:
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[2] += 2 * np.pi * turns
    upper[2] += 2 * np.pi * turns
    return robot.with_limits(lower, upper)


def description_of(robot: RobotDescription | MobileManipulator) -> RobotDescription:
    """Return what an estimation has to know of a robot, whether or not its arm is loaded."""
    return robot.description if isinstance(robot, MobileManipulator) else robot


def _planar(description: RobotDescription, root: str, taken: Container[str]) -> list[Joint]:
    """Return the joints x, y, θ between the world and the base, rows 1 to 4 of Table B.1."""
    reach, speed, hardest = description.reach, description.velocity_limits, description.acceleration_limits
    limits = [Limits(-reach[i], reach[i], speed[i], hardest[i]) for i in range(3)]
    return [
        Joint(_free("base_x", taken), "prismatic", WORLD, "base_x_link", axis=(1.0, 0.0, 0.0), limits=limits[0]),
        Joint(
            _free("base_y", taken), "prismatic", "base_x_link", "base_y_link", axis=(0.0, 1.0, 0.0), limits=limits[1]
        ),
        Joint(_free("base_theta", taken), "revolute", "base_y_link", root, limits=limits[2]),
    ]


def _free_names(urdf: Urdf, bolted: bool) -> dict[str, str]:
    """Return other names for a URDF's links that are called like frames of ours; a bolted arm's world is its own."""
    return {link: _free(link, urdf.links) for link in _OURS if link in urdf.links and not (bolted and link == WORLD)}


def _free(name: str, taken: Container[str]) -> str:
    while name in taken:
        name = f"robot_{name}"
    return name


def _accelerated(chain: KinematicChain, accelerations: tuple[float, ...]) -> KinematicChain:
    hardest = chain.limits.acceleration.copy()
    if len(accelerations) > len(hardest):
        raise ModelError(f"There are {len(accelerations)} accelerations for {len(hardest)} joints.")
    hardest[len(hardest) - len(accelerations) :] = accelerations
    return chain.with_limits(replace(chain.limits, acceleration=hardest))


def _with_frames(chain: KinematicChain, description: RobotDescription, base: str) -> KinematicChain:
    """Return the chain with the description's own frames and its sensors."""
    for name, placed in description.frames.items():
        chain = chain.with_frame(name, placed.parent, placed.matrix())
    for kind, sensor in (("lidar", description.lidar), ("imu", description.imu)):
        if sensor is None or sensor.mount is None:
            continue
        name, T = sensor.frame or kind, sensor.mount.matrix()
        if name not in chain.frames:
            chain = chain.with_frame(name, base, T)
        elif not np.allclose(chain.relative(base, name), T, atol=1e-6):
            raise ModelError(f"The description and its URDF place {name} differently in {base}; make them agree.")
    return chain
