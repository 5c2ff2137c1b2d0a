"""What /diagnostics says of an estimate: by source how often it speaks, what became of it, and how far off it is."""

import math
import time
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

from longreach.app.readings_check import ReadingsCheck
from longreach.control.hardware import Readings
from longreach.estimation.planar.state import Correction
from longreach.io import messages
from longreach.localization.localizer import Output
from longreach.robot.description import RobotDescription
from longreach.ros import wire

_PERIOD = 1.0  # [s]; what diagnostic_updater does
_FAR = 3.0  # of the mean NIS a degree of freedom, which is 1 where everything is as noisy as it says; ours
_OK, _WARN, _STALE = 0, 1, 3
_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"


@dataclass
class Tally:
    """What became of one source's measurements in a period."""

    used: int = 0
    gated: int = 0
    refused: int = 0
    nis: float = 0.0
    dof: int = 0
    reason: str = ""

    def take(self, correction: Correction) -> None:
        """Count one more."""
        setattr(self, correction.status, getattr(self, correction.status) + 1)
        self.nis, self.dof = self.nis + correction.nis, self.dof + correction.dof
        self.reason = correction.reason or self.reason


class Diagnostics:
    """Counts, and once a period tells."""

    def __init__(self, robot: RobotDescription) -> None:
        self._since = time.monotonic()
        self._publisher = wire.Publisher("/diagnostics", _ARRAY)
        self._tallies: defaultdict[str, Tally] = defaultdict(Tally)
        self._check = ReadingsCheck(robot, log="longreach.ros")

    def take(self, readings: Readings, output: Output) -> None:
        """Count what became of measurements, and tell where it is time to."""
        self._check.take(readings, output)
        for correction in output.corrections:
            if correction.dof or correction.status == "refused":
                self._tallies[correction.source].take(correction)
        elapsed = time.monotonic() - self._since
        if elapsed < _PERIOD:
            return
        types = wire.message_types()
        statuses = [_status(types, name, tally, elapsed) for name, tally in self._tallies.items()]
        level, sentence = (_WARN, " ".join(remarks)) if (remarks := self._check.remarks) else (_OK, "nothing is wrong")
        statuses.append(status(types, level, "longreach: readings", sentence, {}))
        self._publisher.send(types[_ARRAY](messages.header(types, wire.now(), ""), statuses))
        self._tallies = defaultdict(
            Tally, {name: Tally() for name in self._tallies}
        )  # who was heard once may be missed
        self._since += elapsed


def _status(types: messages.Types, name: str, tally: Tally, elapsed: float) -> Any:
    count = tally.used + tally.gated + tally.refused
    nis = tally.nis / tally.dof if tally.dof else math.nan
    level, sentence = _OK, "agrees with the estimate"
    if count == 0:
        level, sentence = _STALE, "says nothing"
    elif tally.gated + tally.refused > 0:
        level, sentence = _WARN, tally.reason or "is left out in part"
    elif nis > _FAR:
        level, sentence = _WARN, f"is further from the estimate than it should be: NIS {nis:.1f} a degree of freedom"
    values = {
        "rate [Hz]": f"{count / elapsed:.1f}",
        "used": str(tally.used),
        "gated": str(tally.gated),
        "refused": str(tally.refused),
        "NIS per degree of freedom": f"{nis:.3f}",
    }
    return status(types, level, f"longreach: {name}", sentence, values)


def status(types: messages.Types, level: int, name: str, sentence: str, values: dict[str, str]) -> Any:
    """Return a diagnostic_msgs/DiagnosticStatus."""
    pairs = [types["diagnostic_msgs/msg/KeyValue"](key, value) for key, value in values.items()]
    return types["diagnostic_msgs/msg/DiagnosticStatus"](level, name, sentence, "longreach", pairs)
