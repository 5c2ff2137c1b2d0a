"""What a page gathers while it watches a robot."""

from types import SimpleNamespace

import numpy as np
import pytest

from longreach.geometry import se3
from longreach.io.config import description_file
from longreach.robot.chain import KinematicChain
from longreach.view.bodies import rotation
from longreach.view.frame import Frame
from longreach.view.scene import Follower, Scene
from longreach.view.teleop import Teleop
from longreach.view.trails import GrowingMap, Trail


class Drawn(Scene):
    """A scene that keeps the newest of each node."""

    def __init__(self):
        self.paths, self.clouds = {}, {}

    def add_path(self, name, points, colour, wide=3.0):
        self.paths[name] = points

    def add_cloud(self, name, points):
        self.clouds[name] = points


def test_a_long_path_has_few_nodes_and_points_and_no_gap():
    scene = Drawn()
    trail = Trail(scene, "base driven")
    for x in np.arange(0.0, 180.0, 0.06):
        trail.grow(np.array([x, 0.0, 0.0]))
    assert len(trail.points) <= 2000
    assert set(scene.paths) == {"base driven/whole", "base driven/end"}
    whole, end = scene.paths["base driven/whole"], scene.paths["base driven/end"]
    assert whole[0, 0] == 0.0
    assert end[-1, 0] > 179.9
    assert end[0, 0] <= whole[-1, 0] + 1e-9


def test_standing_still_draws_nothing():
    scene = Drawn()
    trail = Trail(scene, "base driven")
    for _ in range(100):
        trail.grow(np.zeros(3))
    assert len(trail.points) == 1
    assert not scene.paths


def test_a_map_is_drawn_as_two_nodes_that_hold_each_cell(rng):
    scene = Drawn()
    seen = GrowingMap(scene)
    for _ in range(60):
        seen.grow(rng.uniform(-2.0, 2.0, (200, 2)))
    assert set(scene.clouds) == {"/map/whole", "/map/end"}
    drawn = {tuple(np.round(p[:2] / 0.04).astype(int)) for cloud in scene.clouds.values() for p in cloud}
    assert drawn == {tuple(np.round(p / 0.04).astype(int)) for p in seen.points}


def test_a_camera_that_follows_moves_as_the_base_does_and_another_stays():
    camera = SimpleNamespace(position=np.array([1.0, 2.0, 3.0]))
    server = SimpleNamespace(get_clients=lambda: {0: SimpleNamespace(camera=camera)})
    follower = Follower(server)
    follower.show(np.array([5.0, 0.0, 0.0]), False)
    np.testing.assert_allclose(camera.position, [1.0, 2.0, 3.0])
    for x in np.arange(5.0, 6.0001, 0.004):
        follower.show(np.array([x, 0.0, 0.0]), True)
    np.testing.assert_allclose(camera.position, [2.0, 2.0, 3.0], atol=0.011)


def test_the_fingers_are_drawn_where_their_joints_have_them(server, thing, rng):
    scene = Scene(server, thing, np.zeros(2), 2.0)
    drawn = {*scene._links, *(joint.child for joint in scene._carried)}
    assert {link.name for link in thing.urdf.links.values() if link.visuals} <= drawn
    urdf = description_file("thing").parent / "thing.urdf"
    finger = KinematicChain.from_urdf(urdf, "gripper", "finger_b_link_3")
    for _ in range(2):
        angles = rng.uniform(0.1, 1.0, finger.dof)
        scene.show(Frame(thing.home, joints=dict(zip(finger.joint_names, angles.tolist(), strict=True))))
        nodes = [node for joint, node in scene._carried.items() if joint.name in finger.joint_names]
        T = np.eye(4)
        for node in nodes:
            T = T @ se3.from_rotation_translation(rotation(*node.wxyz), np.array(node.position))
        np.testing.assert_allclose(T, finger.forward(angles), atol=1e-6)
        assert nodes[0].name.startswith("/robot/gripper/finger_b_link_0")
        assert nodes[-1].name.endswith("/finger_b_link_0/finger_b_link_1/finger_b_link_2/finger_b_link_3")


@pytest.mark.parametrize("known", [True, False])
def test_an_error_is_plotted_only_where_the_truth_is_known(server, pretender, tmp_path, known):
    teleop = Teleop(server, pretender, tmp_path)
    state = vars(pretender.state)
    for i in range(5):
        truth = state["truth"] + [0.003, 0.004, 0.0] if known else None
        teleop._plots.take(SimpleNamespace(**state | {"stamp": float(i), "truth": truth}), show=True)
    error, tool, deviation = (teleop._plots._plots[i].handles[1] for i in range(3))
    assert (error.visible, tool.visible, deviation.visible) == (known, False, True)
    if known:
        np.testing.assert_allclose(error.data[1], 5.0, atol=1e-9)
        np.testing.assert_allclose(error.data[2], 30.0, atol=1e-9)
