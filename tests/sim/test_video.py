"""Films and pictures without a screen, and a window's one sentence where there is none."""

import numpy as np
import pytest
from PIL import Image

from longreach.control.hardware import Command
from longreach.errors import ConfigError
from longreach.io.robots import load_robot
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.physics import Simulation
from longreach.sim.video import Film, picture, write_video
from longreach.sim.viewer import view

THING = load_robot("thing")
RED = (1.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def robot():
    return KinematicRobot(THING)


@pytest.mark.parametrize("suffix", ["gif", "webp", "png"])
def test_a_film_has_a_frame_for_each_picture_and_plays_at_their_rate(tmp_path, suffix):
    frames = [np.full((24, 32, 3), 40 * i, dtype=np.uint8) for i in range(5)]
    write_video(tmp_path / f"film.{suffix}", frames, fps=12.5)
    with Image.open(tmp_path / f"film.{suffix}") as film:
        assert (film.n_frames, film.size) == (5, (32, 24))
        film.seek(3)
        film.load()
        assert film.info["duration"] == pytest.approx(80)
        assert np.abs(np.asarray(film.convert("RGB")).astype(int) - 120).max() < 8


def test_a_film_that_cannot_be_is_refused_with_a_sentence(tmp_path):
    frame = np.zeros((4, 4, 3), dtype=np.uint8)
    with pytest.raises(ConfigError, match=r"a film is a \.gif, \.webp or \.png"):
        write_video(tmp_path / "film.mp4", [frame])
    with pytest.raises(ConfigError, match="There are no pictures"):
        write_video(tmp_path / "film.gif", [])
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        write_video(tmp_path / "file" / "film.gif", [frame])


def test_a_run_is_watched_at_the_films_rate(tmp_path):
    robot, film = KinematicRobot(THING), Film(fps=10.0, width=160, height=120)
    for _ in range(50):
        robot.write(Command(robot.stamp, base=np.array([0.5, 0.0, 0.5])))
        film.watch(robot)
        robot.advance(0.02)
    film.write(tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as written:
        assert (written.n_frames, written.size) == (10, (160, 120))


def test_a_sketch_shows_the_robot_where_it_is_and_trails_in_front(robot):
    plain = picture(robot, (), 320, 240)
    assert plain.shape == (240, 320, 3)
    dark = np.argwhere(plain.max(axis=2) < 60)  # the black chassis
    assert len(dark) > 300
    assert np.abs(dark.mean(axis=0) - [135, 160]).max() < 30  # about the middle of the picture
    tool = THING.forward(THING.home)[:3, 3]
    trail = picture(robot, [(RED, np.array([tool, np.add(tool, [0.0, 0.5, 0.0])]))], 320, 240)
    red = (trail[:, :, 0] > 200) & (trail[:, :, 1] < 60)
    assert red.sum() > 20
    assert not ((plain[:, :, 0] > 200) & (plain[:, :, 1] < 60)).any()


def test_physics_draws_trails_or_falls_back_to_a_sketch(monkeypatch):
    simulation = Simulation(THING)
    red = [(RED, np.array([[0.5, -0.6, 0.5], [1.0, -0.6, 1.0]]))]
    if simulation.draws:
        image = simulation.image("overview", 320, 240, red)
        assert ((image[:, :, 0] > 150) & (image[:, :, 1] < 60)).sum() > 10
    monkeypatch.setattr(type(simulation), "draws", property(lambda self: False))
    image = picture(simulation, red, 320, 240)
    assert ((image[:, :, 0] > 200) & (image[:, :, 1] < 60)).sum() > 10


def test_without_a_screen_the_window_says_so_in_one_sentence(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match="There is no screen for a window"), view(Simulation(THING)):
        pass


def test_a_screen_that_nobody_can_reach_is_one_sentence_too(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":987")

    def refuse(*args, **kwargs):
        raise RuntimeError("no display")

    monkeypatch.setattr("longreach.sim.viewer.engine", lambda part="": type("E", (), {"launch_passive": refuse}))
    with pytest.raises(ConfigError, match=r"No window can be opened \(no display\)"), view(Simulation(THING)):
        pass
