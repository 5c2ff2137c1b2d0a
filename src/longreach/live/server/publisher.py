"""What the robot says at each tick, as standard messages; `longreach.live.client.subscriber` reads them again."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from longreach.app.goals import Follow
from longreach.app.robot_side import TickRecord
from longreach.geometry import so3
from longreach.io import messages
from longreach.live.protocol import topics
from longreach.live.protocol.frames import BASE, MAP, ODOM, odom_in_map, tree
from longreach.live.protocol.topics import TYPES, Sensed, Topic
from longreach.measurement import Odometry, WheelSpeeds
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.simulated import Truth

Said = Iterator[tuple[Topic, Any]]


def goal_name(record: TickRecord) -> str:
    """Return what the robot does now: hold, velocity, servo or follow."""
    return type(record.state.goal).__name__.lower().removesuffix("goal")


def state(robot: MobileManipulator, sensed: Sensed, record: TickRecord, truth: Truth | None) -> Said:
    """Yield what makes a `LiveState`; the arm comes last and completes it."""
    tick, stamp = record.tick, record.tick.stamp
    newest = record.state.localizer.belief()
    if robot.base.stop:
        twist, pose = newest.twist, tick.q[robot.base]
        said = Odometry(stamp, pose, twist, tick.covariance)
        yield topics.WHEELS_ALONE, messages.odometry(TYPES, stamp, Odometry(stamp, record.wheels))
        yield topics.ESTIMATE, messages.odometry(TYPES, stamp, said, MAP)
    if truth is not None:
        yield sensed.truth, messages.pose_stamped(TYPES, stamp, truth.base)
        yield topics.TOOL_TRUTH, messages.tool_pose(TYPES, stamp, truth.tool)
    if isinstance(record.state.goal, Follow):
        yield topics.REFERENCE, messages.joint_state(TYPES, stamp, robot.joint_names, tick.q_reference)
    names, position, velocity = _joints(robot, record)
    yield sensed.arm, messages.joint_state(TYPES, stamp, names, position, velocity)


def _joints(robot: MobileManipulator, record: TickRecord) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the arm's joints as estimated at the tick, and behind them those that were only measured."""
    arm = robot.joint_names[robot.arm]
    names, position = list(arm), record.tick.q[robot.arm]
    velocity = record.state.gate.velocity
    if record.readings.joints:
        newest = record.readings.joints[-1]
        if len(newest.velocity) == len(newest.names):
            at = {name: i for i, name in enumerate(newest.names)}
            velocity = np.array([newest.velocity[at[n]] if n in at else 0.0 for n in arm])
            more = [i for i, name in enumerate(newest.names) if name not in arm]
            names += [newest.names[i] for i in more]
            position = np.concatenate([position, newest.position[more]])
            velocity = np.concatenate([velocity, newest.velocity[more]])
    return names, position, velocity


def sensors(robot: MobileManipulator, sensed: Sensed, record: TickRecord) -> Said:
    """Yield what was measured, each with its own stamp."""
    readings, base = record.readings, robot.description.base
    for scan in readings.scans:
        yield sensed.scans, messages.laser_scan(TYPES, scan.stamp, scan)
    for wheels in readings.wheels:
        if isinstance(wheels, Odometry) or base is None:
            continue  # a driver's own odometry is in the estimate
        values = {"velocity": wheels.speeds} if isinstance(wheels, WheelSpeeds) else {"position": wheels.ticks}
        yield sensed.wheels, messages.joint_state(TYPES, wheels.stamp, base.wheel_names, **values)
    for imu in readings.imu:
        yield sensed.imu, messages.imu(TYPES, imu.stamp, imu)
    for wrench in readings.wrenches:
        yield sensed.wrench, messages.wrench(TYPES, wrench.stamp, wrench)


def settled(record: TickRecord) -> Said:
    """Yield the rows of the estimate that nothing changes any more."""
    for row in record.tick.rows:
        yield topics.SETTLED, messages.odometry(TYPES, row.stamp, Odometry(row.stamp, row.pose, None, row.covariance))


def status(record: TickRecord, values: Mapping[str, str]) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray: how the loop is, whether it is stopped, and what else is to be said."""
    stop, goal, around = record.tick.stop, record.state.goal, record.state.gate.obstacles
    known = {
        "goal": goal_name(record),
        "loop_time": f"{record.loop_time:.6f}",
        "latched": str(int(stop is not None and stop.latched)),
        "cause": "" if stop is None else stop.cause,
        "since": "" if stop is None else f"{stop.since:.6f}",
        "progress": f"{goal.progress:.6f}" if isinstance(goal, Follow) else "",
        "why": record.state.why,
        "obstacles": "" if around is None else "minded",
        "limit": "" if around is None else around.reason,
    }
    KeyValue, Status = TYPES["diagnostic_msgs/msg/KeyValue"], TYPES["diagnostic_msgs/msg/DiagnosticStatus"]
    level = 2 if stop is not None and stop.latched else int(stop is not None)  # ok, warn, error
    said = [KeyValue(key, value) for key, value in {**known, **values}.items()]
    one = Status(level, "longreach", "" if stop is None else stop.reason, record.state.robot.name, said)
    header = messages.header(TYPES, record.tick.stamp, "")
    return TYPES["diagnostic_msgs/msg/DiagnosticArray"](header, [one])


def moving_frames(robot: MobileManipulator, record: TickRecord) -> Any:
    """Return a tf2_msgs/TFMessage of all that moves: map → odom → base_link, and the joints of the URDF."""
    stamp, tick = record.tick.stamp, record.tick
    names, positions, _ = _joints(robot, record)
    at = dict(zip(names, positions.tolist(), strict=True))
    stamped = []
    if robot.base.stop:
        in_map = odom_in_map(tick.q[robot.base], record.wheels)
        for parent, child, pose in ((MAP, ODOM, in_map), (ODOM, BASE, record.wheels)):
            T = np.eye(4)
            T[:2, 3], T[:3, :3] = pose[:2], so3.exp(np.array([0.0, 0.0, pose[2]]))
            stamped.append(_stamped(stamp, parent, child, T))
    for joint in tree(robot):
        if joint.moves:
            stamped.append(_stamped(stamp, joint.parent, joint.child, joint.at(at.get(joint.name, 0.0))))
    return TYPES["tf2_msgs/msg/TFMessage"](stamped)


def static_frames(robot: MobileManipulator, stamp: float) -> Any:
    """Return a tf2_msgs/TFMessage of all that does not move."""
    fixed = [joint for joint in tree(robot) if not joint.moves]
    return TYPES["tf2_msgs/msg/TFMessage"]([_stamped(stamp, j.parent, j.child, j.at(0.0)) for j in fixed])


def _stamped(stamp: float, parent: str, child: str, T: np.ndarray) -> Any:
    translation = TYPES["geometry_msgs/msg/Vector3"](*T[:3, 3].tolist())
    turn = TYPES["geometry_msgs/msg/Quaternion"](*messages.quaternion_xyzw(T[:3, :3]).tolist())
    moved = TYPES["geometry_msgs/msg/Transform"](translation, turn)
    return TYPES["geometry_msgs/msg/TransformStamped"](messages.header(TYPES, stamp, parent), child, moved)
