"""Messages from outside that were refused: counted by reason, and logged without flooding the log."""

import logging
import time
from collections import Counter
from dataclasses import dataclass, field

# Reasons that are counted one by one: some hold a name or a place, and there is no end of those; ours.
_REASONS, _OTHER = 100, "for another reason"
_QUIET = 1.0  # between two lines in the log about the same reason [s]; each says how many there were


@dataclass
class RejectionCounts:
    """How many messages were refused, by reason; each is logged, those that come in a flood together."""

    name: str = "longreach.live"  # of the logger
    counts: Counter[str] = field(default_factory=Counter)
    _logged: dict[str, tuple[float, int]] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """How many there were."""
        return sum(self.counts.values())

    def count(self, reason: str, topic: str) -> None:
        """Count one more and log it."""
        if reason not in self.counts and len(self.counts) >= _REASONS:
            reason = _OTHER
        self.counts[reason] += 1
        when, logged = self._logged.get(reason, (-_QUIET, 0))
        now = time.monotonic()
        if now - when >= _QUIET:
            self._logged[reason] = now, self.counts[reason]
            new = self.counts[reason] - logged
            total = self.counts[reason]
            logging.getLogger(self.name).warning("Refused %d on %s: %s (%d so far).", new, topic, reason, total)

    def log_all(self) -> None:
        """Log what has not been logged yet."""
        for reason, total in dict(self.counts).items():  # others may count meanwhile
            if total > self._logged.get(reason, (0.0, 0))[1]:
                logging.getLogger(self.name).warning("Refused %d in all: %s.", total, reason)
