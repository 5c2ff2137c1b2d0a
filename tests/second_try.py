"""A plugin of pytest: a failed system test is repeated once, and the repeat is printed and counted.

System tests keep time with other processes, and a busy machine can be late. The repeat comes after all other tests,
with new fixtures. A test that fails again has failed; one that passes then is named at the end of the run.
"""

from collections.abc import Iterator

import pytest
from _pytest.runner import runtestprotocol

REPEATED = pytest.StashKey[list[pytest.Item]]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[REPEATED] = []


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a system test for the first time; a failure is reported as `repeated`, which is no failure yet."""
    repeated, hook = item.config.stash[REPEATED], item.ihook
    if not item.get_closest_marker("system") or item in repeated or hasattr(item.config, "workerinput"):
        return None
    hook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports = runtestprotocol(item, nextitem=nextitem, log=False)
    if any(report.failed for report in reports):
        repeated.append(item)
    for report in reports:
        if report.failed:
            report.outcome = "repeated"  # type: ignore[assignment]
        hook.pytest_runtest_logreport(report=report)
    hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


@pytest.hookimpl(wrapper=True)
def pytest_runtestloop(session: pytest.Session) -> Iterator[None]:
    """Run the tests, and then those again that failed for the first time."""
    result = yield
    repeated = session.config.stash[REPEATED]
    for item, following in zip(repeated, [*repeated[1:], None], strict=False):
        session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
    return result


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    return ("repeated", "R", "REPEATED") if report.outcome == "repeated" else None


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print why each repeated test failed at first, and how many passed only on the second try."""
    reports = terminalreporter.stats.get("repeated", [])
    if not reports:
        return
    terminalreporter.section("failed on the first try")
    for report in reports:
        terminalreporter.write_sep("_", report.nodeid)
        terminalreporter.write_line(report.longreprtext)
    failed = {report.nodeid for kind in ("failed", "error") for report in terminalreporter.stats.get(kind, [])}
    names = sorted({report.nodeid for report in reports} - failed)
    terminalreporter.section("repeats")
    terminalreporter.write_line(f"{len(names)} tests passed only on the second try{':' if names else '.'}")
    for name in names:
        terminalreporter.write_line(name)
