"""Frames: the tree of the URDF, map and odom above it, and what lies between two instants."""

import numpy as np
import pytest

from longreach.errors import LiveError
from longreach.geometry import se2, se3
from longreach.live.client.state import LiveState
from longreach.live.protocol.frames import Frames, odom_in_map


def _pose(T):
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def _instant(names, q, wheels):
    joints = dict(zip(names, q[3:].tolist(), strict=True))
    return LiveState(1.0, q, np.zeros(9), np.zeros((3, 3)), wheels, None, None, joints, q)


@pytest.fixture
def frames(thing, rng):
    """Frames at 1 s and at 2 s, and where the robot was then: q, and the pose by the wheels."""
    names, filled, known = thing.joint_names[thing.arm], Frames(thing), []
    for stamp in (1.0, 2.0):
        q, wheels = rng.uniform(-1.0, 1.0, 9), rng.uniform(-1.0, 1.0, 3)
        filled.add(stamp, lambda q=q, wheels=wheels: _instant(names, q, wheels))
        known.append((q, wheels))
    return filled, known


def test_every_frame_of_the_robot_is_where_its_kinematics_have_it(thing, frames):
    filled, known = frames
    for stamp, (q, _) in zip((1.0, 2.0), known, strict=True):
        for name in ("tool", "flange", "front_laser", "imu_link", "base_link"):
            assert np.allclose(filled.lookup("map", name, stamp), thing.frame(name, q), atol=1e-9), name


def test_the_base_seen_through_odom_is_where_the_estimate_says(frames):
    filled, known = frames
    (_, _), (q, wheels) = known
    assert np.allclose(_pose(filled.lookup("odom", "base_link", 2.0)), wheels)
    assert np.allclose(_pose(filled.lookup("map", "base_link", 2.0)), q[:3])
    assert np.allclose(se2.compose(odom_in_map(q[:3], wheels), wheels), q[:3])


def test_looking_up_and_back_is_nothing_and_ways_compose(frames):
    filled, _ = frames
    there, back = filled.lookup("map", "tool", 1.3), filled.lookup("tool", "map", 1.3)
    assert np.allclose(there @ back, np.eye(4), atol=1e-12)
    assert np.allclose(filled.lookup("map", "base_link", 1.3) @ filled.lookup("base_link", "tool", 1.3), there)


def test_between_two_instants_joints_and_base_are_between(thing, frames):
    filled, known = frames
    (q0, _), (q1, _) = known
    half = np.concatenate([se2.retract(q0[:3], 0.5 * se2.difference(q0[:3], q1[:3])), 0.5 * (q0[3:] + q1[3:])])
    assert np.allclose(filled.lookup("map", "tool", 1.5), thing.forward(half), atol=1e-9)
    assert np.allclose(filled.lookup("map", "tool"), filled.lookup("map", "tool", 2.0))


def test_what_is_not_known_is_said_in_a_sentence(thing, frames):
    filled, _ = frames
    with pytest.raises(LiveError, match="no frame elbow; there are map, odom"):
        filled.lookup("map", "elbow")
    with pytest.raises(LiveError, match=r"from 1\.000 to 2\.000 s, not at 0\.500 s"):
        filled.lookup("map", "tool", 0.5)
    with pytest.raises(LiveError, match="not at 3"):
        filled.lookup("map", "tool", 3.0)
    with pytest.raises(LiveError, match="has not said yet"):
        Frames(thing).lookup("map", "tool")


def test_only_the_last_seconds_are_kept(thing):
    filled = Frames(thing, memory=1.0)
    for stamp in np.arange(0.0, 3.0, 0.25).tolist():
        filled.add(stamp, lambda: _instant(thing.joint_names[thing.arm], np.zeros(9), np.zeros(3)))
    with pytest.raises(LiveError, match=r"from 1\.750"):
        filled.lookup("map", "tool", 1.0)
    assert np.allclose(se3.inverse(filled.lookup("map", "tool")) @ filled.lookup("map", "tool", 2.5), np.eye(4))
