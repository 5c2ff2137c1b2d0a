"""Where all frames of a robot are: map → odom → base_link → the links of its URDF, by its joints."""

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from threading import Lock
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import LiveError
from longreach.geometry import se2, se3, so3
from longreach.live.client.state import LiveState
from longreach.robot.description import Mount
from longreach.robot.joint import Joint
from longreach.robot.mobile_manipulator import MobileManipulator

MAP, ODOM, BASE = "map", "odom", "base_link"
_NEAR = 0.02  # past the newest pose a stamp is taken for that [s]


def tree(robot: MobileManipulator) -> tuple[Joint, ...]:
    """Return all joints below the base, each after the one that carries it; the description's own frames are fixed."""
    joints = list(robot.urdf.joints) if robot.urdf is not None else []
    known = {BASE, *(joint.child for joint in joints)} | ({robot.urdf.root} if robot.urdf is not None else set())
    description = robot.description
    own = [(name, mount.parent, mount.matrix()) for name, mount in description.frames.items()]
    for sensor in (description.lidar, description.imu):
        if sensor is not None and sensor.frame is not None:
            own.append((sensor.frame, BASE, (sensor.mount or Mount()).matrix()))
    joints += [Joint(f"{n}_joint", "fixed", p, n, T) for n, p, T in own if n not in known]
    return tuple(joints)


def odom_in_map(pose: Float[np.ndarray, "3"], wheels: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return where odom is in map, so that the base, seen through it, is where the estimate says: REP-105."""
    return se2.compose(pose, se2.inverse(wheels))


def _planar(pose: np.ndarray) -> np.ndarray:
    """Return the motion (4, 4) of a pose in the plane."""
    return se3.from_rotation_translation(so3.exp(np.array([0.0, 0.0, pose[2]])), np.array([pose[0], pose[1], 0.0]))


class _Known(NamedTuple):
    joints: Mapping[str, float]
    pose: np.ndarray
    wheels: np.ndarray


class Frames:
    """The last `memory` seconds of a robot's frames; safe to be filled by one thread and asked by others."""

    def __init__(self, robot: MobileManipulator, memory: float = 10.0) -> None:
        self._parents: Mapping[str, Joint] = {joint.child: joint for joint in tree(robot)}
        self._root = robot.urdf.root if robot.urdf is not None else BASE
        self._base = robot.base
        self._memory, self._past, self._lock = memory, deque[tuple[float, Callable[[], LiveState]]](), Lock()

    def add(self, stamp: float, state: Callable[[], LiveState]) -> None:
        """Take note of how to learn the state at a stamp [s], if anybody asks; none that is older than the newest."""
        with self._lock:
            if self._past and stamp <= self._past[-1][0]:
                return
            self._past.append((stamp, state))
            while self._past[0][0] < stamp - self._memory:
                self._past.popleft()

    def lookup(self, target: str, source: str, stamp: float | None = None) -> Float[np.ndarray, "4 4"]:
        """Return T_target_source at a time [s], between two instants by what lies between them; None: the newest.

        Raises:
            LiveError: there is no such frame, or it is not known where it was then.
        """
        instant = self._at(stamp)
        T_target, T_source = (self._in_map(frame, instant) for frame in (target, source))
        return se3.inverse(T_target) @ T_source

    def _at(self, stamp: float | None) -> _Known:
        with self._lock:
            past = list(self._past)
        if not past:
            raise LiveError("The robot has not said yet where it is; wait for its first state.")
        first, last = past[0][0], past[-1][0]
        if stamp is None or last <= stamp <= last + _NEAR:
            return self._known(past[-1][1]())
        if not first <= stamp <= last:
            raise LiveError(f"Frames are known from {first:.3f} to {last:.3f} s, not at {stamp:.3f} s.")
        i = bisect_right(past, stamp, key=lambda entry: entry[0])
        (t0, before), (t1, after) = past[i - 1], past[i]
        a, b, part = self._known(before()), self._known(after()), (stamp - t0) / (t1 - t0)
        pose, wheels = (
            se2.retract(x, part * se2.difference(x, y)) for x, y in ((a.pose, b.pose), (a.wheels, b.wheels))
        )
        return _Known({name: x + part * (b.joints.get(name, x) - x) for name, x in a.joints.items()}, pose, wheels)

    def _known(self, state: LiveState) -> _Known:
        pose = state.q[self._base] if self._base.stop else np.zeros(3)
        return _Known(state.joints, pose, state.wheels)

    def _in_map(self, frame: str, instant: _Known) -> np.ndarray:
        """Return T_map_frame."""
        T = np.eye(4)
        while frame in self._parents:
            joint = self._parents[frame]
            T = joint.at(instant.joints.get(joint.name, 0.0)) @ T
            frame = joint.parent
        if frame == MAP:
            return T
        if frame == ODOM:
            return _planar(odom_in_map(instant.pose, instant.wheels)) @ T
        if frame in (self._root, BASE):
            return _planar(instant.pose) @ T
        raise LiveError(f"There is no frame {frame}; there are {', '.join(self.names())}.")

    def names(self) -> Iterator[str]:
        """Yield the names of all frames."""
        yield from (MAP, ODOM, self._root, *self._parents)


connected: list[Frames] = []  # of the robots that are connected, the newest last


def lookup(target: str, source: str, stamp: float | None = None) -> Float[np.ndarray, "4 4"]:
    """Return T_target_source as the robot that was connected to last says; see `Frames.lookup`.

    Raises:
        LiveError: no robot is connected, or it has no such frames then.
    """
    if not connected:
        raise LiveError("No robot is connected; call longreach.connect first.")
    return connected[-1].lookup(target, source, stamp)
