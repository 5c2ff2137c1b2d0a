"""Wheel odometry: geometry of the motions, growth of the covariance, slip, breaks, bad input, records one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from longreach.errors import EstimationError
from longreach.geometry import se2
from longreach.measurement import Odometry, WheelSpeeds, WheelTicks
from longreach.odometry import wheel
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.wheel import WheelConfig, wheel_odometry
from longreach.robot.bases import AckermannBase, DifferentialBase, MecanumBase
from longreach.robot.description import Encoder, RobotDescription, WheelNoise

THING = RobotDescription(
    name="thing", base=MecanumBase(wheel_radius=0.0759, half_length=0.319, half_width=0.2755), encoder=Encoder()
)
CART = RobotDescription(
    name="cart",
    base=DifferentialBase(wheel_radius=0.1, track_width=0.4),
    encoder=Encoder(signal="ticks", counts_per_revolution=1000.0),
)
DRIVER = RobotDescription(name="driver", drive="differential")
FULL_CIRCLE = np.array([2 * np.pi * 0.5 / 10, 0.0, 2 * np.pi / 10])  # twist: round a circle of 0.5 m in 10 s


def records(robot, twist, duration=10.0, rate=50.0):
    """Wheels that follow one constant twist without any fault."""
    stamps = np.arange(round(duration * rate) + 1) / rate
    turned = np.outer(stamps, robot.base.inverse_matrix @ twist) / robot.encoder.radians_per_tick
    return [WheelTicks(float(t), row) for t, row in zip(stamps, turned, strict=True)]


def path(wheels, robot, config=None):
    return integrate(wheel_odometry(wheels, robot, config).measurements, [w.stamp for w in wheels])


@pytest.mark.parametrize("robot", [THING, CART], ids=lambda robot: robot.name)
def test_a_constant_twist_on_a_circle_closes(robot):
    wheels = records(robot, FULL_CIRCLE)
    driven = path(wheels, robot)
    np.testing.assert_allclose(driven.poses[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.hypot(driven.poses[:, 0], driven.poses[:, 1] - 0.5), 0.5, atol=1e-12)


@pytest.mark.parametrize("robot", [THING, CART], ids=lambda robot: robot.name)
def test_turning_on_the_spot_leaves_position_unchanged(robot):
    driven = path(records(robot, np.array([0.0, 0.0, 0.7])), robot)
    np.testing.assert_allclose(driven.poses[:, :2], 0.0, atol=1e-13)
    assert driven.poses[-1, 2] == pytest.approx(7.0 - 2 * np.pi)


def test_a_mecanum_base_moves_sideways():
    np.testing.assert_allclose(
        path(records(THING, np.array([0.0, 0.4, 0.0])), THING).poses[-1], [0.0, 4.0, 0.0], atol=1e-12
    )


def test_speeds_and_twists_are_integrated_by_the_trapezoid():
    stamps = np.arange(0.0, 2.0, 0.02)  # speeding up evenly: exact
    speeds = [WheelSpeeds(float(t), np.full(4, t)) for t in stamps]
    twists = [Odometry(float(t), twist=np.array([0.0759 * t, 0.0, 0.0])) for t in stamps]
    expected = [0.0759 * stamps[-1] ** 2 / 2, 0.0, 0.0]
    np.testing.assert_allclose(path(speeds, THING).poses[-1], expected, atol=1e-14)
    np.testing.assert_allclose(path(twists, DRIVER).poses[-1], expected, atol=1e-14)


def test_a_drivers_poses_and_its_twists_tell_the_same(rng):
    start = np.array([5.0, -3.0, 2.0])
    stamps = np.arange(0.0, 10.02, 0.02)
    poses = se2.compose(start, se2.exp(np.outer(stamps, FULL_CIRCLE)))
    pairs = zip(stamps.tolist(), poses, strict=True)
    by_pose = path([Odometry(t, pose=p, twist=rng.normal(size=3)) for t, p in pairs], DRIVER)
    by_twist = path([Odometry(float(t), twist=FULL_CIRCLE) for t in stamps], DRIVER)
    np.testing.assert_allclose(se2.difference(by_pose.poses, by_twist.poses), 0.0, atol=1e-12)


def test_a_description_may_name_the_wheels_in_another_order():
    order = [0, 3, 1, 2]
    names = tuple(THING.base.wheel_names[i] for i in order)
    other = THING.model_copy(update={"base": THING.base.model_copy(update={"wheel_names": names})})
    twist = np.array([0.3, -0.2, 0.4])
    wheels = [WheelTicks(w.stamp, w.ticks[order]) for w in records(THING, twist)]
    fresh = RobotDescription.model_validate(other.model_dump())
    np.testing.assert_allclose(path(wheels, fresh).poses, path(records(THING, twist), THING).poses, atol=1e-12)


@pytest.mark.parametrize("covariance", ["growing", "constant"])
@pytest.mark.parametrize("twist", [[0.5, 0.0, 0.0], [0.3, 0.2, 0.9], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
def test_the_covariance_is_definite_and_does_not_depend_on_the_rate(twist, covariance):
    config = WheelConfig(covariance=covariance)
    fast, slow = (path(records(THING, np.array(twist), rate=rate), THING, config) for rate in (100.0, 5.0))
    np.testing.assert_allclose(fast.covariance[-1], slow.covariance[-1], rtol=1e-4, atol=1e-9)
    for m in wheel_odometry(records(THING, np.array(twist)), THING, config).measurements:
        assert np.linalg.eigvalsh(m.covariance).min() > 0
        np.testing.assert_array_equal(m.covariance, m.covariance.T)


def test_on_a_straight_line_the_covariance_is_the_closed_form():
    noise = WheelNoise(along=0.03, across=0.02, turning=0.05, heading_travel=0.04, rest=1e-9, heading_rest=1e-9)
    robot = THING.model_copy(update={"wheel_noise": noise})
    d = 3.0
    P = path(records(robot, np.array([d / 10, 0.0, 0.0])), robot).covariance[-1]
    h = noise.heading_travel**2
    wanted = [
        [noise.along**2 * d, 0, 0],
        [0, noise.across**2 * d + h * d**3 / 3, h * d**2 / 2],
        [0, h * d**2 / 2, h * d],
    ]
    np.testing.assert_allclose(P, wanted, rtol=1e-5, atol=1e-12)


def test_along_and_across_turn_with_the_direction_of_travel():
    noise = WheelNoise(along=0.05, across=0.01, turning=0.0, heading_travel=0.0, heading_turning=0.0)
    robot = THING.model_copy(update={"wheel_noise": noise})
    forward, sideways = (path(records(robot, np.array(t)), robot).covariance[-1] for t in ([0.3, 0, 0], [0, 0.3, 0]))
    np.testing.assert_allclose(forward[0, 0], 0.05**2 * 3, rtol=1e-3)
    np.testing.assert_allclose(sideways[:2, :2], forward[:2, :2][::-1, ::-1], rtol=1e-3, atol=1e-9)


def test_a_standing_robot_stays_sure_of_where_it_is():
    P = path(records(THING, np.zeros(3), duration=100.0), THING).covariance[-1]
    np.testing.assert_allclose(np.sqrt(np.diag(P)), 1e-3, rtol=1e-6)


def test_the_constant_covariance_is_the_thesis_at_50_hz():
    wheels = records(THING, np.zeros(3), duration=1.0)
    m = wheel_odometry(wheels, THING, WheelConfig(covariance="constant")).measurements[0]
    np.testing.assert_allclose(m.covariance, np.diag([0.001, 0.001, 0.03]) * 0.02**2, rtol=1e-9)


def test_slip_is_measured_and_widens_the_covariance_by_the_distance_slipped():
    twist, speed = np.array([0.3, 0.1, 0.2]), 0.05
    clean = records(THING, twist)
    fourth = np.linalg.pinv(THING.base.residual_matrix)[:, 0]
    slipping = [WheelTicks(w.stamp, w.ticks + fourth * speed * w.stamp) for w in clean]
    config = WheelConfig(slip_window=0.02)
    plain, slid = wheel_odometry(clean, THING, config), wheel_odometry(slipping, THING, config)
    np.testing.assert_allclose(plain.slip, 0.0, atol=1e-12)
    np.testing.assert_allclose(slid.slip, speed)
    np.testing.assert_allclose(slid.measurements[7].pose, plain.measurements[7].pose, atol=1e-12)
    more = slid.measurements[7].covariance - plain.measurements[7].covariance
    rho = speed * 0.02
    np.testing.assert_allclose(np.diag(more), [rho**2, rho**2, (rho / THING.base.lever) ** 2], rtol=1e-3)


def test_the_slip_of_a_window_does_not_depend_on_the_rate():
    fourth = np.linalg.pinv(THING.base.residual_matrix)[:, 0]
    ends = []
    for rate in (100.0, 20.0):
        wheels = [WheelTicks(w.stamp, fourth * 0.05 * w.stamp) for w in records(THING, np.zeros(3), rate=rate)]
        ends.append(np.diag(path(wheels, THING).covariance[-1]))
    np.testing.assert_allclose(*ends, rtol=0.02)  # the first window is shorter


def test_two_wheels_cannot_tell_slip():
    assert wheel_odometry(records(CART, FULL_CIRCLE), CART).slip is None


def test_an_encoder_that_jumps_is_a_break_and_the_path_goes_on_behind_it():
    wheels = records(CART, np.array([0.2, 0.0, 0.0]))
    after = [WheelTicks(w.stamp, w.ticks - (1e6 if i >= 100 else 0)) for i, w in enumerate(wheels)]
    found = wheel_odometry(after, CART)
    assert (found.breaks, len(found.measurements)) == (1, len(wheels) - 2)
    assert not [m for m in found.measurements if m.stamp == wheels[100].stamp]
    np.testing.assert_allclose(path(after, CART).poses[-1], [2.0 - 0.2 / 50, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("jump", [1e6, 1e300])
def test_one_wrong_count_breaks_two_steps_and_no_more(jump):
    wheels = records(THING, np.array([0.2, 0.0, 0.0]))
    glitch = [WheelTicks(w.stamp, w.ticks + (jump if i == 100 else 0)) for i, w in enumerate(wheels)]
    found = wheel_odometry(glitch, THING)
    assert found.breaks == 2
    np.testing.assert_allclose(found.slip, 0.0, atol=1e-12)
    assert all(np.isfinite(m.covariance).all() for m in found.measurements)


def test_a_reset_to_zero_while_driving_is_a_break():
    wheels = records(CART, np.array([0.2, 0.0, 0.0]))
    reset = [WheelTicks(w.stamp, w.ticks - (wheels[300].ticks if i >= 300 else 0)) for i, w in enumerate(wheels)]
    assert wheel_odometry(reset, CART).breaks == 1


@pytest.mark.parametrize("bits", [16, 32])
def test_an_encoder_of_known_width_wraps_without_a_break(bits):
    encoder = CART.encoder.model_copy(update={"bits": bits})
    robot = CART.model_copy(update={"encoder": encoder})
    wheels = records(robot, np.array([-0.3, 0.0, 0.1]))
    half = 2.0 ** (bits - 1)
    wrapped = [WheelTicks(w.stamp, (w.ticks - half + 100 + half) % (2 * half) - half) for w in wheels]
    assert max(np.ptp([w.ticks[0] for w in wrapped]), np.ptp([w.ticks[1] for w in wrapped])) > half
    found = wheel_odometry(wrapped, robot)
    assert found.breaks == 0
    np.testing.assert_allclose(path(wrapped, robot).poses[-1], path(wheels, robot).poses[-1], atol=1e-6)
    unknown = wheel_odometry(wrapped, CART)
    assert (unknown.breaks, unknown.wraps, unknown.wrap_range) == (0, 2, 2 * half)


@pytest.mark.parametrize("late", [1, 2, 50])
def test_a_late_message_is_no_break(late):
    wheels = records(THING, np.array([0.5, 0.0, 0.0]), duration=2.0)
    stamped = [WheelTicks(w.stamp + (0.0199 if i == late else 0.0), w.ticks) for i, w in enumerate(wheels)]
    assert wheel_odometry(stamped, THING).breaks == 0


def held_up(wheels, first, count):
    """Stamps as of arrival, where `count` messages from `first` on were held up and came 1 ms apart."""
    until = wheels[first + count].stamp - 0.001 * (count + 1)
    arrived = {first + i: until + 0.001 * i for i in range(count)}
    return [WheelTicks(arrived.get(i, w.stamp), w.ticks) for i, w in enumerate(wheels)]


@pytest.mark.parametrize("count", [5, 13, 40])
def test_messages_that_were_held_up_and_come_all_at_once_are_no_breaks(count):
    wheels = records(THING, np.array([0.5, 0.0, 0.3]))
    for first in (60, 240):
        assert wheel_odometry(held_up(wheels, first, count), THING).breaks == 0


def test_a_jump_right_after_messages_that_were_held_up_is_a_break():
    wheels = held_up(records(THING, np.array([0.5, 0.0, 0.3])), 60, 13)
    jumped = [WheelTicks(w.stamp, w.ticks + (5.0 if i > 73 else 0.0)) for i, w in enumerate(wheels)]  # 0.38 m
    found = wheel_odometry(jumped, THING)
    assert found.breaks == 1
    assert wheels[74].stamp not in [m.stamp for m in found.measurements]


def test_a_long_pause_does_not_hide_a_jump_after_it():
    wheels = records(THING, np.array([0.5, 0.0, 0.0]))
    jumped = [WheelTicks(w.stamp + (3600.0 if i >= 100 else 0.0), w.ticks) for i, w in enumerate(wheels)]
    jumped = [WheelTicks(w.stamp, w.ticks + (5.0 if i > 101 else 0.0)) for i, w in enumerate(jumped)]
    assert wheel_odometry(jumped, THING).breaks == 1


def test_counts_bridge_a_gap_and_speeds_do_not():
    twist = np.array([0.2, 0.0, 0.1])
    wheels = records(THING, twist)
    gap = wheels[:100] + wheels[250:]
    assert wheel_odometry(gap, THING).breaks == 0
    np.testing.assert_allclose(path(gap, THING).poses[-1], path(wheels, THING).poses[-1], atol=1e-12)
    speeds = [WheelSpeeds(w.stamp, THING.base.inverse_matrix @ twist) for w in gap]
    assert wheel_odometry(speeds, THING).breaks == 1


def test_of_records_with_one_stamp_the_first_is_used_and_no_motion_is_lost():
    wheels = records(THING, np.array([0.2, 0.0, 0.1]), duration=1.0)
    doubled = [WheelTicks(wheels[i - i % 2].stamp, w.ticks) for i, w in enumerate(wheels)]
    found = wheel_odometry(doubled, THING)
    assert [(m.stamp_reference, m.stamp) for m in found.measurements] == [
        (a.stamp, b.stamp) for a, b in zip(wheels[:-2:2], wheels[2::2], strict=True)
    ]
    driven = path(doubled, THING)
    assert len(driven) == len(doubled)
    np.testing.assert_allclose(driven.poses[-1], path(wheels, THING).poses[-1], atol=1e-12)


def test_numbers_that_are_not_finite_are_counted_and_stepped_over():
    wheels = records(THING, np.array([0.2, 0.0, 0.1]))
    bad = [WheelTicks(w.stamp, w.ticks * (np.nan if i in (0, 40, 41) else 1.0)) for i, w in enumerate(wheels)]
    found = wheel_odometry(bad, THING)
    assert (found.refused, found.breaks) == (3, 0)
    assert all(np.isfinite(m.pose).all() and np.isfinite(m.covariance).all() for m in found.measurements)
    nothing = wheel_odometry([WheelTicks(0.1 * i, np.full(4, np.inf)) for i in range(3)], THING)
    assert (nothing.refused, nothing.measurements) == (3, ())


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_records_give_nothing(count):
    assert wheel_odometry(records(THING, FULL_CIRCLE)[:count], THING).measurements == ()


TICKS = [WheelTicks(0.0, np.zeros(4)), WheelTicks(0.1, np.zeros(4))]


@pytest.mark.parametrize(
    ("wheels", "robot", "message"),
    [
        ([TICKS[0], WheelSpeeds(0.1, np.zeros(4))], THING, "of several kinds"),
        ([TICKS[1], TICKS[0]], THING, "run backwards"),
        ([TICKS[0], WheelTicks(0.1, np.zeros(3))], THING, "changing length"),
        (TICKS, CART, "has 4 numbers, but cart has 2 wheels: left, right"),
        (TICKS, DRIVER, "description of driver has no base"),
        (TICKS, THING.model_copy(update={"encoder": None}), "description of thing has no encoder"),
        ([Odometry(0.0, pose=np.zeros(3)), Odometry(0.1, twist=np.zeros(3))], DRIVER, "Neither a pose nor a twist"),
    ],
)
def test_records_that_do_not_fit_are_refused_with_a_sentence(wheels, robot, message):
    with pytest.raises(EstimationError, match=message):
        wheel_odometry(wheels, robot)


TICKED = THING.model_copy(
    update={"encoder": Encoder(signal="ticks", counts_per_revolution=100.0), "wheel_noise": WheelNoise()}
)


def test_a_reading_of_wheels_at_rest_is_as_wrong_as_its_rounding(rng):
    """Two roads: the closed form, and counts that are rounded."""
    wheels = [WheelTicks(0.1 * i, np.zeros(4)) for i in range(3)]
    R = wheel_odometry(wheels, TICKED).measurements[0].reading_covariance
    turned = rng.uniform(-0.5, 0.5, (100_000, 4)) * TICKED.encoder.resolution
    sampled = np.var(turned @ TICKED.base.forward_matrix.T, axis=0)
    np.testing.assert_allclose(np.diag(R), sampled, rtol=0.03)
    assert np.linalg.eigvalsh(R).min() > 0


def test_a_reading_is_as_old_as_a_step_at_most(rng):
    """Two roads: the closed form, and poses that a driver publishes up to one step after they were true."""
    stamps = np.arange(0.0, 2.0, 0.1)
    wheels = [Odometry(float(t), pose=p) for t, p in zip(stamps, se2.exp(np.outer(stamps, FULL_CIRCLE)), strict=True)]
    R = wheel_odometry(wheels, DRIVER).measurements[5].reading_covariance
    age = rng.uniform(0.0, 0.1, 100_000)
    error = se2.log(se2.exp(np.outer(age, FULL_CIRCLE)))
    np.testing.assert_allclose(R, error.T @ error / len(age), rtol=0.02, atol=1e-8)


def test_the_age_of_a_reading_is_told_by_its_own_step_and_the_one_before_without_breaks():
    x = np.array([0.0, 0.01, 0.04, 0.05, 5.0, 5.02])
    wheels = [Odometry(0.1 * i, pose=np.array([v, 0.0, 0.0])) for i, v in enumerate(x)]
    ending = {m.stamp: m.reading_covariance[0, 0] for m in wheel_odometry(wheels, DRIVER).measurements}
    pairs = {1: (0.01, 0.01), 2: (0.03, 0.01), 3: (0.01, 0.03), 5: (0.02, 0.0)}
    assert set(ending) == {wheels[i].stamp for i in pairs}
    for i, (own, before) in pairs.items():
        assert ending[wheels[i].stamp] == pytest.approx((own**2 + before**2) / 6, abs=2e-10)


def test_what_is_known_of_a_reading_does_not_look_across_a_jump():
    wheels = records(THING, np.array([0.5, 0.0, 0.0]), duration=1.0)
    jumped = [WheelTicks(w.stamp, w.ticks + (1e5 if w.stamp > 0.5 else 0.0)) for w in wheels]
    found = wheel_odometry(jumped, THING)
    assert found.breaks == 1
    assert max(m.reading_covariance.max() for m in found.measurements) < 0.02**2


def test_the_constant_covariance_knows_nothing_of_readings():
    found = wheel_odometry(records(THING, FULL_CIRCLE, duration=0.2), THING, WheelConfig(covariance="constant"))
    assert all(m.reading_covariance is None for m in found.measurements)


def blocks(wheels, robot, config, lengths):
    """Feed records in blocks of the lengths given, again and again; return the state and all steps."""
    state, steps, at, turn = wheel.init(robot, config), [], 0, 0
    while at < len(wheels):
        length = lengths[turn % len(lengths)]
        state, found = wheel.step(state, wheels[at : at + length])
        steps, at, turn = [*steps, *found], at + length, turn + 1
    return state, steps


def bits(steps):
    return [
        (m.stamp_reference, m.stamp, m.pose.tobytes(), m.covariance.tobytes(), m.reading_covariance is not None)
        + (() if m.reading_covariance is None else (m.reading_covariance.tobytes(),))
        for m in steps
    ]


def state_bits(state):
    return [part.tobytes() if isinstance(part, np.ndarray) else part for part in state[3:]]


KINDS = {
    "ticks": lambda t, speeds, turned, pose: WheelTicks(t, turned),
    "speeds": lambda t, speeds, turned, pose: WheelSpeeds(t, speeds),
    "poses": lambda t, speeds, turned, pose: Odometry(t, pose=pose),
    "twists": lambda t, speeds, turned, pose: Odometry(t, twist=THING.base.forward_matrix @ speeds),
}


def rough_drive(kind, seed, count=300, rate=100.0):
    """A drive with everything that goes wrong: slip, jitter, bursts, pauses, equal stamps, NaN, jumps."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.2, 1.8, count) / rate
    dt[rng.random(count) < 0.05] *= 40.0
    dt[rng.random(count) < 0.1] = 1e-4
    dt[rng.random(count) < 0.05] = 0.0
    dt[rng.integers(count)] = 3.0
    twists = np.cumsum(rng.normal(0.0, 0.02, (count, 3)), axis=0)
    speeds = twists @ THING.base.inverse_matrix.T + rng.normal(0.0, 0.3, (count, 4))
    speeds[rng.random(count) < 0.02] += 1e6
    turned = np.cumsum(speeds * np.minimum(dt, 0.05)[:, None], axis=0)
    poses = np.cumsum(twists * np.minimum(dt, 0.05)[:, None], axis=0)
    for values in (speeds, turned, poses):
        values[rng.random(count) < 0.03] = np.nan
    stamps = 1e9 + np.cumsum(dt)
    return [KINDS[kind](*row) for row in zip(stamps.tolist(), speeds, turned, poses, strict=True)]


@pytest.mark.parametrize("covariance", ["growing", "constant"])
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=5)
@given(seed=st.integers(0, 2**16), lengths=st.lists(st.integers(0, 40), min_size=1, max_size=6).filter(any))
def test_steps_do_not_depend_on_how_records_are_divided_into_blocks(kind, covariance, seed, lengths):
    wheels, config = rough_drive(kind, seed), WheelConfig(covariance=covariance)
    whole = wheel_odometry(wheels, THING, config)
    assert whole.measurements
    assert whole.refused > 0
    for portions in ([1], lengths, [len(wheels)]):
        state, steps = blocks(wheels, THING, config, portions)
        assert bits(steps) == bits(whole.measurements)
        assert (state.breaks, state.refused, state.late) == (whole.breaks, whole.refused, 0)
        assert state_bits(state) == state_bits(blocks(wheels, THING, config, [len(wheels)])[0])


@pytest.mark.parametrize("cut", [1, 2, 100, 299])
def test_steps_do_not_depend_on_records_to_come(cut):
    wheels = rough_drive("ticks", 7)
    known = wheel_odometry(wheels[:cut], THING).measurements
    assert bits(known) == bits(wheel_odometry(wheels, THING).measurements[: len(known)])


def test_a_slip_window_of_many_records_is_remembered_and_no_more_than_that():
    wheels = rough_drive("ticks", 3, count=2000, rate=1000.0)
    config = WheelConfig(slip_window=0.5)
    state, steps = blocks(wheels, THING, config, [1])
    assert bits(steps) == bits(wheel_odometry(wheels, THING, config).measurements)
    assert state.stamps[0] >= state.stamps[-1] - 0.5 - 1e-6
    assert len(state.stamps) > 100


def test_a_step_leaves_the_state_that_it_started_from_as_it_was():
    wheels = records(THING, FULL_CIRCLE)
    state, _ = wheel.step(wheel.init(THING), wheels[:100])
    before = state_bits(state)
    once, again = wheel.step(state, wheels[100:]), wheel.step(state, wheels[100:])
    assert state_bits(state) == before
    assert bits(once[1]) == bits(again[1])
    for array in (once[0].stamps, once[0].disagreement, once[0].values, once[0].displacement):
        assert not array.flags.writeable


def test_records_older_than_the_newest_are_passed_over_and_counted():
    wheels = records(THING, np.array([0.2, 0.0, 0.1]))
    state, steps = blocks([*wheels[:50], wheels[20], *wheels[48:]], THING, None, [1])
    assert (state.late, state.breaks) == (2, 0)
    assert bits(steps) == bits(wheel_odometry(wheels, THING).measurements)


def test_a_record_that_is_not_finite_does_not_make_later_ones_late():
    wheels = records(THING, np.array([0.2, 0.0, 0.1]), duration=1.0)
    state, steps = blocks([*wheels[:20], WheelTicks(1e9, np.full(4, np.nan)), *wheels[20:]], THING, None, [1])
    assert (state.refused, state.late) == (1, 0)
    assert bits(steps) == bits(wheel_odometry(wheels, THING).measurements)


@pytest.mark.parametrize(
    ("later", "message"),
    [
        (WheelSpeeds(9.0, np.zeros(4)), "of several kinds"),
        (WheelTicks(9.0, np.zeros(3)), "changing length"),
    ],
)
def test_a_later_record_of_another_kind_is_refused_and_the_state_goes_on(later, message):
    wheels = records(THING, FULL_CIRCLE, duration=2.0)
    state, first = wheel.step(wheel.init(THING), wheels[:50])
    with pytest.raises(EstimationError, match=message):
        wheel.step(state, [later])
    _, rest = wheel.step(state, wheels[50:])
    assert bits([*first, *rest]) == bits(wheel_odometry(wheels, THING).measurements)


def test_what_is_read_of_a_drivers_odometry_is_fixed_by_its_first_record():
    pose, twist = np.zeros(3), np.array([0.1, 0.0, 0.0])
    by_twist = [Odometry(0.0, twist=twist), Odometry(0.1, pose=pose, twist=twist)]
    np.testing.assert_allclose(wheel_odometry(by_twist, DRIVER).measurements[0].pose, [0.01, 0.0, 0.0])
    by_pose = [Odometry(0.0, pose=pose, twist=twist), Odometry(0.1, pose=pose, twist=twist)]
    np.testing.assert_array_equal(wheel_odometry(by_pose, DRIVER).measurements[0].pose, 0.0)
    with pytest.raises(EstimationError, match="Neither a pose nor a twist"):
        wheel_odometry([by_pose[0], Odometry(0.1, twist=twist)], DRIVER)


def test_no_records_change_nothing():
    state = wheel.init(THING)
    assert wheel.step(state, []) == (state, ())


def test_records_that_are_not_finite_before_the_first_good_one_leave_the_start_open():
    wheels = [WheelTicks(-0.1, np.full(4, np.nan)), *records(THING, np.array([0.2, 0.0, 0.1]), duration=1.0)]
    state, steps = blocks(wheels, THING, None, [1])
    assert bits(steps) == bits(wheel_odometry(wheels[1:], THING).measurements)
    assert state.refused == 1


@pytest.mark.parametrize("signal", ["speed", "angle"])
def test_a_car_drives_the_circle_that_it_is_steered_on(signal):
    base = AckermannBase(wheel_radius=0.1, wheelbase=0.5, track_width=0.4, rear_wheels=("l", "r"), steering="s")
    car = RobotDescription(name="car", base=base, encoder={"signal": signal})
    v, steering = 0.6, 0.3
    omega = v * np.tan(steering) / 0.5
    wheels = np.array([v - 0.2 * omega, v + 0.2 * omega]) / 0.1
    stamps = (0.02 * np.arange(101)).tolist()
    if signal == "speed":
        taken = [WheelSpeeds(t, np.array([*wheels, steering])) for t in stamps]
    else:
        taken = [WheelTicks(t, np.array([*wheels * t, steering])) for t in stamps]
    np.testing.assert_allclose(path(taken, car).poses[-1], se2.exp(2.0 * np.array([v, 0.0, omega])), atol=1e-12)
