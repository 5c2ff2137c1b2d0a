import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))


@pytest.mark.long
def test_errors_of_maps_are_as_large_as_their_covariances_say_and_no_closure_is_false():
    from map_consistency import ATE_BATCH, ATE_DRIVING, drive_in, figures, mapped

    rows = [figures(mapped(drive_in("storehouse", seed, 110.0))) for seed in (0, 1)]
    mean = {name: np.mean([row[name] for row in rows]) for name in rows[0]}
    assert mean["accepted"] > 0
    assert mean["false"] == 0
    assert mean["ATE batch m"] < ATE_BATCH
    assert mean["ATE driving m"] < ATE_DRIVING
    # Errors of one drive are correlated: a mean of two drives has a wider range than that of twenty.
    assert 0.3 < mean["NEES closures"] < 4.5
    assert 0.5 < mean["NEES poses"] < 9.0
