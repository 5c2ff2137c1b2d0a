"""Sources held against each other: who contradicts whom, what would put it right, and that agreement says nothing."""

import re

import numpy as np
import pytest

from longreach.app.plausibility import Fault, Motions, Recent, fault, mended, verdict
from longreach.estimation.planar.measurement_models import PlanarImu
from longreach.estimation.planar.state import Correction
from longreach.measurement import Imu, LaserScan, Odometry, Recording, RelativePoseMeasurement

T = np.arange(0.0, 60.0, 0.1)


def drive(rng):
    """Return heading [rad] and way (n, 2) [m] of a drive that turns both ways."""
    turn = np.cumsum(0.1 * (0.5 * np.sin(0.7 * T) + 0.3 * np.sin(1.9 * T + 1.0)))
    speed = 0.1 * (0.5 + 0.3 * np.sin(0.4 * T))
    return turn, np.cumsum(np.column_stack([speed, np.zeros_like(T)]), axis=0)


def motion(rng, turn=1.0, way=1.0, late=0.0, noise=0.002, has_way=True, aside=0.0):
    heading, gone = drive(rng)
    c, s = np.cos(aside), np.sin(aside)
    gone = way * gone @ np.array([[c, s], [-s, c]])
    noisy = turn * heading + noise * rng.normal(size=len(T)), gone + noise * rng.normal(size=gone.shape)
    return Motions(T + late, noisy[0], noisy[1] if has_way else None, np.zeros(len(T), int))


def three(rng, **changed):
    made = {"wheels": motion(rng), "lidar": motion(rng), "imu": motion(rng, has_way=False)}
    return made | changed


def test_sources_that_agree_have_no_fault(rng):
    assert fault(three(rng), True) is None
    wheels = motion(rng, turn=1.25, way=0.9)  # wheels scrub and slip by as much
    assert fault(three(rng, wheels=wheels), True) is None
    short = {name: Motions(one.stamps[:40], one.heading[:40], None, one.gaps[:40]) for name, one in three(rng).items()}
    assert fault({"imu": short["imu"], "wheels": short["wheels"]}, True) is None


@pytest.mark.parametrize(
    ("k", "mend", "by"), [(-1.0, "turn", -1.0), (180 / np.pi, "turn", 180 / np.pi), (1.9, "leave", 1.0)]
)
def test_a_gyro_against_the_others_is_put_right_by_sign_and_unit_else_left_out(rng, k, mend, by):
    found = fault(three(rng, imu=motion(rng, turn=k, has_way=False)), True)
    assert (found.source, found.mend) == ("imu", mend)
    assert found.by == pytest.approx(by)
    assert "times as far as" in found.remark


def test_a_bias_of_the_gyro_is_no_fault(rng):
    imu = motion(rng, has_way=False)
    assert fault(three(rng, imu=imu._replace(heading=imu.heading + 0.02 * T)), True) is None


@pytest.mark.parametrize("turn", [-1.0, 2.0, 0.4])
def test_wheels_whose_turns_are_wrong_are_left_out(rng, turn):
    wheels = motion(rng, turn=turn)
    for said in (three(rng, wheels=wheels), {"wheels": wheels, "lidar": motion(rng)}):
        found = fault(said, True)
        assert (found.source, found.mend) == ("wheels", "leave")


def test_a_laser_upside_down_is_turned_over_where_two_others_agree(rng):
    found = fault(three(rng, lidar=motion(rng, turn=-1.0)), True)
    assert (found.source, found.mend) == ("lidar", "flip")


def test_of_wheels_and_gyro_alone_it_cannot_be_seen_which_is_wrong(rng):
    found = fault({"wheels": motion(rng), "imu": motion(rng, turn=-1.0, has_way=False)}, True)
    assert found.mend == "note"
    assert "both were used" in found.remark


@pytest.mark.parametrize(("late", "source"), [(1.9, "lidar"), (-0.6, "lidar")])
def test_a_clock_that_differs_is_found_from_the_turns(rng, late, source):
    found = fault(three(rng, lidar=motion(rng, late=late)), True)
    assert (found.source, found.mend) == (source, "shift")
    assert found.by == pytest.approx(late, abs=0.03)


@pytest.mark.parametrize("lag", [0.5, 1.0, 2.0])
def test_wheels_on_ice_turn_before_the_base_and_their_clock_is_right(rng, lag):
    base = motion(rng)
    wheels = base.heading + lag * np.gradient(base.heading, T)  # the base follows them as a low pass
    found = fault(three(rng, wheels=base._replace(heading=wheels)), True)
    assert found is None or found.mend != "shift"


def test_a_lag_of_an_eighth_of_a_second_is_usual(rng):
    assert fault(three(rng, wheels=motion(rng, late=0.13)), True) is None


@pytest.mark.parametrize(("way", "aside"), [(2.0, 0.0), (0.5, 0.0), (1.0, np.pi), (1.0, 0.5)])
def test_wheels_that_go_another_way_than_the_scans_are_left_out(rng, way, aside):
    found = fault({"wheels": motion(rng, way=way, aside=aside), "lidar": motion(rng)}, True)
    assert (found.source, found.mend) == ("wheels", "leave")


def test_a_laser_of_unknown_mount_is_found_by_the_wheels(rng):
    """A laser at l, turned by φ, moves by e^{-iφ} (v + iω l)."""
    wheels, scans = motion(rng, noise=0.0), motion(rng, noise=0.0)
    l, yaw = 0.3 - 0.1j, 2.5
    v, turn = np.diff(wheels.way @ [1.0, 1.0j]), np.diff(wheels.heading)
    moved = np.append(0.0, np.cumsum(np.exp(-1j * yaw) * (v + 1j * turn * l)))
    scans = scans._replace(way=np.column_stack([moved.real, moved.imag]))
    found = fault({"wheels": wheels, "lidar": scans}, False)
    assert found.mend == "mount"
    np.testing.assert_allclose(found.mount, [0.3, -0.1, 2.5], atol=0.01)
    assert fault({"wheels": wheels, "lidar": motion(rng, noise=0.0)}, False) is None


def test_what_is_put_right_is_the_recording():
    scan = LaserScan(1.0, np.ones(9), -1.0, 0.25)
    recording = Recording("made", (Odometry(1.0, np.zeros(3)),), (scan,), (Imu(1.0, np.ones(3)),))
    turned = mended(recording, Fault("imu", "turn", "", -2.0))
    np.testing.assert_array_equal(turned.imu[0].angular_velocity, [-0.5, -0.5, -0.5])
    assert mended(recording, Fault("lidar", "shift", "", 0.4)).scans[0].stamp == pytest.approx(0.6)
    flipped = mended(recording, Fault("lidar", "flip", "")).scans[0]
    np.testing.assert_allclose(flipped.angles, -scan.angles)
    T_base_laser = mended(recording, Fault("lidar", "mount", "", mount=np.array([1.0, 2.0, 0.0]))).mounts["laser"]
    np.testing.assert_allclose(T_base_laser[:2, 3], [1.0, 2.0])
    assert mended(recording, Fault("wheels", "note", "")) is recording


def corrections(rng, scale, n=1000):
    return [Correction(0.1 * i, "lidar", "used", nis=scale * x, dof=3) for i, x in enumerate(rng.chisquare(3, n))]


def test_the_verdict_names_a_covariance_that_does_not_hold_and_where(rng):
    assert verdict(corrections(rng, 1.0)) == ""
    assert verdict(corrections(rng, 0.2)) == ""
    assert re.search(r"NIS 6\d\.\d where 3.0 is right", verdict(corrections(rng, 20.0)))
    late = corrections(rng, 1.0, 500) + [c._replace(stamp=c.stamp + 50.0) for c in corrections(rng, 20.0, 500)]
    assert "in 50% of the run, between 50 s and 100 s" in verdict(late)


def test_while_it_runs_a_contradiction_is_found_once_and_goes_when_it_has_gone(rng):
    """Wheels and a gyro whose sign is wrong for the first two minutes, in steps of a second."""
    recent, found = Recent(), []
    t = np.arange(0.0, 400.0, 0.05)
    rate = 0.5 * np.sin(0.7 * t)
    for start in range(0, len(t) - 20, 20):
        events = []
        for i in range(start, start + 20):
            step = np.array([0.02, 0.0, 0.05 * rate[i]])
            events.append(RelativePoseMeasurement(t[i], t[i + 1], step, 1e-6 * np.eye(3), "wheels"))
            sign = -1.0 if t[i] < 120.0 else 1.0
            events.append(PlanarImu(t[i + 1], sign * rate[i], None, np.zeros(2), 1e-4))
        if recent.take((), events, True):
            found.append((t[start], recent.remark))
    assert [bool(remark) for _, remark in found] == [True, False]
    assert found[0][0] < 30.0
    assert 180.0 <= found[1][0] < 260.0
