"""The double of a robot that the tests drive, and what a healthy one with two joints and four wheels says."""

import numpy as np

from longreach.control.hardware import Readings
from longreach.measurement import JointState, WheelSpeeds

NAMES = ("shoulder", "elbow")
PERIOD = 0.008
NOTHING = np.zeros(0)


class RecordedHardware:
    """A robot that gives back recorded readings and keeps what it is told: the shortest driver that works."""

    def __init__(self, capabilities, recorded):
        self.capabilities, self._recorded = capabilities, list(recorded)
        self.written, self.stopped = [], None

    def read(self):
        return self._recorded.pop(0)

    def write(self, command):
        if self.stopped is None:
            self.written.append(command)

    def stop(self, reason):
        self.stopped = self.stopped or reason


def readings(stamp, q=(0.0, 0.0), **changes):
    """What a healthy robot says at one time."""
    joints = (JointState(stamp, NAMES, np.array(q), NOTHING, NOTHING),)
    return Readings(stamp, **{"joints": joints, "wheels": (WheelSpeeds(stamp, np.zeros(4)),), **changes})
