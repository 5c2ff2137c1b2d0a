"""Estimates of real logs, each read and made once, and without the shape checks, which all other tests have."""

import jaxtyping
import pytest

from longreach.app.estimate import estimate
from longreach.app.inputs import open_run


def unchecked(run, *arguments, **options):
    """Call a function with the shape checks off: over a whole log they take longer than what they check."""
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        return run(*arguments, **options)
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


def read_and_estimate(*arguments, **options):
    run = open_run(*arguments, **options)
    return estimate(run.recording, run.robot, run.config, truth=run.truth, relations=run.relations)


@pytest.fixture(scope="session")
def estimated(data):
    """Read and estimate a recording under `data`, with its relations where it has some."""
    made = {}

    def of(name, robot):
        if name not in made:
            relations = (data / name).parent / f"{robot}.relations"
            known = relations if relations.is_file() else None
            made[name] = unchecked(read_and_estimate, data / name, robot, relations=known)
        return made[name]

    return of


@pytest.fixture(scope="session")
def estimate_of():
    """Read and estimate a recording, as `open_run` takes it."""
    return lambda *arguments, **options: unchecked(read_and_estimate, *arguments, **options)


@pytest.fixture
def held_by_fixes(data):
    """Estimate the Intel log once more, with its corrected poses as positions of 5 cm, one every 5 s at most."""
    corrected = data / "intel" / "intel-corrected.log.gz"
    return unchecked(
        read_and_estimate,
        data / "intel" / "intel.clf.bz2",
        "intel",
        truth=str(corrected),
        fixes=corrected,
        fix_sigma=0.05,
        fix_period=5.0,
    )
