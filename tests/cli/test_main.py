"""The command as a whole: help, exit codes, and one sentence for what a user can mend."""

import subprocess
import sys

import pytest

from longreach import __version__
from longreach.cli import estimate, info
from longreach.errors import LongreachError

HEAVY = ("numpy", "numba", "scipy", "matplotlib", "rosbags", "jaxtyping", "longreach.app")
VERBS = ("info", "estimate", "evaluate", "plan", "run", "serve", "connect", "view", "warmup")


@pytest.mark.parametrize("arguments", [["--help"], *([verb, "--help"] for verb in VERBS)], ids=" ".join)
def test_help_loads_nothing_heavy(arguments):
    code = (
        "import sys\nfrom longreach.cli.main import main\n"
        f"try:\n    main({arguments!r})\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print('loaded:', *[name for name in {HEAVY} if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1].strip() == "loaded:"
    assert "Usage: longreach" in result.stdout


def test_help_names_every_verb(run):
    answer = run("--help")
    assert answer.code == 0
    assert all(f" {verb} " in answer.out for verb in VERBS)


def test_without_a_verb_the_help_is_shown(run):
    answer = run()
    assert answer.code == 2
    assert "Usage" in answer.out + answer.err


@pytest.mark.parametrize("arguments", [["fly"], ["info"], ["estimate", "a.bag"], ["info", "a.bag", "--colour"]])
def test_wrong_usage_is_code_2(run, arguments):
    answer = run(*arguments)
    assert answer.code == 2
    assert "Usage" in answer.err


def fails_with(monkeypatch, error):
    def fail(path, **options):
        raise error

    monkeypatch.setattr("longreach.io.inspect.inspect_recording", fail)


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (LongreachError("Take another one."), 2, "longreach: Take another one."),
        (PermissionError(13, "Permission denied", "/a/b"), 2, "longreach: /a/b: Permission denied."),
        (OSError(28, "No space left on device"), 2, "longreach: No space left on device."),
        (KeyboardInterrupt(), 130, "longreach: interrupted; nothing half-written is left behind."),
    ],
)
def test_errors_are_a_sentence_and_a_code(run, monkeypatch, error, code, sentence):
    fails_with(monkeypatch, error)
    answer = run("info", "a.bag")
    assert (answer.code, answer.sentence, answer.out) == (code, sentence, "")


@pytest.mark.parametrize("arguments", [["--verbose", "info", "a.bag"], ["info", "a.bag", "--verbose"]])
def test_verbose_shows_the_traceback_wherever_it_stands(run, arguments):
    answer = run(*arguments)
    assert answer.code == 2
    assert "Traceback (most recent call last)" in answer.err
    assert answer.err.splitlines()[-1] == "longreach: There is no recording at a.bag; check the path."
    assert "Traceback" not in run("info", "a.bag").err  # and only where it was asked for


def test_a_fault_of_our_own_is_no_sentence_for_the_user(monkeypatch, capsys):
    from longreach.cli.main import main

    fails_with(monkeypatch, ZeroDivisionError("ours"))
    with pytest.raises(ZeroDivisionError):
        main(["info", "a.bag"])


def test_the_verbs_import_what_they_need_when_they_run():
    for module in (info, estimate):
        assert not set(vars(module)) & {"inspect_recording", "np", "open_run"}


def test_the_version_is_a_version():
    assert all(part.isdigit() for part in __version__.split("."))
