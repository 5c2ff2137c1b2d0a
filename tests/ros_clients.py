"""What drives and watches a robot in the tests: ROS' own actionlib and tf, and our hardware; run in `other`."""

import time

import numpy as np
from ros_nodes import listening, odometry, until, wheels_message

from longreach.control.hardware import Command
from longreach.geometry import se2
from longreach.io import messages
from longreach.ros import wire
from longreach.ros.hardware import connect_ros

ODOMETRY = "nav_msgs/msg/Odometry"
ACTION = "control_msgs/FollowJointTrajectoryAction"
_LINE = "=" * 80 + "\n"


def action_messages():
    """The classes of the action by genpy itself, from their definitions."""
    from genpy.dynamic import generate_dynamic

    parts = {}
    for kind in ("Goal", "Result", "Feedback"):
        text, _ = wire.store().generate_msgdef(f"{ACTION.replace('/', '/msg/')}{kind}", ros_version=1)
        own, *others = text.split(_LINE)
        parts[f"{ACTION}{kind}"] = own
        parts |= {name.removeprefix("MSG: "): body for name, _, body in (other.partition("\n") for other in others)}
    fields = "".join(f"{ACTION}{kind} action_{kind.lower()}\n" for kind in ("Goal", "Result", "Feedback"))
    return generate_dynamic(ACTION, fields + "".join(f"{_LINE}MSG: {name}\n{body}" for name, body in parts.items()))


def action_goals(names, goals):
    """Send goals one after the other through actionlib's own client, and return how each ended.

    goals: (positions, after [s], tolerances on the way [rad, rad/s], after how long it is cancelled [s], None: not).
    """
    import actionlib

    classes, Duration = action_messages(), wire.rospy().Duration
    client = actionlib.SimpleActionClient("/arm_controller/follow_joint_trajectory", classes[ACTION])
    assert client.wait_for_server(Duration(30.0))
    ended = []
    for positions, after, tolerance, cancelled in goals:
        goal = classes["control_msgs/FollowJointTrajectoryGoal"]()
        point = classes["trajectory_msgs/JointTrajectoryPoint"]()
        point.positions, point.time_from_start = list(positions), Duration(after)
        goal.trajectory.joint_names, goal.trajectory.points = list(names), [point]
        Tolerance = classes["control_msgs/JointTolerance"]
        goal.path_tolerance = [Tolerance(name, *tolerance, 0.0) for name in names]
        fed = []
        client.send_goal(goal, feedback_cb=fed.append)
        if cancelled:
            time.sleep(cancelled)
            client.cancel_goal()
        assert client.wait_for_result(Duration(20.0))
        result = client.get_result()
        ended.append((client.get_state(), result.error_code, result.error_string, len(fed)))
    return ended


def joint_positions(names):
    """Where joints are now (n,) [rad]."""
    with listening("/joint_states", "sensor_msgs/msg/JointState") as (heard, _):
        until(lambda: any(set(names) <= set(message.name) for message in heard), 10.0, "a joint state")
    last = [message for message in heard if set(names) <= set(message.name)][-1]
    return np.array([last.position[list(last.name).index(name)] for name in names])


def frames_by_tf(root, frames, joints, count):
    """Where frames stand in a root as ROS' tf says, at times at which joints were told: q (n,), and T by frame."""
    from tf2_msgs.msg import TFMessage
    from tf2_py import BufferCore, TransformException

    Time, Subscriber = wire.rospy().Time, wire.rospy().Subscriber
    buffer, stamps = BufferCore(wire.rospy().Duration(30.0)), set()  # tf interpolates, between stamps that it was told

    def take(message):
        for transform in message.transforms:
            buffer.set_transform(transform, "test")
            stamps.add((transform.header.stamp.secs, transform.header.stamp.nsecs))

    def take_static(message):
        for transform in message.transforms:
            buffer.set_transform_static(transform, "test")

    subscribed = [Subscriber("/tf", TFMessage, take), Subscriber("/tf_static", TFMessage, take_static)]
    found = []
    with listening("/joint_states", "sensor_msgs/msg/JointState") as (heard, _):

        def look():
            for message in [message for message in heard if set(joints) <= set(message.name)]:
                stamp = Time(message.header.stamp.sec, message.header.stamp.nanosec)
                if (stamp.secs, stamp.nsecs) not in stamps:
                    continue
                try:
                    told = {frame: buffer.lookup_transform_core(root, frame, stamp).transform for frame in frames}
                except TransformException:
                    continue
                q = np.array([message.position[list(message.name).index(name)] for name in joints])
                found.append((q, {frame: _numbers(transform) for frame, transform in told.items()}))
            del heard[:-100]
            return len(found) >= count

        until(look, 30.0, "tf")
    for subscription in subscribed:
        subscription.unregister()
    return found


def _numbers(transform):
    t, q = transform.translation, transform.rotation
    return np.array([t.x, t.y, t.z, q.x, q.y, q.z, q.w])


def driven(robot, arm, twist, velocity, seconds):
    """Drive a robot through `connect_ros` and let it be; return for how long, the arm's way, and the truths around it.

    After the last command nothing is said, and a second later nothing moves.
    """
    hardware = connect_ros(robot, arm=arm)
    names = hardware.capabilities.arm_names
    with listening("/truth", "geometry_msgs/msg/PoseStamped") as (truth, _):
        until(lambda: truth, 10.0, "the truth")
        q, base = joint_positions(names), _place(truth[-1])
        hardware.read()
        begin, heard = hardware.read().stamp, []
        for i in range(round(seconds / 0.02)):
            hardware.wait_until(begin + 0.02 * i)
            heard.append(hardware.read())
            hardware.write(Command(heard[-1].stamp, np.array(velocity), "velocity", np.array(twist)))
        took = hardware.read().stamp - begin
        time.sleep(1.0)
        q_after, base_after = joint_positions(names), _place(truth[-1])
        time.sleep(0.2)
        still = np.abs(joint_positions(names) - q_after).max() < 1e-3
        hardware.stop("The test has ended.")
        hardware.close()
    counts = {kind: sum(len(getattr(r, kind)) for r in heard) for kind in ("wheels", "scans", "imu", "joints")}
    return took, q_after - q, base, base_after, still, counts


def followed(robot, twist, seconds):
    """Drive beside an estimate: the way (3,) that it thinks and the true one, tf's frame and its child, and who is told
    of in the diagnostics."""
    hardware = connect_ros(robot)
    with (
        listening("/truth", "geometry_msgs/msg/PoseStamped") as (truth, _),
        listening("/odometry/filtered", ODOMETRY) as (filtered, ready),
        listening("/tf", "tf2_msgs/msg/TFMessage") as (frames, _),
        listening("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray") as (told, _),
    ):
        ready()
        until(lambda: truth and filtered, 30.0, "the estimate")
        true, thought = _place(truth[-1]), _thought(filtered[-1])
        begin = hardware.read().stamp
        for i in range(round(seconds / 0.02)):
            hardware.wait_until(begin + 0.02 * i)
            hardware.write(Command(hardware.read().stamp, base=np.array(twist)))
        time.sleep(1.0)
        way = se2.between(true, _place(truth[-1]))
        way_thought = se2.between(thought, _thought(filtered[-1]))
        hardware.close()
    pairs = {(t.header.frame_id, t.child_frame_id) for message in frames for t in message.transforms}
    (frame,) = {pair for pair in pairs if pair[1] == "base_link"}
    return way_thought, way, frame, {status.name for message in told for status in message.status}


def stopped(robot, twist):
    """Drive, press the stop, and let it go: how fast the base is in each [m/s], and whether we heard of the stop."""
    hardware, told = connect_ros(robot), []
    button, types = wire.Publisher("/emergency_stop", "std_msgs/msg/Bool"), wire.message_types()
    until(lambda: button.listeners > 1, 10.0, "who listens to the stop")
    speeds = []
    with listening("/truth", "geometry_msgs/msg/PoseStamped") as (truth, _):
        for pressed in (False, True, False):
            button.send(types["std_msgs/msg/Bool"](pressed))
            begin = hardware.read().stamp
            for i in range(60):
                hardware.wait_until(begin + 0.02 * i)
                told.append(hardware.read().emergency_stop)
                hardware.write(Command(begin + 0.02 * i, base=np.array(twist)))
            a, b = truth[-11], truth[-1]
            way = np.linalg.norm((_place(b) - _place(a))[:2])
            speeds.append(way / (_seconds(b.header.stamp) - _seconds(a.header.stamp)))
    hardware.close()
    return *speeds, any(told) and not told[-1]


def _seconds(stamp):
    return (stamp.sec * 10**9 + stamp.nanosec) / 10**9


def _thought(message):
    (estimate,) = odometry([message]).values()
    return estimate[0]


def _place(message):
    position, q = message.pose.position, message.pose.orientation
    return np.array([position.x, position.y, 2.0 * np.arctan2(q.z, q.w)])


def told_of_bad_readings(robot, recording):
    """Send a recording in which messages are bad in five ways; what the estimate's diagnostics say of the readings, and
    how many times odometry came after the last bad one."""
    types, kinds = wire.message_types(), {}
    kinds["wheels"] = wire.Publisher("/joint_states", "sensor_msgs/msg/JointState")
    kinds["imu"] = wire.Publisher("/imu/data", "sensor_msgs/msg/Imu")
    kinds["scans"] = wire.Publisher("/front/scan", "sensor_msgs/msg/LaserScan")
    make = {
        "wheels": lambda stamp, one: wheels_message(robot, types, stamp, one),
        "imu": lambda stamp, one: messages.imu(types, stamp, one),
        "scans": lambda stamp, one: messages.laser_scan(types, stamp, one),
    }
    rows = [(one.stamp, kind, one) for kind in kinds for one in getattr(recording, kind)]
    rows.sort(key=lambda row: row[0])
    with (
        listening("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray") as (told, _),
        listening("/odometry/filtered", ODOMETRY) as (filtered, ready),
    ):
        ready()
        until(lambda: all(publisher.listeners for publisher in kinds.values()), 20.0, "the node")
        offset, count = wire.now() - rows[0][0], 0
        for at, kind, one in rows:
            time.sleep(max(at + offset - wire.now(), 0.0))
            message, count = make[kind](at + offset, one), count + 1
            if kind == "imu" and count % 20 == 0:
                message.angular_velocity.x = float("nan")
            elif kind == "imu" and count % 21 == 0:
                message.header.stamp.sec -= 1
            elif kind == "imu" and count % 22 == 0:
                message.header.stamp.sec = 5  # 1970
            elif kind == "wheels" and count % 20 == 0:
                message.position = message.position[:3]
            elif kind == "scans":
                message.ranges = 1000.0 * message.ranges
                message.range_max = 1e5
            kinds[kind].send(message)
        came = len(filtered)
        time.sleep(1.5)
        said = {status.message for array in told for status in array.status if status.name == "longreach: readings"}
    return said, came
