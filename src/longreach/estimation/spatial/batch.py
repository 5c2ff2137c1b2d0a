"""The 15-state filter over all that a robot measured, compiled: the main path of a drop-in run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import EstimationError
from longreach.estimation.spatial import _kernels as kernels
from longreach.estimation.spatial.angles import body_rates, from_angles, turned
from longreach.estimation.spatial.online import init
from longreach.estimation.spatial.rows import rows_of, table_of
from longreach.spatial_measurement import Reading, SpatialRecording
from longreach.spatial_settings import SpatialSettings

_AFTER = 10  # messages that came in next: their median shows whether a stamp lies ahead


@dataclass(frozen=True, eq=False)
class SpatialEstimate:
    """Rows of the estimate, and what became of each measurement.

    stamps (n,) [s]; states (n, 15); state_covariance (n, 6, 6) of position and angles in the world.
    used: source (odom0_twist, …) → how many were used, gated, refused. nis: source → stamps, NIS, rows of each.
    """

    stamps: Float[np.ndarray, " n"]
    states: Float[np.ndarray, "n 15"]
    state_covariance: Float[np.ndarray, "n 6 6"]
    used: Mapping[str, tuple[int, int, int]]
    nis: Mapping[str, tuple[np.ndarray, np.ndarray, int]]
    remarks: tuple[str, ...]

    @property
    def poses(self) -> Float[np.ndarray, "n 4 4"]:
        """T_world_base (n, 4, 4)."""
        T = np.zeros((len(self.stamps), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = from_angles(self.states[:, 3:6]), self.states[:, :3], 1.0
        return T

    @property
    def covariance(self) -> Float[np.ndarray, "n 6 6"]:
        """Of ξ = log(mean⁻¹ · truth), [v; ω] in the base's axes: ξ = (Rᵀ δp, W δρ)."""
        rho = self.states[:, 3:6]
        return turned(self.state_covariance, np.swapaxes(from_angles(rho), 1, 2), body_rates(rho))


def estimate_in_space(recording: SpatialRecording, settings: SpatialSettings) -> SpatialEstimate:
    """Run the filter over a recording; late readings stand where their stamps put them.

    Raises:
        EstimationError: nothing is there that could be fused.
    """
    readings, remarks = _believed(recording.readings, settings.history)
    rows = rows_of(readings, recording, settings)
    if not rows:
        raise EstimationError("No reading of the recording can be fused; check the masks and frames of the sensors.")
    table, whose = table_of(rows)
    begin, end, rate = table[0][0], table[0][-1], settings.frequency
    if (end - begin) * rate > 50_000_000:
        raise EstimationError(f"At {rate:g} rows a second, {end - begin:.0f} s make too many; lower frequency.")
    ticks = begin + np.arange(int((end - begin) * rate) + 1) / rate  # when rows of the estimate are due
    ticks = np.append(ticks[ticks < end], end)
    n, m = len(whose), len(ticks)
    status, nis, stamps, states = np.zeros(n, dtype=np.int8), np.full(n, np.nan), np.zeros(m), np.zeros((m, 15))
    covariances = np.zeros((m, 6, 6))
    start, silence = init(settings, recording), (settings.sensor_timeout, settings.predict_to_now)
    x, P = start.mean.copy(), start.covariance.copy()
    out = (status, nis, stamps, states, covariances, np.zeros(3), x[9:12].copy())
    kernels.run(x, P, table, ticks, start.model, start.control, *silence, out, kernels.work_room())
    if not np.all(np.isfinite(states)):
        raise EstimationError("The filter lost itself in numbers that are not finite; check covariances and noise.")
    used, consistency, fresh = {}, {}, np.append(True, np.diff(stamps) > 0)
    for i, r in enumerate(rows):
        own = whose == i
        counts = [int(np.count_nonzero(status[own] == kind)) for kind in (kernels.USED, kernels.GATED, kernels.REFUSED)]
        used[r.source] = tuple(counts)
        own &= np.isfinite(nis)
        consistency[r.source] = (table[0][own], nis[own], r.k)
        for count, what in (
            (r.incomplete, "hold values that are no numbers; those were left out"),
            (counts[1], "were beyond the threshold and left out"),
            (counts[2], "were refused, for their covariance is none"),
        ):
            if count:
                remarks.append(f"{r.source}: {count} of {sum(counts)} measurements {what}.")
    remarks = (*recording.remarks, *remarks)
    return SpatialEstimate(stamps[fresh], states[fresh], covariances[fresh], used, consistency, remarks)


def _believed(readings: Sequence[Reading], history: float) -> tuple[list[Reading], list[str]]:
    """Return the readings in the order of their stamps, without those too late and those from the future."""
    stamps = np.array([reading.stamp for reading in readings])
    late, ahead = late_and_ahead(stamps, history)
    remarks = []
    if late.any():
        remarks.append(f"{late.sum()} readings came in more than {history:g} s late and were left out.")
    if ahead.any():
        remarks.append(f"{ahead.sum()} readings have stamps ahead of what came in after them and were left out.")
    kept = np.flatnonzero(~late & ~ahead)
    behind = np.maximum.accumulate(stamps[kept]) - stamps[kept]
    if np.any(behind > 0):
        count, most = np.count_nonzero(behind), behind.max()
        remarks.append(f"{count} readings came in out of order, by up to {most:.3f} s, and were put where they belong.")
    return [readings[i] for i in kept[np.argsort(stamps[kept], kind="stable")].tolist()], remarks


def late_and_ahead(stamps: Float[np.ndarray, " n"], history: float) -> Bool[np.ndarray, "2 n"]:
    """Return which readings, as they came in, are more than `history` [s] late, and which further ahead of the next.

    A wrong clock stands alone, whatever comes after a pause in the recording does not. A late reading is taken where it
    belongs, as if the filter went back to it; one from the future is left out and holds up nothing.
    """
    n = len(stamps)
    ahead = np.zeros(n, dtype=bool)
    whole = max(n - _AFTER, 0)  # so many have all that come after
    if whole:
        after = np.lib.stride_tricks.sliding_window_view(stamps[1:], _AFTER)
        ahead[:whole] = stamps[:whole] > np.median(after, axis=1) + history
    for i in range(whole, n - 1):
        ahead[i] = stamps[i] > np.median(stamps[i + 1 :]) + history
    if n > 2:  # nothing came after the last
        others = np.sort(stamps[:-1][~ahead[:-1]])
        longest = float(np.diff(others).max(initial=0.0))
        ahead[-1] = stamps[-1] > others[-1] + longest + history
    latest = np.maximum.accumulate(np.where(ahead, -np.inf, stamps))
    return np.stack([~ahead & (latest - stamps > history), ahead])
