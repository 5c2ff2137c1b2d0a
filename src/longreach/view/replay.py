"""A recorded run, read for a page: a folder of `longreach run` or `estimate`, or a recording with or without one."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.app.estimate import Estimate, estimate, sensor_mount
from longreach.errors import LongreachError, RecordingError
from longreach.evaluation.alignment import align_pairs, associate, moved
from longreach.evaluation.scan_map import scan_points
from longreach.io.bag_file import open_bag
from longreach.io.bag_topics import PLAN
from longreach.io.config import read_config
from longreach.io.formats import recording_format
from longreach.io.recording import read_recording
from longreach.io.robots import load_robot
from longreach.io.tum import read_spatial_tum, read_tum
from longreach.measurement import LaserScan, Recording
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.trajectory import PoseTrajectory
from longreach.view import curves
from longreach.view.frame import Frame, Run

_RATE = 25.0  # frames a second
_MOST_MOMENTS = 6000
_MAP_CELL = 0.04  # [m]
_MOST_SCANS = 2000  # laid into the map
_REPORTED = 240  # frames and scans in the report of an estimate
_BEAMS = 361  # of a sweep that is shown
_APART = 0.2  # between truth and estimate at the start [m or rad]: beyond, they are in different frames


def read_run(path: Path, robot: str | Path | None = None, estimated: Path | None = None) -> Run:
    """Read what a page shows of a folder or a recording.

    Arguments: robot: None takes the folder's own, else the Thing. estimated: the folder that `longreach estimate` has
    written about a recording; None looks beside the recording, and estimates it if nothing is there.

    Raises:
        RecordingError: there is nothing to show at the path.
    """
    folder, file = _where(path, estimated)
    machine = load_robot(robot) if robot is not None else _robot_of(folder)
    recording = read_recording(file, machine)
    trajectories = _trajectories(folder) if folder is not None else dict(estimate(recording, machine).trajectories)
    tool_truth = _tool(folder, "tool_truth")
    if tool_truth is None:
        _carry_truth(trajectories)
    plans = _plans(file, machine, _tool(folder, "tool_reference"))
    return assemble(path.name, machine, recording, trajectories, tool_truth, plans)


def _where(path: Path, estimated: Path | None) -> tuple[Path | None, Path]:
    """Return the folder with an estimate, if there is one, and the recording."""
    if not path.exists():
        raise RecordingError(f"There is nothing at {path}; check the path.")
    if path.is_dir() and (path / "fused.tum").is_file():
        if not (path / "recording.mcap").is_file():
            raise RecordingError(f"{path} has no recording.mcap; name the recording and give the folder by --estimate.")
        return path, path / "recording.mcap"
    recording_format(path)
    if estimated is not None and not (estimated / "fused.tum").is_file():
        raise RecordingError(f"{estimated} has no fused.tum; it is to be a folder that longreach estimate has written.")
    beside = path.parent if path.name == "recording.mcap" and (path.parent / "fused.tum").is_file() else None
    return estimated or beside, path


def of_estimate(estimated: Estimate) -> Run:
    """Return what a page shows of an estimate that was just made."""
    trajectories = dict(estimated.evaluation.trajectories)
    _carry_truth(trajectories)
    machine = _machine(estimated.robot, Path())
    return assemble(estimated.recording.name, machine, estimated.recording, trajectories, most=_REPORTED)


def _machine(description: RobotDescription, folder: Path) -> MobileManipulator:
    try:
        return load_robot(description.name)
    except LongreachError:  # it was a file's of its user
        return MobileManipulator.from_description(description, folder)


def _robot_of(folder: Path | None) -> MobileManipulator:
    """Return the robot that the folder's own settings name."""
    if folder is not None and (folder / "robot.yaml").is_file():
        return _machine(read_config(folder / "robot.yaml", RobotDescription), folder)
    settings = folder / "config.yaml" if folder is not None else None
    if settings is not None and settings.is_file():
        for line in settings.read_text(encoding="utf-8").splitlines():
            if line.startswith("robot:"):
                return load_robot(line.partition(":")[2].strip())
    return load_robot("thing")


def _trajectories(folder: Path) -> dict[str, PoseTrajectory]:
    found = {name: read_tum(folder / f"{name}.tum") for name in ("fused", "wheels", "truth") if _has(folder, name)}
    if (folder / "covariance.npz").is_file():
        with np.load(folder / "covariance.npz") as known:
            if "fused_covariance" in known and len(known["fused_covariance"]) == len(found["fused"]):
                f = found["fused"]
                found["fused"] = PoseTrajectory(f.stamps, f.poses, known["fused_covariance"], f.clock, f.has_heading)
    return found


def _has(folder: Path, name: str) -> bool:
    return (folder / f"{name}.tum").is_file()


def _tool(folder: Path | None, name: str) -> tuple[np.ndarray, np.ndarray] | None:
    return read_spatial_tum(folder / f"{name}.tum") if folder is not None and _has(folder, name) else None


def _carry_truth(trajectories: dict[str, PoseTrajectory]) -> None:
    """Carry the truth into the estimate's frame, where it is in one of its own."""
    truth, fused = trajectories.get("truth"), trajectories["fused"]
    if truth is None:
        return
    pairs = associate(fused, truth)
    _, motion = align_pairs(pairs, "first" if pairs.has_heading else "rigid")
    if np.max(np.abs(motion)) > 1e-9:
        from longreach.geometry import se2

        trajectories["truth"] = moved(truth, se2.inverse(motion))


def _plans(
    file: Path, robot: MobileManipulator, tool: tuple[np.ndarray, np.ndarray] | None
) -> dict[str, Float[np.ndarray, "j 3"]]:
    """Return the planned paths of base and tool, as far as the recording or its folder have them."""
    plans: dict[str, np.ndarray] = {}
    if file.suffix == ".mcap" or file.is_dir() or file.suffix == ".bag":
        with open_bag(file) as bag:
            topics = {(t.name, t.type) for t in bag.topics if t.name == PLAN}
            for *_, message in bag.messages(topics) if topics else ():
                q = np.array([point.positions for point in message.points])
                if q.ndim == 2 and q.shape[1] == robot.dof:
                    if robot.base.stop:
                        plans["base planned"] = np.column_stack([q[:, :2], np.zeros(len(q))])
                    plans["tool planned"] = robot.forward(q)[:, :3, 3]
    if tool is not None:
        plans["tool planned"] = tool[1][:, :3, 3]
    return {name: _thin(points, 400) for name, points in plans.items()}


def _thin(points: np.ndarray, most: int) -> np.ndarray:
    return points[np.unique(np.linspace(0, len(points) - 1, min(most, len(points))).astype(int))]


def assemble(
    name: str,
    robot: MobileManipulator,
    recording: Recording,
    trajectories: Mapping[str, PoseTrajectory],
    tool_truth: tuple[Float[np.ndarray, " t"], Float[np.ndarray, "t 4 4"]] | None = None,
    plans: Mapping[str, Float[np.ndarray, "j 3"]] | None = None,
    most: int = _MOST_MOMENTS,
) -> Run:
    """Put recording and trajectories on an even grid of times, of `most` frames."""
    fused = trajectories["fused"]
    start, stop = float(fused.clock[0]), float(fused.clock[-1])
    count = int(np.clip(round((stop - start) * _RATE) + 1, 2, most))
    clock = np.linspace(start, stop, count)
    times = clock - start
    poses = {what: trajectory.at(clock)[0] for what, trajectory in trajectories.items() if len(trajectory)}
    q = np.tile(robot.home, (count, 1))
    if robot.base.stop:
        q[:, :3] = poses["fused"]
        q[:, 2] = np.unwrap(q[:, 2])
    velocities = _take_joints(robot, recording, clock, q)
    covariance = None
    if fused.covariance is not None:
        rows = np.clip(np.searchsorted(fused.clock, clock, side="right") - 1, 0, len(fused) - 1)
        covariance = fused.covariance[rows]
    tools = None
    if tool_truth is not None:
        tools = tool_truth[1][np.clip(np.searchsorted(tool_truth[0], clock), 0, len(tool_truth[0]) - 1)]
    sweeps, others = _Sweeps(recording, robot.description, fused), _other_joints(robot, recording, clock)
    frames = tuple(
        Frame(
            q[i],
            None if covariance is None else covariance[i],
            poses["wheels"][i] if "wheels" in poses else None,
            poses["truth"][i] if "truth" in poses else None,
            None if tools is None else tools[i],
            *sweeps.at(float(clock[i])),
            {name: float(angle[i]) for name, angle in others.items()},
        )
        for i in range(count)
    )
    map_points, map_times = _map(fused, recording, sensor_mount(recording, robot.description, "lidar"), start, most)
    paths = {}
    if robot.base.stop:
        paths["base driven"] = (times, np.column_stack([q[:, :2], np.zeros(count)]))
    if robot.dof > 3:
        paths["tool driven"] = (times, robot.forward(q)[:, :3, 3])
    plots = curves.plots(robot, times, q, velocities, covariance, poses, tools)
    return Run(name, robot, times, frames, map_points, map_times, paths, plans or {}, plots)


def _take_joints(
    robot: MobileManipulator, recording: Recording, clock: np.ndarray, q: np.ndarray
) -> Float[np.ndarray, "n m"] | None:
    """Write the arm's recorded angles into q and return their velocities, or None where none were recorded."""
    names = robot.joint_names[robot.arm]
    rows = [j for j in recording.joints if set(names) <= set(j.names) and len(j.position)]
    if not names or len(rows) < 2:
        return None
    at = [rows[0].names.index(name) for name in names]
    stamps = np.array([row.stamp for row in rows])
    velocities = np.zeros((len(clock), len(names)))
    for k, column in enumerate(at):
        angle = np.array([row.position[column] for row in rows])
        q[:, robot.arm.start + k] = np.interp(clock, stamps, angle)
        known = all(len(row.velocity) for row in rows)
        speed = np.array([row.velocity[column] for row in rows]) if known else np.gradient(angle, stamps)
        velocities[:, k] = np.interp(clock, stamps, speed)
    return velocities


def _other_joints(robot: MobileManipulator, recording: Recording, clock: np.ndarray) -> dict[str, np.ndarray]:
    """Return the recorded angles (n,) of joints that are not of the chain to the tool, fingers for one, by name."""
    if not recording.joints:
        return {}
    names = recording.joints[0].names
    rows = [row for row in recording.joints if row.names == names and len(row.position)]
    stamps = np.array([row.stamp for row in rows])
    return {
        name: np.interp(clock, stamps, [row.position[i] for row in rows])
        for i, name in enumerate(names)
        if name not in robot.joint_names and rows
    }


class _Sweeps:
    """The newest sweep at a time, thinned, in the base's frame, and where that was; each is made once."""

    def __init__(self, recording: Recording, robot: RobotDescription, fused: PoseTrajectory) -> None:
        self._scans, self._mount = recording.scans, sensor_mount(recording, robot, "lidar")
        self._stamps = np.array([scan.stamp for scan in recording.scans])
        self._poses, self._known = fused.at(self._stamps)
        self._made: dict[int, np.ndarray] = {}

    def at(self, clock: float) -> tuple[Float[np.ndarray, "k 2"] | None, Float[np.ndarray, "3"] | None]:
        if not len(self._stamps):
            return None, None
        i = max(int(np.searchsorted(self._stamps, clock, side="right")) - 1, 0)
        if i not in self._made:
            self._made[i] = sweep_points(self._scans[i], self._mount)
        return self._made[i], self._poses[i] if self._known[i] else None


def sweep_points(scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "k 2"]:
    """Return a sweep's returns in the base's frame [m], some of its beams."""
    step = max(1, len(scan.ranges) // _BEAMS)
    r, angle = scan.returns[::step], scan.angles[::step]
    hit = r > 0
    rays = np.column_stack([r[hit] * np.cos(angle[hit]), r[hit] * np.sin(angle[hit])])
    return rays @ T_base_laser[:2, :2].T + T_base_laser[:2, 3]


def _map(
    fused: PoseTrajectory, recording: Recording, mount: np.ndarray, start: float, most: int
) -> tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Return a point for each cell of the floor that returns fell into, and when the first did [s]."""
    scans = recording.scans[:: max(1, len(recording.scans) // min(most, _MOST_SCANS))]
    cells: dict[tuple[int, int], float] = {}
    for scan in scans:
        new = np.unique(np.round(scan_points(fused, [scan], mount) / _MAP_CELL).astype(int), axis=0)
        for cell in map(tuple, new.tolist()):
            cells.setdefault(cell, scan.stamp - start)
    points = _MAP_CELL * np.array(list(cells), dtype=float).reshape(-1, 2)
    return points, np.array(list(cells.values()))
