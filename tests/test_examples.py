"""The examples gallery is run, each file in a folder of its own and without any data."""

import re
import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))


def test_the_gallery_is_numbered_without_gaps():
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_says_something(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    assert len(capsys.readouterr().out.splitlines()) >= 3
    assert f"python examples/{path.name}" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) < 60


def test_examples_and_documents_name_no_place_of_one_machine():
    root = Path(__file__).parent.parent
    for path in [*EXAMPLES, *root.glob("*.md"), *root.glob("docs/*")]:
        if path.is_file():
            assert not re.search(r"(?<![\w.])/(home|work|tmp|root|Users)/", path.read_text(encoding="utf-8")), path.name
