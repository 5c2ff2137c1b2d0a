"""Where sensors are mounted, from the transforms in a recording."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.geometry import se3, so3
from longreach.io.messages import rotation_matrix
from longreach.io.records import frame_name

_BASES = ("base_link", "base_footprint")
_STILL = 1e-5  # [m, 1]: what a transform that does not move may differ by; calibrations come as float32 too


class FrameTree:
    """Frames with their parent, as tf has them; a transform that changes is known to move and of no use here."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}
        self._moving: set[str] = set()
        self._placed: set[str] = set()

    def take(self, transforms: Iterable[Any]) -> None:
        """Take the transforms of one tf2_msgs/TFMessage."""
        for transform in transforms:
            child, parent = frame_name(transform.child_frame_id), frame_name(transform.header.frame_id)
            if child in self._moving or child in self._placed:
                continue
            t, q = transform.transform.translation, transform.transform.rotation
            values = np.array([t.x, t.y, t.z, q.x, q.y, q.z, q.w])
            known = self._parents.setdefault(child, (parent, values))
            turned = np.concatenate([values[:3], -values[3:]])  # the same transform
            still = min(np.abs(known[1] - values).max(), np.abs(known[1] - turned).max()) <= _STILL
            if known[0] != parent or not still:  # not still either where there is a NaN
                self._moving.add(child)

    def mounts(
        self, frames: Iterable[str], driven: str = ""
    ) -> tuple[dict[str, Float[np.ndarray, "4 4"]], dict[str, str]]:
        """Return T_base_sensor (4, 4) of the frames that are fixed to the base, and why there is none of the others.

        driven: the frame whose motion the wheels' odometry says, which is the base where no frame has the usual name.
        """
        frames = list(frames)
        base = self.base(frames, driven)
        found: dict[str, np.ndarray] = {}
        missing: dict[str, str] = {}
        for frame in frames:
            name = self.resolved(frame)
            if base is None:
                missing[frame] = "no transform names a base_link"
            elif name is None:
                missing[frame] = f"no transform names it, or several do: {', '.join(sorted(self._names()))}"
            elif (T := self.between(base, name)) is not None:
                found[frame] = T
            elif any(above in self._moving for above in (*self._above(base), *self._above(name))):
                missing[frame] = f"it moves in {base}"
            else:
                missing[frame] = f"no transform joins it to {base}"
        return found, missing

    def base(self, frames: Iterable[str], driven: str = "") -> str | None:
        """Return the frame of the base: of all called base_link, with any prefix, the one that most frames stand in.

        Where there is none, base_footprint, then the frame that is driven.
        """
        sensors = [name for name in map(self.resolved, frames) if name is not None]
        for wanted in (*_BASES, _last(driven)):
            named = sorted(name for name in self._names() if _last(name) == wanted)
            if wanted and named:
                return max(named, key=lambda name: sum(self.between(name, sensor) is not None for sensor in sensors))
        return None

    def resolved(self, frame: str) -> str | None:
        """Return a frame as the transforms call it: by its name, else by the last part of it where only one has that.

        Robots that share a tree put their name before all frames, and not every driver does: laser, robot1/laser.
        """
        if frame in self._names():
            return frame
        named = [name for name in self._names() if _last(name) == _last(frame)]
        return named[0] if len(named) == 1 else None

    def place(self, parent: str, child: str, xyz: Float[np.ndarray, "3"], rpy: Float[np.ndarray, "3"]) -> None:
        """Fix a frame in another [m, rad], whatever the recording says of it."""
        w = so3.log(so3.from_roll_pitch_yaw(*rpy.tolist()))
        angle = float(np.linalg.norm(w))
        q_xyz = 0.5 * np.sinc(angle / (2 * np.pi)) * w  # sin(angle/2) · axis
        self._parents[child] = (parent, np.array([*xyz, *q_xyz, np.cos(0.5 * angle)]))
        self._placed.add(child)

    def between(self, target: str, source: str) -> Float[np.ndarray, "4 4"] | None:
        """Return T_target_source of two frames, or None where something between them moves or is not known."""
        return np.eye(4) if target == source else self._between(target, source)

    def _names(self) -> set[str]:
        return self._parents.keys() | {parent for parent, _ in self._parents.values()}

    def _between(self, base: str, frame: str) -> np.ndarray | None:
        """Return T_base_frame over the nearest frame above both, or None where something between them moves."""
        above_base, above_frame = self._above(base), self._above(frame)
        common = next((name for name in above_frame if name in above_base), None)
        if common is None:
            return None
        return se3.inverse(above_base[common]) @ above_frame[common]

    def _above(self, frame: str) -> dict[str, np.ndarray]:
        """Return the frames above one as far as nothing moves, the nearest first, each with T_above_frame."""
        T = np.eye(4)
        above = {frame: T}
        while frame in self._parents and frame not in self._moving:
            frame, values = self._parents[frame]
            if frame in above:  # a loop is no tree
                break
            T = _matrix(values) @ T
            above[frame] = T
        return above


def is_base(frame: str) -> bool:
    """Whether a frame has the usual name of a base."""
    return _last(frame) in _BASES


def _last(frame: str) -> str:
    """Return a frame's name without what stands before the last slash."""
    return frame.rpartition("/")[2]


def _matrix(values: np.ndarray) -> np.ndarray:
    """Return the motion (4, 4) of a translation and a quaternion xyzw."""
    return se3.from_rotation_translation(rotation_matrix(values[3:]), values[:3])
