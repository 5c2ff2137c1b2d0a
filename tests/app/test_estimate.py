"""The main path: a recording in, a fused trajectory out, whatever the recording lacks."""

from dataclasses import replace

import numpy as np
import pytest

from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import estimate, sensor_mount
from longreach.app.evaluate import Relations
from longreach.errors import EstimationError
from longreach.estimation.planar.config import FilterConfig
from longreach.geometry import se2
from longreach.measurement import Odometry, PoseMeasurement, Recording, WheelTicks
from longreach.odometry.wheel import WheelConfig
from longreach.robot.description import Lidar, Mount, RobotDescription
from longreach.trajectory import PoseTrajectory, monotone_clock

pytestmark = pytest.mark.usefixtures("unchecked")  # but the fixture `estimated` is checked

IN_ONE_WORLD = EstimateConfig(evaluation=EvaluationConfig(align="none"))
WHEELS_ALONE = IN_ONE_WORLD.model_copy(update={"sources": ("wheels",)})
NAN = float("nan")


def value(result, name, metric):
    return result.metrics[name][metric]["value"]


def changed(records, i, **changes):
    return (*records[:i], replace(records[i], **changes), *records[i + 1 :])


def same(a, b):
    """Whether two estimates are the same to the last bit."""
    return set(a.trajectories) - {"truth"} == set(b.trajectories) - {"truth"} and all(
        np.array_equal(path.poses, b.trajectories[name].poses)
        and np.array_equal(path.covariance, b.trajectories[name].covariance)
        for name, path in a.trajectories.items()
        if name != "truth"
    )


def fixes_of(made, deviation, rng, period=1.0, heading=False):
    stamps = np.arange(0.0, made.truth.stamps[-1], period)
    poses, _ = made.truth.at(stamps)
    poses = poses + deviation * rng.normal(size=poses.shape) * np.array([1.0, 1.0, float(heading)])
    R = np.diag([deviation**2, deviation**2, deviation**2 if heading else np.inf])
    return tuple(PoseMeasurement(t, p, R, "fixes") for t, p in zip(stamps.tolist(), poses, strict=True))


def test_the_fused_path_is_much_better_than_the_wheels(estimated):
    assert value(estimated, "fused", "ate_rmse") < 0.3 * value(estimated, "wheels", "ate_rmse")
    assert value(estimated, "fused", "heading_rms") < 0.1 * value(estimated, "wheels", "heading_rms")


def test_there_is_a_row_at_every_wheel_and_scan_stamp(made, estimated):
    wheels, scans = [w.stamp for w in made.wheels], [s.stamp for s in made.scans]
    assert estimated.trajectories["fused"].stamps.tolist() == sorted({*wheels, *scans})
    assert estimated.trajectories["wheels"].stamps.tolist() == wheels
    assert estimated.trajectories["lidar"].stamps.tolist() == scans


def test_every_trajectory_says_how_sure_it_is(estimated):
    for name in ("fused", "wheels", "lidar"):
        P = estimated.trajectories[name].covariance
        np.testing.assert_allclose(P, P.transpose(0, 2, 1), atol=1e-15)
        assert np.linalg.eigvalsh(P).min() > -1e-12
        assert np.trace(P[-1]) > np.trace(P[1])


def test_the_metrics_tell_how_consistent_filter_and_matches_are(estimated):
    fused, lidar = estimated.metrics["fused"], estimated.metrics["lidar"]
    for source in ("wheels", "lidar", "imu"):
        assert {f"nis_{source}_{what}" for what in ("mean", "lower", "upper", "inside", "rows")} <= set(fused)
    assert {"nees_mean", "nees_lower", "nees_upper"} <= set(fused)
    assert "match_nees_mean" in lidar
    assert 0.0 < fused["nis_imu_mean"]["value"] < fused["nis_imu_upper"]["value"]
    assert fused["nis_wheels_rows"]["value"] == 250


def test_a_counter_carries_its_anchor_along_and_a_keyframe_has_one_of_its_own(made, estimated, thing):
    placed = [c.source for c in estimated.corrections if c.dof == 0]
    assert placed.count("wheels") == 1
    assert placed.count("lidar") == 1  # the first keyframe; each later one comes with the match that leads to it
    keyframes = {m.stamp_reference for m in estimated.lidar_measurements}
    assert 1 < len(keyframes) < len(estimated.lidar_measurements) == len(made.scans) - 1
    jumped = tuple(replace(w, ticks=w.ticks + (1e4 if w.stamp > 5.0 else 0.0)) for w in made.wheels)
    again = estimate(made.replace(wheels=jumped, scans=(), imu=()), thing, WHEELS_ALONE)
    assert [c.status for c in again.corrections if c.dof == 0] == ["used", "used"]  # one more, where it goes on
    constant = WHEELS_ALONE.model_copy(update={"wheels": WheelConfig(covariance="constant")})
    steps = estimate(made.replace(scans=(), imu=()), thing, constant)
    assert sum(c.dof == 0 for c in steps.corrections) == len(made.wheels)


def test_looking_back_is_closer_and_surer_and_ends_near_the_filter(made, thing):
    result = estimate(made, thing, IN_ONE_WORLD.model_copy(update={"smooth": True}))
    fused, smoothed = result.trajectories["fused"], result.trajectories["smoothed"]
    np.testing.assert_array_equal(smoothed.stamps, fused.stamps)
    np.testing.assert_allclose(smoothed.poses[-1], fused.poses[-1], atol=1e-3)
    assert value(result, "smoothed", "ate_rmse") < 1.1 * value(result, "fused", "ate_rmse")
    assert np.trace(smoothed.covariance[len(fused) // 2]) <= np.trace(fused.covariance[len(fused) // 2])


def test_the_same_recording_gives_the_same_estimate(made, thing, estimated):
    assert same(estimate(made, thing, IN_ONE_WORLD), estimated)


def test_the_truth_does_not_leak_into_the_estimate(made, thing, estimated, rng):
    blind = estimate(made.replace(truth=None), thing, IN_ONE_WORLD.model_copy(update={"compare": True}))
    assert same(blind, estimated)
    assert "truth" not in blind.trajectories
    assert "ate_rmse" not in blind.metrics["fused"]
    other = PoseTrajectory(made.truth.stamps, made.truth.poses + np.array([1.0, 2.0, 0.5]))
    told = estimate(made, thing, IN_ONE_WORLD, truth=other)
    assert same(told, estimated)
    assert value(told, "fused", "ate_rmse") > 1.0


def test_one_source_alone_is_the_filter_on_that_source(made, thing):
    alone = estimate(made, thing, WHEELS_ALONE)
    assert {c.source for c in alone.corrections} == {"wheels"}
    assert same(estimate(made.replace(imu=()), thing, WHEELS_ALONE), alone)
    assert value(alone, "fused", "ate_rmse") < 1.1 * value(alone, "wheels", "ate_rmse")
    assert {"wheels", "lidar"} <= set(alone.trajectories)  # dead reckoning is there to compare, fused or not


def test_without_a_reference_the_lidar_has_a_path_only_where_it_is_asked_for(short, thing):
    bare = short.replace(truth=None)
    assert set(estimate(bare, thing).trajectories) == {"fused", "wheels"}
    asked = estimate(bare, thing, EstimateConfig(compare=True))
    assert np.hypot(*np.diff(asked.trajectories["lidar"].poses[:, :2], axis=0).T).sum() > 0.2


def test_sources_that_are_not_there_are_named(made, thing):
    config = EstimateConfig(sources=("lidar", "fixes"))
    with pytest.raises(EstimationError, match="The recording has no fixes to fuse; it has wheels, lidar, imu"):
        estimate(made, thing, config)
    with pytest.raises(EstimationError, match="no lidar and no fixes to fuse; it has nothing that can be fused"):
        estimate(Recording("empty"), thing, config)


@pytest.mark.parametrize("heading", [True, False])
def test_fixes_bound_the_error_of_wheels_that_drift(made, thing, rng, heading):
    config = IN_ONE_WORLD.model_copy(update={"sources": ("wheels", "fixes")})
    recording = made.replace(fixes=fixes_of(made, 0.02, rng, heading=heading))
    drifting, held = estimate(made, thing, WHEELS_ALONE), estimate(recording, thing, config)
    assert value(held, "localized", "ate_rmse") < 0.08 < value(drifting, "fused", "ate_rmse")
    assert value(held, "localized", "nees_mean") < 6.0
    assert "nis_fixes_mean" in held.metrics["localized"]


def test_fixes_do_not_move_the_smooth_path_and_without_them_nothing_is_localized(made, thing, estimated, rng):
    result = estimate(made.replace(fixes=fixes_of(made, 0.02, rng)), thing, IN_ONE_WORLD)
    np.testing.assert_array_equal(result.trajectories["fused"].poses, estimated.trajectories["fused"].poses)
    stamps, known = estimated.trajectories["fused"].stamps, result.trajectories["localized"].stamps
    assert 1.0 <= known[0] <= 3.0  # the heading on the map shows after a way
    np.testing.assert_array_equal(known, stamps[stamps >= known[0]])
    assert "localized" not in estimated.trajectories
    assert "nis_fixes_mean" not in result.metrics["fused"]


def test_fixes_put_the_estimate_into_their_frame(made, thing, rng):
    motion = np.array([5.0, -3.0, 2.0])
    moved = made.replace(truth=PoseTrajectory(made.truth.stamps, se2.compose(motion, made.truth.poses)))
    moved = moved.replace(fixes=fixes_of(moved, 0.02, rng, period=0.5))
    result = estimate(moved, thing, IN_ONE_WORLD)
    assert value(result, "localized", "ate_rmse") < 0.08
    assert value(result, "localized", "heading_rms") < 3.0
    np.testing.assert_allclose(result.trajectories["fused"].poses[0], 0.0, atol=0.01)
    assert not any("fixes" in remark and "gated" in remark for remark in result.remarks)


def test_relations_are_held_against_every_path(made, thing):
    first, second = np.array([0.0, 1.0, 2.0]), np.array([3.0, 5.0, 11.0])
    poses = se2.between(made.truth.at(first)[0], made.truth.at(second)[0])
    result = estimate(made, thing, IN_ONE_WORLD, relations=Relations(first, second, poses))
    for name in ("fused", "wheels", "lidar"):
        assert value(result, name, "relations_5s_used") == 2
    assert value(result, "fused", "relations_5s_translation_mean") < 0.05


@pytest.mark.parametrize(
    ("changes", "fused"),
    [
        ({"scans": 0}, {"wheels", "imu"}),
        ({"scans": 1}, {"wheels", "imu"}),
        ({"wheels": 0}, {"lidar", "imu"}),
        ({"wheels": 1}, {"lidar", "imu"}),
        ({"imu": 0}, {"wheels", "lidar"}),
        ({"imu": 1}, {"wheels", "lidar", "imu"}),
        ({"wheels": 0, "imu": 0}, {"lidar"}),
        ({"wheels": 0, "scans": 0}, {"imu"}),
    ],
)
def test_what_a_recording_lacks_is_done_without(short, thing, changes, fused):
    recording = short.replace(**{kind: getattr(short, kind)[:count] for kind, count in changes.items()})
    result = estimate(recording, thing, IN_ONE_WORLD)
    assert {c.source for c in result.corrections} == fused
    assert set(result.trajectories) == {"fused", "truth", *(fused & {"wheels", "lidar"})}
    assert np.isfinite(result.trajectories["fused"].poses).all()


@pytest.mark.parametrize("scans", [0, 1])
def test_a_recording_without_any_motion_is_refused(short, thing, scans):
    recording = Recording("still", scans=short.scans[:scans])
    with pytest.raises(EstimationError, match=f"nothing to fuse: 0 wheel records, {scans} scans, .*two good"):
        estimate(recording, thing)


@pytest.mark.parametrize(
    "broken",
    [
        lambda r: r.replace(wheels=changed(r.wheels, 40, ticks=np.array([NAN, 0, 0, 0]))),
        lambda r: r.replace(wheels=changed(r.wheels, 40, ticks=np.full(4, np.inf))),
        lambda r: r.replace(imu=changed(r.imu, 40, angular_velocity=np.full(3, NAN))),
        lambda r: r.replace(imu=changed(r.imu, 40, acceleration=np.full(3, np.inf))),
        lambda r: r.replace(scans=changed(r.scans, 10, ranges=np.full(90, NAN))),
        lambda r: r.replace(scans=changed(r.scans, 10, ranges=np.where(np.arange(90) < 30, NAN, r.scans[10].ranges))),
        lambda r: r.replace(scans=changed(r.scans, 10, ranges=np.zeros(90))),
        lambda r: r.replace(scans=changed(r.scans, 10, ranges=-r.scans[10].ranges)),
    ],
    ids=["wheel NaN", "wheel inf", "gyro NaN", "acceleration inf", "scan NaN", "scan partly NaN", "scan 0", "scan < 0"],
)
def test_what_is_not_a_number_never_spreads(short, thing, broken):
    result = estimate(broken(short), thing, IN_ONE_WORLD)
    for path in result.trajectories.values():
        assert np.isfinite(path.poses).all()
    assert np.isfinite(result.trajectories["fused"].covariance).all()
    assert value(result, "fused", "ate_rmse") < 0.03


def test_what_was_refused_is_said(short, thing):
    imu = changed(short.imu, 40, angular_velocity=np.full(3, NAN))
    scans = changed(short.scans, 10, ranges=np.full(90, NAN))
    remarks = estimate(short.replace(imu=imu, scans=scans), thing, IN_ONE_WORLD).remarks
    assert any(r.startswith("imu: of 201 measurements") and "1 refused" in r for r in remarks)
    assert "1 of 20 scans gave no match; the first because only 0 beams see something." in remarks


def test_records_of_one_stamp_are_no_motion(short, thing):
    wheels = changed(short.wheels, 40, stamp=short.wheels[39].stamp)
    scans = changed(short.scans, 10, stamp=short.scans[9].stamp)
    result = estimate(short.replace(wheels=wheels, scans=scans), thing, IN_ONE_WORLD)
    assert len(result.trajectories["lidar"]) == len(short.scans)
    assert np.isfinite(result.trajectories["fused"].poses).all()


def test_records_all_of_one_stamp_are_refused(short, thing):
    wheels = tuple(replace(w, stamp=5.0) for w in short.wheels)
    scans = tuple(replace(s, stamp=5.0) for s in short.scans)
    with pytest.raises(EstimationError, match="nothing to fuse: 101 wheel records, 21 scans"):
        estimate(Recording("still", wheels=wheels, scans=scans), thing)


def test_records_out_of_order_are_refused_with_what_mends_them(short, thing):
    wheels = changed(short.wheels, 40, stamp=short.wheels[30].stamp)
    with pytest.raises(EstimationError, match="stamps of the wheel records run backwards; repair them with monotone"):
        estimate(short.replace(wheels=wheels), thing)
    scans = changed(short.scans, 10, stamp=short.scans[5].stamp)
    with pytest.raises(EstimationError, match="stamps of the scans run backwards; repair them with monotone"):
        estimate(short.replace(scans=scans), thing)


def test_stamps_as_recorded_stand_in_the_output_where_a_clock_was_repaired(short, thing):
    recorded = np.array([s.stamp for s in short.scans])
    recorded[[7, 8, 9]] = recorded[[9, 7, 8]]
    clock = monotone_clock(recorded).tolist()
    recording = short.replace(
        wheels=(),
        imu=(),
        scans=tuple(replace(s, stamp=t) for s, t in zip(short.scans, clock, strict=True)),
        recorded_stamps=dict(zip(clock, recorded.tolist(), strict=True)),
        remarks=("2 stamps run backwards.",),
    )
    result = estimate(recording, thing, IN_ONE_WORLD)
    for name in ("fused", "lidar"):
        np.testing.assert_array_equal(result.trajectories[name].stamps, recorded)
        np.testing.assert_array_equal(result.trajectories[name].clock, clock)
    assert "2 stamps run backwards." in result.remarks


def test_scans_of_changing_beams_are_matched_to_the_same_map(short, thing):
    scans = (*short.scans[:10], *(replace(s, ranges=s.ranges[:60]) for s in short.scans[10:]))
    result = estimate(short.replace(scans=scans), thing, IN_ONE_WORLD)
    assert all(match.measurement is not None for match in result.matches)
    assert value(result, "fused", "ate_rmse") < 0.05


def test_one_scan_of_hardly_any_beams_is_passed_over_and_said(short, thing):
    scans = list(short.scans)
    scans[9] = replace(scans[9], ranges=scans[9].ranges[:1])
    result = estimate(short.replace(scans=tuple(scans)), thing)
    reason = "the scan has 1 beams, where at least 8 are needed"
    assert f"1 of {len(scans) - 1} scans gave no match; the first because {reason}." in result.remarks
    around = [m for m in result.lidar_measurements if m.stamp == scans[10].stamp]
    assert [m.stamp_reference < scans[9].stamp for m in around] == [True]
    assert value(result, "fused", "ate_rmse") < 0.05


def test_scans_of_too_few_beams_are_said(short, thing):
    scans = tuple(replace(s, ranges=s.ranges[:7]) for s in short.scans)
    result = estimate(short.replace(scans=scans), thing)
    reason = "the scan has 7 beams, where at least 8 are needed"
    assert f"21 of 21 scans gave no match; the first because {reason}." in result.remarks


def test_wheels_of_another_robot_are_refused(short, thing):
    wheels = tuple(WheelTicks(w.stamp, w.ticks[:3]) for w in short.wheels)
    with pytest.raises(EstimationError, match="A wheel record has 3 numbers, but thing has 4 wheels"):
        estimate(short.replace(wheels=wheels), thing)


def test_an_imu_that_nobody_describes_is_refused(short):
    with pytest.raises(EstimationError, match="has an IMU, but the description of r does not say what it is"):
        estimate(Recording("imu", imu=short.imu), RobotDescription(name="r"))


def test_a_jump_of_the_counters_is_left_out_and_said(made, thing):
    wheels = tuple(replace(w, ticks=w.ticks + (1e4 if w.stamp > 6.0 else 0.0)) for w in made.wheels)
    result = estimate(made.replace(wheels=wheels), thing, IN_ONE_WORLD)
    assert "The wheels' counts jumped 1 times; nothing was taken across the jumps." in result.remarks
    assert value(result, "fused", "ate_rmse") < 0.1


def test_a_pause_of_minutes_in_the_recording_is_bridged(thing):
    """The robot stands, nothing is recorded for five minutes, and it still stands."""
    stamps = [*np.arange(0.0, 2.0, 0.1), *np.arange(300.0, 302.0, 0.1)]
    recording = Recording("pause", wheels=tuple(Odometry(float(t), pose=np.array([1.0, 2.0, 0.5])) for t in stamps))
    result = estimate(recording, thing, IN_ONE_WORLD)
    assert len(result.trajectories["fused"]) == 40
    np.testing.assert_allclose(result.trajectories["fused"].poses, 0.0, atol=1e-6)
    assert {c.status for c in result.corrections} == {"used"}


def test_too_few_readings_after_a_long_pause_are_said(short, thing):
    later = tuple(replace(w, stamp=w.stamp + 300.0) for w in short.wheels[-4:])
    result = estimate(short.replace(wheels=(*short.wheels[:-4], *later), truth=None), thing, IN_ONE_WORLD)
    assert "4 readings after a long pause were too few to be believed." in result.remarks


@pytest.mark.parametrize(
    "config",
    [
        EstimateConfig(wheels=WheelConfig(covariance="constant")),
        EstimateConfig(filter=FilterConfig(gate_mode="reject", history=0.0)),
        EstimateConfig(filter=FilterConfig(gate_mode="none")),
    ],
    ids=["constant covariance", "reject", "no gate"],
)
def test_settings_reach_their_step(short, thing, config):
    result = estimate(short, thing, config.model_copy(update={"evaluation": EvaluationConfig(align="none")}))
    assert value(result, "fused", "ate_rmse") < 0.05


def test_progress_names_each_stage_and_never_leaves_0_to_1(made, thing):
    told = []
    estimate(made, thing, IN_ONE_WORLD, progress=lambda stage, fraction: told.append((stage, fraction)))
    assert list(dict.fromkeys(stage for stage, _ in told)) == ["fusion", "LIDAR odometry", "evaluation"]
    assert all(0.0 <= fraction <= 1.0 for _, fraction in told)


def test_the_mount_is_the_descriptions_then_the_recordings_then_none(short, thing):
    described = sensor_mount(short, thing, "lidar")
    np.testing.assert_array_equal(described, thing.lidar.mount.matrix())
    bare = RobotDescription(name="r", lidar=Lidar())
    frame = short.scans[0].frame
    in_tf = Mount(x=0.7, yaw=0.2).matrix()
    np.testing.assert_array_equal(sensor_mount(short.replace(mounts={frame: in_tf}), bare, "lidar"), in_tf)
    np.testing.assert_array_equal(sensor_mount(short.replace(mounts={}), bare, "lidar"), np.eye(4))
