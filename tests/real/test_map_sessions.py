"""Two halves of a real log, as two recordings of one building."""

import numpy as np
import pytest

from longreach.app.inputs import open_run
from longreach.app.map import build_map
from longreach.evaluation.relations import relation_errors
from longreach.trajectory import PoseTrajectory

pytestmark = pytest.mark.usefixtures("unchecked")


def test_halves_of_csail_are_joined_as_well_as_one_recording_of_both(data):
    run = open_run(data / "csail/csail.clf.bz2", "csail", relations=data / "csail/csail.relations")
    r, (first, second, poses) = run.recording, run.relations
    stamps = [scan.stamp for scan in r.scans]
    middle = stamps[len(stamps) // 2]

    def part(low, high, name):
        kept = {of: tuple(x for x in getattr(r, of) if low <= x.stamp < high) for of in ("wheels", "scans")}
        return r.replace(name=name, **kept)

    parts = part(-np.inf, middle, "first"), part(middle, np.inf, "second")
    built = build_map(parts, run.robot, run.config)
    assert built.left_out == ()
    one, other = built.trajectories["mapped"], built.trajectories["mapped_2"]
    both = PoseTrajectory(np.concatenate([one.stamps, other.stamps]), np.concatenate([one.poses, other.poses]))
    across = (np.minimum(first, second) < middle) & (np.maximum(first, second) >= middle)
    errors = relation_errors(both, first[across], second[across], poses[across])
    assert errors.used > 50
    assert errors.translation.mean() < 0.06  # in one recording 0.038 m; odometry alone 0.38 m
    assert np.degrees(errors.rotation.mean()) < 0.6
