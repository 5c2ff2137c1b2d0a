"""A serial chain of joints with the frames that it carries, from a DH table or from URDF."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import ModelError
from longreach.geometry import se3, so3
from longreach.robot.dh import DhRow, joints_of
from longreach.robot.joint import Joint
from longreach.robot.kinematics import Kinematics
from longreach.robot.urdf import outward, read_urdf

_ROUNDING = 1e-15  # cos π/2 is 6e-17; exact zeros and ones let the kernel leave products out


def _frozen(value: object, dtype: type = float) -> np.ndarray:
    array = np.array(value, dtype=dtype)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class JointLimits:
    """What each joint can do, arrays (n,) [rad or m, and per s, per s²; N·m or N]; inf where it is not known."""

    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    acceleration: Float[np.ndarray, " n"]
    effort: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "velocity", "acceleration", "effort"):
            value = _frozen(getattr(self, name))
            if value.shape != np.shape(self.lower) or value.ndim != 1:
                raise ModelError(f"The {name} limits have the shape {value.shape}; one number a joint is expected.")
            if np.any(np.isnan(value)):
                raise ModelError(f"The {name} limits have a NaN in them; use inf where there is no limit.")
            object.__setattr__(self, name, value)
        wrong = np.flatnonzero(~(self.lower < self.upper)).tolist()
        if wrong:
            raise ModelError(
                f"The lower limit {self.lower[wrong[0]]:g} of joint {wrong[0]} (from 0) is not below its upper limit "
                f"{self.upper[wrong[0]]:g}; exchange them."
            )


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame that stands at `T` (4, 4) in what the first `joints` joints of a chain move."""

    joints: int
    T: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, eq=False)
class KinematicChain(Kinematics):
    """Joints one after the other, q (n,) in their order, and the frames they carry; its own end is one of them.

    before (n, 4, 4): from one joint to the next, so turned that the next one moves along or about its z.
    sliding (n,): which joints are prismatic.
    """

    joint_names: tuple[str, ...]
    before: Float[np.ndarray, "n 4 4"]
    sliding: Bool[np.ndarray, " n"]
    limits: JointLimits
    frames: Mapping[str, Frame]
    end: str
    _endings: dict[str, "KinematicChain"] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "before", _frozen(self.before))
        object.__setattr__(self, "sliding", _frozen(self.sliding, bool))
        object.__setattr__(self, "frames", dict(self.frames))
        if self.end not in self.frames:
            raise ModelError(f"There is no frame {self.end!r}; there are {', '.join(self.frames)}.")
        end = self.frames[self.end]
        self._hold(np.concatenate([self.before[: end.joints], end.T[None]]), self.sliding)

    @classmethod
    def from_dh(cls, rows: Sequence[DhRow], root: str = "base_link", end: str | None = None) -> "KinematicChain":
        """Return the chain of a standard DH table; `end` is the last row's frame unless another is named."""
        joints = joints_of(rows, root)
        return cls.from_joints(joints, root, end or joints[-1].child)

    @classmethod
    def from_urdf(cls, path: Path, root: str | None = None, end: str | None = None) -> "KinematicChain":
        """Return the chain between two links of a URDF, from its root unless another link is named.

        Raises:
            ModelError: it cannot be read (`read_urdf`), or no end is given and there is more than one.
        """
        urdf = read_urdf(path, end)
        return cls.from_joints(urdf.joints, root or urdf.root, end or only_end(urdf.joints, urdf.root))

    @classmethod
    def from_joints(cls, joints: Iterable[Joint], root: str, end: str) -> "KinematicChain":
        """Return the chain of the joints between two links, with every frame that is fixed to one of its links."""
        beyond = outward(list(joints), root)
        known = [root, *(joint.child for joint in beyond)]
        if end not in known:
            raise ModelError(f"There is no frame {end!r} beyond {root}; there are {', '.join(known)}.")
        path = _path(beyond, root, end)
        T, moving, before, frames = np.eye(4), [], [], {root: Frame(0, _frozen(np.eye(4)))}
        for joint in beyond:
            if joint.parent not in frames or (joint.moves and joint not in path):
                continue  # what a joint outside the chain moves is no frame of the chain
            T = frames[joint.parent].T @ joint.origin
            if joint.moves:
                R = np.eye(4)
                R[:3, :3] = _z_onto(np.array(joint.axis))
                before.append(_exact(T @ R))
                moving.append(joint)
                T = R.T
            frames[joint.child] = Frame(
                len(moving) if joint in path else frames[joint.parent].joints, _frozen(_exact(T))
            )
        names = tuple(joint.name for joint in moving)
        sliding = np.array([joint.kind == "prismatic" for joint in moving], dtype=bool)
        return cls(names, np.array(before).reshape(-1, 4, 4), sliding, _limits(moving), frames, end)

    def ending(self, frame: str) -> "KinematicChain":
        """Return this chain with its end at another of its frames; q keeps its length.

        Raises:
            ModelError: there is no such frame; the sentence names those there are.
        """
        if frame not in self._endings:
            self._endings[frame] = replace(self, end=frame)  # they share this memory
        return self._endings[frame]

    def with_limits(self, limits: JointLimits) -> "KinematicChain":
        """Return this chain with other limits, one a joint."""
        if len(limits.lower) != self.dof:
            raise ModelError(f"There are limits for {len(limits.lower)} joints, but the chain has {self.dof}.")
        return replace(self, limits=limits, _endings={})

    def with_frame(self, name: str, parent: str, T: Float[np.ndarray, "4 4"]) -> "KinematicChain":
        """Return this chain with one more frame, which stands at T in another one."""
        if name in self.frames:
            raise ModelError(f"There is a frame {name} already; give the new one another name.")
        stands = self.ending(parent).frames[parent]
        frames = {**self.frames, name: Frame(stands.joints, _frozen(_exact(stands.T @ T)))}
        return replace(self, frames=frames, _endings={})

    def relative(self, a: str, b: str) -> Float[np.ndarray, "4 4"]:
        """Return T_a_b at q = 0."""
        q = np.zeros(self.dof)
        return se3.inverse(self.ending(a).forward(q)) @ self.ending(b).forward(q)


def _path(joints: Sequence[Joint], root: str, end: str) -> list[Joint]:
    """Return the joints from one link to another, in order."""
    carried = {joint.child: joint for joint in joints}
    path = []
    while end != root:
        path.insert(0, carried[end])
        end = carried[end].parent
    for joint in path:
        if joint.fault:
            raise ModelError(joint.fault)
        if joint.kind in ("planar", "floating"):
            raise ModelError(
                f"Joint {joint.name} is {joint.kind}; a chain's joints are revolute, continuous, prismatic or fixed. "
                "Make it fixed: a mobile base moves by x, y, θ anyway."
            )
        if joint.mimic is not None:
            raise ModelError(
                f"Joint {joint.name} mimics {joint.mimic} and is no joint of its own; end the chain before it, or make "
                "it fixed."
            )
    return path


def only_end(joints: Sequence[Joint], root: str) -> str:
    """Return the link where a tree ends that does not branch."""
    parents = {joint.parent for joint in joints}
    ends = [joint.child for joint in joints if joint.child not in parents] or [root]
    if len(ends) > 1:
        raise ModelError(f"The robot branches: say which of {', '.join(ends)}, or another link, ends the chain.")
    return ends[0]


def _z_onto(axis: np.ndarray) -> np.ndarray:
    """Return a rotation that turns z onto an axis of length 1; onto x, y or z one that only exchanges axes."""
    x, y, z = axis.tolist()
    if 1.0 in (x, y, z):
        return np.roll(np.eye(3), (x, y, z).index(1.0) - 2, axis=0)
    if z == -1.0:
        return np.diag([1.0, -1.0, -1.0])
    turn = np.array([-y, x, 0.0]) / np.hypot(x, y)
    return so3.exp(turn * np.arctan2(np.hypot(x, y), z))


def _exact(T: np.ndarray) -> np.ndarray:
    """Return T with the rounding errors of quarter turns gone from its rotation."""
    R = T[:3, :3]
    whole = np.rint(R)
    T[:3, :3] = np.where(np.abs(R - whole) < _ROUNDING, whole, R)
    return T


def _limits(joints: Sequence[Joint]) -> JointLimits:
    names = ("lower", "upper", "velocity", "acceleration", "effort")
    return JointLimits(*(np.array([getattr(joint.limits, name) for joint in joints], dtype=float) for name in names))
