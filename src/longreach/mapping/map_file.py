"""A map and its file: keyframes with their scans, the pose graph between them, and the sessions they come from.

`map.lrmap` is a zip. `map.json` has the version, the sha256 of the other members, and the sessions; `keyframes.npz` and
`graph.npz` have arrays. A member's CRC guards `map.json` itself. Old versions stay readable: `_READERS`.
"""

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import LongreachError, MappingError
from longreach.io.whole_files import whole_file
from longreach.mapping.pose_graph import Edges, PoseGraph, frozen
from longreach.measurement import LaserScan

VERSION = 1
_FORMAT = "longreach map"


@dataclass(frozen=True, eq=False)
class Session:
    """One recording in a map.

    name: of the recording. robot: the name of its description. mounts: frame of a laser → T_base_laser (4, 4) as it was
    used, calibrated or not. description: all of the robot's description, as JSON has it.
    """

    name: str
    robot: str
    mounts: Mapping[str, Float[np.ndarray, "4 4"]]
    description: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Map:
    """Keyframes, what their lasers saw, and what holds them together.

    graph: poses T_map_base (n, 3) and edges. weights (mc,): of the closures, 0 where one is withdrawn. scans (n): one a
    keyframe, with its stamp. twists (n, 3): of the base during each sweep, by which its beams are set right [m/s, m/s,
    rad/s]. session (n,): which of `sessions` each keyframe is from. T_truth_map (3,): the rigid motion that carried the
    mapping run to its truth, for evaluation alone; None: it had none.

    Raises:
        MappingError: there is no keyframe, lengths disagree, a keyframe's session or a scan's mount is not there.
    """

    graph: PoseGraph
    weights: Float[np.ndarray, " mc"]
    scans: tuple[LaserScan, ...]
    twists: Float[np.ndarray, "n 3"]
    session: Int[np.ndarray, " n"]
    sessions: tuple[Session, ...]
    T_truth_map: Float[np.ndarray, "3"] | None = None

    def __post_init__(self) -> None:
        n = len(self.graph.poses)
        if n == 0:
            raise MappingError("A map needs at least one keyframe.")
        if len(self.scans) != n:
            raise MappingError(f"A map of {n} keyframes has {len(self.scans)} scans; it needs one for each.")
        arrays = (("weights", (len(self.graph.closures),), float), ("twists", (n, 3), float), ("session", (n,), int))
        for name, shape, kind in arrays:
            object.__setattr__(self, name, frozen(getattr(self, name), shape, kind, f"map's {name}"))
        if self.T_truth_map is not None:
            object.__setattr__(self, "T_truth_map", frozen(self.T_truth_map, (3,), float, "map's T_truth_map"))
        for k, (s, scan) in enumerate(zip(self.session.tolist(), self.scans, strict=True)):
            if not 0 <= s < len(self.sessions):
                raise MappingError(f"Keyframe {k} of a map is of session {s}, and there are {len(self.sessions)}.")
            if scan.frame not in self.sessions[s].mounts:
                raise MappingError(f"Session {self.sessions[s].name} does not say where its laser {scan.frame} sits.")

    @property
    def stamps(self) -> Float[np.ndarray, " n"]:
        """Of the keyframes [s]."""
        return np.array([scan.stamp for scan in self.scans])


def save_map(path: str | Path, value: Map) -> None:
    """Write a map, whole or not at all; the same map gives the same bytes.

    Raises:
        LongreachError: nothing can be written there.
    """
    path = Path(path)
    members = {"keyframes.npz": _packed(_keyframe_arrays(value)), "graph.npz": _packed(_graph_arrays(value))}
    head = {
        "format": _FORMAT,
        "version": VERSION,
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in members.items()},
        "sessions": [
            {
                "name": s.name,
                "robot": s.robot,
                "mounts": {frame: np.asarray(T).tolist() for frame, T in s.mounts.items()},
                "description": dict(s.description),
            }
            for s in value.sessions
        ],
        "T_truth_map": None if value.T_truth_map is None else value.T_truth_map.tolist(),
    }
    members = {"map.json": json.dumps(head, indent=1, allow_nan=False).encode(), **members}
    with whole_file(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, data in members.items():
            # A ZipInfo's date is 1980, so that equal maps are equal files. Compressed, the end of an npz, a zip itself,
            # is not taken for the end of a file that is cut short.
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)


def load_map(path: str | Path) -> Map:
    """Read a map of this version or an older one.

    Raises:
        MappingError: the file is not there, is no map, is cut short or damaged, or of a later version.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except FileNotFoundError as error:
        raise MappingError(f"{path} is not there.") from error
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise MappingError(_what_is_wrong(path, error)) from error
    except OSError as error:
        raise MappingError(f"{path} cannot be read: {error.strerror or error}.") from error
    try:
        head = json.loads(members["map.json"])
        version = head["version"] if head["format"] == _FORMAT else None
    except (KeyError, ValueError, TypeError) as error:
        raise MappingError(f"{path} is no map of longreach (map.lrmap).") from error
    if version not in _READERS:
        raise MappingError(
            f"{path} is a map of version {version}, and this longreach reads {', '.join(map(str, _READERS))}; "
            "use a longreach as new as the one that wrote it."
        )
    try:
        for name, digest in head["sha256"].items():
            if hashlib.sha256(members[name]).hexdigest() != digest:
                raise MappingError(f"{name} has another checksum than when it was written")
        return _READERS[version](head, members)
    except (KeyError, ValueError, TypeError, AttributeError, IndexError, LongreachError) as error:
        what = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise MappingError(f"{path} is damaged: {what}; take a copy, or build the map again.") from error


def _what_is_wrong(path: Path, error: Exception) -> str:
    with path.open("rb") as file:
        is_zip = file.read(2) == b"PK"
    if not is_zip:
        return f"{path} is no map of longreach (map.lrmap)."
    if "not a zip file" in str(error).lower() or isinstance(error, EOFError):
        return f"{path} is cut short: its end is missing; take a copy, or build the map again."
    return f"{path} is damaged: {str(error).rstrip('.')}; take a copy, or build the map again."


def _keyframe_arrays(value: Map) -> dict[str, np.ndarray]:
    scans = value.scans
    ranges = np.concatenate([scan.ranges for scan in scans])
    single = ranges.astype(np.float32)
    geometry = [(s.angle_min, s.angle_increment, s.range_min, s.range_max, s.time_increment) for s in scans]
    return {
        "stamps": value.stamps,
        "session": value.session,
        "twists": value.twists,
        "beams": np.array([len(scan.ranges) for scan in scans]),
        "ranges": single if np.array_equal(single, ranges, equal_nan=True) else ranges,
        "geometry": np.array(geometry),
        "frames": np.array([scan.frame for scan in scans]),
    }


def _graph_arrays(value: Map) -> dict[str, np.ndarray]:
    arrays = {"poses": value.graph.poses, "weights": value.weights}
    for kind, edges in (("odometry", value.graph.odometry), ("closures", value.graph.closures)):
        arrays |= {f"{kind}_{name}": getattr(edges, name) for name in ("i", "j", "z", "covariance")}
    return arrays


def _read_version_1(head: Mapping[str, Any], members: Mapping[str, bytes]) -> Map:
    """keyframes.npz: stamps (n,), session (n,), twists (n, 3), beams (n,), frames (n,), ranges of all scans after each
    other, geometry (n, 5): angle_min, angle_increment, range_min, range_max, time_increment. graph.npz: poses (n, 3),
    weights (mc,), and i, j, z, covariance of odometry and closures.
    """
    k, g = _unpacked(members["keyframes.npz"]), _unpacked(members["graph.npz"])
    ends = np.cumsum(k["beams"])
    if len(ends) and ends[-1] != len(k["ranges"]):
        raise MappingError("the numbers of beams and of ranges disagree")
    parts = np.split(k["ranges"].astype(float), ends[:-1])
    columns = (k["stamps"].tolist(), parts, k["geometry"].tolist(), k["frames"].tolist())
    scans = tuple(LaserScan(t, ranges, *shape, frame=frame) for t, ranges, shape, frame in zip(*columns, strict=True))
    odometry, closures = (
        Edges(*(g[f"{kind}_{name}"] for name in ("i", "j", "z", "covariance"))) for kind in ("odometry", "closures")
    )
    sessions = tuple(
        Session(s["name"], s["robot"], {frame: np.array(T) for frame, T in s["mounts"].items()}, s["description"])
        for s in head["sessions"]
    )
    graph, truth = PoseGraph(g["poses"], odometry, closures), head.get("T_truth_map")
    T_truth_map = None if truth is None else np.array(truth)
    return Map(graph, g["weights"], scans, k["twists"], k["session"], sessions, T_truth_map)


_READERS = {1: _read_version_1}


def _packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **dict(arrays))  # type: ignore[arg-type]
    return buffer.getvalue()


def _unpacked(data: bytes) -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
