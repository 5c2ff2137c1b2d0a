"""What is wrong with a robot's readings while they come: the checks of a recording, over the last ten seconds of them.

Nothing is put right and nothing stops: what is found is said, in the sentences that a recording with these readings
would get, without what was done about it.
"""

import logging
from collections import Counter
from collections.abc import Sequence
from threading import Thread

import numpy as np

from longreach.app import doctor, plausibility
from longreach.app.tracker import wheels_fault
from longreach.control.hardware import Readings
from longreach.errors import LongreachError
from longreach.io import clocks, records
from longreach.io.clocks import Stamped
from longreach.localization.localizer import Output
from longreach.measurement import Odometry, Recording, Wheels, WheelTicks
from longreach.robot.description import RobotDescription

_EVERY = 10.0  # [s] between looks, each at what came since the one before; plausibility looks back two minutes
_KINDS = ("wheels", "imu", "scans")
_NAMES = {"wheels": "wheels", "imu": "imu", "scans": "lidar"}


class ReadingsCheck:
    """Takes what was read and what the estimate made of it; `remarks`: what is wrong now, a sentence each.

    It looks from a thread of its own, so that a loop that keeps time does not wait for it. A sentence is logged when
    it is new, whatever its numbers are.
    """

    def __init__(self, robot: RobotDescription, mount_is_known: bool = True, log: str = "longreach.live") -> None:
        self.remarks: tuple[str, ...] = ()
        self._robot, self._mount_is_known, self._log = robot, mount_is_known, logging.getLogger(log)
        self._recent = plausibility.Recent()
        self._taken: list[Readings] = []
        self._outputs: list[Output] = []
        self._unusable: Counter[tuple[str, str]] = Counter()
        self._known: set[str] = set()
        self._looks: Thread | None = None

    def take(self, readings: Readings, output: Output | None) -> None:
        """Take what was read at one time, and what the estimate gave out; look where it is time to."""
        self._taken.append(readings)
        if output is not None:
            self._outputs.append(output)
        if readings.stamp - self._taken[0].stamp < _EVERY or (self._looks is not None and self._looks.is_alive()):
            return
        self._looks = Thread(target=self._look, args=(self._taken, self._outputs), name="checking", daemon=True)
        self._taken, self._outputs = [], []
        self._looks.start()

    def _look(self, taken: Sequence[Readings], outputs: Sequence[Output]) -> None:
        try:
            found = [*taken[-1].remarks, *self._of_each(taken), *_of_all(taken, self._robot)]
            matches = [match for one in outputs for match in one.matches]
            self._recent.take(matches, [event for one in outputs for event in one.events], self._mount_is_known)
            found += [finding(self._recent.remark)] if self._recent.remark else []
        except Exception as error:  # whatever readings can be: the robot goes on
            found = [f"The readings could not be checked: {error}"]
            if not isinstance(error, LongreachError):
                self._log.debug("The check of the readings has failed.", exc_info=True)
        self.remarks = tuple(found)
        for remark in found:
            kind = without_numbers(remark)
            if kind not in self._known and len(self._known) < 100:
                self._known.add(kind)
                self._log.warning(remark)

    def _of_each(self, taken: Sequence[Readings]) -> list[str]:
        """Count the readings that are not finite, which the estimate passes over, since the start."""
        for readings in taken:
            for imu in readings.imu:
                if not np.isfinite(imu.angular_velocity).all():
                    self._unusable["imu", records.GYRO_NOT_FINITE] += 1
            for wheels in readings.wheels:
                if why := _fault(wheels, self._robot):
                    self._unusable["wheels", why] += 1
        return [records.left_out(n, topic, why) for (topic, why), n in self._unusable.items() if n]


def _of_all(taken: Sequence[Readings], robot: RobotDescription) -> list[str]:
    """Check clocks, and what the doctor checks of a recording, but that wheels stand: a robot may."""
    read = {kind: [one for some in taken for one in getattr(some, kind)] for kind in _KINDS}
    came = {kind: [some.stamp for some in taken for _ in getattr(some, kind)] for kind in _KINDS}
    stamped = {
        kind: Stamped(_NAMES[kind], np.array([one.stamp for one in read[kind]]), np.array(came[kind]))
        for kind in _KINDS
        if read[kind]
    }
    _, said = clocks.on_one_clock(stamped)
    read["imu"] = [one for one in read["imu"] if np.isfinite(one.angular_velocity).all()]
    read["wheels"] = [one for one in read["wheels"] if not _fault(one, robot)]
    if not any(_moves(one, read["wheels"][0]) for one in read["wheels"]):
        read["wheels"] = []
    wheels, imu, scans = (tuple(sorted(read[kind], key=lambda one: one.stamp)) for kind in _KINDS)
    recording = Recording("live", wheels, scans, imu)
    mount = np.eye(4) if robot.imu is None or robot.imu.mount is None else robot.imu.mount.matrix()
    _, found = doctor.examine(recording, robot, mount)
    return [finding(remark) for remark in (*said, *found)]


def finding(remark: str) -> str:
    """Return what a sentence of the doctor or of plausibility has found, without what was done about it."""
    return remark.partition("; ")[0].rstrip(".") + "."


def without_numbers(remark: str) -> str:
    """Return what stays the same of a sentence when its numbers change."""
    return "".join(c for c in remark if not c.isdigit())


def _numbers(one: Wheels) -> list[np.ndarray]:
    if isinstance(one, Odometry):
        return [part for part in (one.pose, one.twist) if part is not None]
    return [one.ticks if isinstance(one, WheelTicks) else one.speeds]


def _fault(one: Wheels, robot: RobotDescription) -> str:
    finite = all(np.isfinite(part).all() for part in _numbers(one))
    return wheels_fault(one, robot) if finite else "is not finite"


def _moves(one: Wheels, first: Wheels) -> bool:
    return any(not np.array_equal(a, b) for a, b in zip(_numbers(one), _numbers(first), strict=False))
