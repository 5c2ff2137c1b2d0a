"""A failed system test is repeated once, by a pytest in a process of its own; the repeat is printed and counted."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
from pathlib import Path
import pytest

def passes_at(number):
    calls = Path("calls.txt")
    with calls.open("a") as file:
        file.write("x")
    assert len(calls.read_text()) >= number, "too early"

@pytest.fixture(scope="module")
def late():
    passes_at(2)

@pytest.mark.system
def test_asked(late):
    pass

@pytest.mark.system
def test_always_fails():
    raise ValueError("broken")

def test_no_system_test():
    passes_at(100)
"""


def outcome(folder, name):
    (folder / "test_it.py").write_text(TESTS)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers =\n    system: a test of the system\n")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    command = [sys.executable, "-m", "pytest", "-p", "second_try", "-p", "no:cacheprovider", "-k", name]
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return ended.returncode, ended.stdout


def test_a_system_test_that_passes_on_the_second_try_passes_and_is_named(tmp_path):
    code, text = outcome(tmp_path, "test_asked")
    assert code == 0, text
    assert "1 tests passed only on the second try:\ntest_it.py::test_asked\n" in text
    assert "AssertionError: too early" in text
    assert "1 passed, 2 deselected, 1 repeated in" in text


def test_a_system_test_that_fails_twice_fails(tmp_path):
    code, text = outcome(tmp_path, "test_always_fails")
    assert code == 1
    assert "0 tests passed only on the second try." in text
    assert "1 failed, 2 deselected, 1 repeated in" in text


def test_a_test_of_another_tier_is_not_repeated(tmp_path):
    code, text = outcome(tmp_path, "test_no_system_test")
    assert code == 1
    assert "second try" not in text


@pytest.mark.parametrize("folder", ["live", "ros", "view", "real"])
def test_a_folder_with_a_tier_is_there(folder):
    assert (Path(__file__).parent / folder / "conftest.py").is_file()
