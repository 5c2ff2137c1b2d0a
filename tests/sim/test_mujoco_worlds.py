"""Worlds: shipped ones are drivable, YAML is checked, and what a laser sees is what stands there."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from longreach.errors import ConfigError
from longreach.sim import room
from longreach.sim.worlds import FLOORS, load_world, shipped_worlds


def write(tmp_path, text):
    path = tmp_path / "place.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_laboratory_is_the_room_of_the_kinematic_simulation():
    assert_allclose(load_world("laboratory").segments, room.polygonal_room())


@pytest.mark.parametrize("name", shipped_worlds())
def test_shipped_worlds_are_closed_and_leave_the_robot_room_at_the_origin(name):
    world = load_world(name)
    seen = room.cast(world.at_height(0.233), np.zeros((1, 3)), np.linspace(-np.pi, np.pi, 720))[0]
    assert np.isfinite(seen).all()
    assert seen.min() > 0.65  # half of the base's diagonal
    assert world.name == name


def test_the_worlds_that_are_promised_are_shipped():
    assert set(shipped_worlds()) >= {"corridor", "laboratory", "office", "warehouse"}


def test_a_laser_looks_under_a_table_and_meets_its_legs(tmp_path):
    top, leg = "{x: 2, y: 0, length: 1, width: 1, bottom: 0.7, height: 0.03}", "{x: 2, y: 0.4, length: 0.1, width: 0.1}"
    world = load_world(write(tmp_path, f"name: table\nboxes: [{top}, {leg}]"))
    assert len(world.at_height(0.233)) == 4
    assert len(world.at_height(0.71)) == 8


def test_a_world_of_ones_own_has_walls_boxes_columns_and_a_floor(tmp_path):
    text = "name: mine\nfloor: 0.42\nwalls: [{corners: [[0, 1], [2, 1], [2, 3]]}]\ncolumns: [{x: 5, y: 5, radius: 0.3}]"
    world = load_world(write(tmp_path, text))
    assert len(world.segments) == 2 + 8
    assert world.friction == 0.42
    assert_allclose(world.moved(1.0, -1.0).segments[0], [1.0, 0.0, 3.0, 0.0])
    assert world.with_floor("wet").friction == FLOORS["wet"]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("name: a\nboxes: [{x: 1, y: 1, length: -1, width: 1}]", r"boxes\.0\.length is -1"),
        ("name: a\nwalls: [{corners: [[0, 0]]}]", r"walls\.0\.corners"),
        ("name: a\nwals: []", "wals is not a key here"),
        ("walls: []", "name is missing"),
        ("name: a\nfloor: icy", "floor"),
        ("name: a\nboxes: [{x: .nan, y: 1, length: 1, width: 1}]", r"boxes\.0\.x"),
        ("- 1", "expected keys and values"),
        ("name: [", "this is not YAML"),
    ],
)
def test_a_wrong_world_is_refused_with_one_sentence(tmp_path, text, sentence):
    with pytest.raises(ConfigError, match=sentence):
        load_world(write(tmp_path, text))


def test_an_unknown_world_or_floor_names_those_there_are():
    with pytest.raises(
        ConfigError, match=r"moon is neither a world that longreach knows .*laboratory.* nor a YAML file"
    ):
        load_world("moon")
    for floor in ("icy", 0.0, float("nan")):
        with pytest.raises(ConfigError, match="A floor is one of good, worn, wet, slippery"):
            load_world("office").with_floor(floor)
