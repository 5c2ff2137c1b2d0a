"""The commands in the documents: those that need no data are run, all others at least exist with all their options."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from longreach.cli.main import app

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
DOCUMENTS = [README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)
GROUP = typer.main.get_command(app)
QUICKER = {"dual-trajectory": ["--length", "0.2", "--seeds", "1"]}  # of what takes long, which is done quicker


def commands(path, first):
    """Every line of the document's sh blocks that starts with the word, without it."""
    lines = [line for block in BLOCK.findall(path.read_text(encoding="utf-8")) for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith(f"{first} ")]


def check(arguments):
    """Parse a command line without running it."""
    verb, *rest = arguments
    known = GROUP.commands.get(verb)
    assert known is not None, f"there is no longreach {verb}"
    known.make_context(verb, list(rest))


def has_what_it_needs(arguments):
    """Whether the files are there that the command reads."""
    verb, *rest = arguments
    if verb == "view" and "--export" not in rest:
        return False  # serves until it is interrupted
    return verb == "warmup" or rest[0] in QUICKER or Path(rest[0]).exists()


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_command_in_the_documents_exists_with_its_options(path):
    for arguments in commands(path, "longreach"):
        check(arguments)


@pytest.mark.parametrize("arguments", [["estimate", "a.bag"], ["warmup", "--speed", "3"], ["info", "a.bag", "b.bag"]])
def test_the_check_sees_a_command_that_cannot_be(arguments):
    with pytest.raises(Exception, match=r"Missing parameter|No such option|unexpected extra argument"):
        check(arguments)


def test_the_check_sees_a_verb_that_is_not_there():
    with pytest.raises(AssertionError, match="there is no longreach fly"):
        check(["fly"])


def test_the_readme_names_every_verb():
    assert {arguments[0] for arguments in commands(README, "longreach")} == set(GROUP.commands)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_every_make_target_and_script_in_the_documents_is_there(path):
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert not [words for words in commands(path, "make") if not set(words) <= set(targets)]
    assert not [words for words in commands(path, "python") if not (ROOT / words[0]).is_file()]


@pytest.mark.long
def test_the_readmes_commands_run_and_leave_what_the_documents_say(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran = []
    for arguments in commands(README, "longreach"):
        quicker = [] if arguments[0] == "plan" else QUICKER.get(" ".join(arguments[1:2]), [])
        if has_what_it_needs(arguments):
            # In processes of their own, where shapes are not checked at run time, which physics is too slow for.
            ended = subprocess.run([sys.executable, "-m", "longreach", *arguments, *quicker], capture_output=True)
            assert ended.returncode == 0, ended.stderr.decode()
            ran.append(arguments[0])
    assert set(ran) == {"run", "info", "estimate", "evaluate", "plan", "view", "warmup"}
    text = (ROOT / "docs" / "outputs.md").read_text(encoding="utf-8")
    for name in {path.name for path in Path("out").rglob("*") if path.is_file()}:
        assert f"`{name}`" in text, f"{name} is not explained"
