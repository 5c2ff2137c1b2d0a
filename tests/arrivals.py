"""Readings of a recording as they arrive, and what a localizer settles of them."""

import numpy as np

from longreach.localization import localizer


def readings_of(recording):
    """All readings in the order of their stamps."""
    readings = [*recording.wheels, *recording.imu, *recording.fixes, *recording.scans]
    return sorted(readings, key=lambda reading: reading.stamp)


def late(readings, rng, most, share=1.0):
    """The readings in the order in which they arrive, a share of them up to so many seconds late."""
    delays = rng.uniform(0.0, most, len(readings)) * (rng.random(len(readings)) < share)
    order = np.argsort([reading.stamp + delay for reading, delay in zip(readings, delays, strict=True)], kind="stable")
    return [readings[i] for i in order]


def settled_rows(state, blocks):
    """The rows that blocks of readings settle, and those that are left at the end: in odom and on the map."""
    rows, on_map = [], []
    for block in blocks:
        state, output = localizer.step(state, block)
        rows += output.rows
        on_map += output.rows_on_map
    output = localizer.settled(state)
    return rows + output.rows, on_map + output.rows_on_map


def same_rows(some, others):
    """Whether rows in both frames are the same to the last bit."""
    return all(
        len(one) == len(other)
        and all(
            a.stamp == b.stamp and np.array_equal(a.pose, b.pose) and np.array_equal(a.covariance, b.covariance)
            for a, b in zip(one, other, strict=True)
        )
        for one, other in zip(some, others, strict=True)
    )
