"""Prose that is run: the examples in docstrings, and the Python blocks of README.md and docs/*.md."""

import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import longreach

ROOT = Path(__file__).parent.parent
MODULES = ["longreach", *(m.name for m in pkgutil.walk_packages(longreach.__path__, "longreach."))]
DOCUMENTS = [path for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))] if path.is_file()]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_in_docstrings_are_true(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_the_python_in_the_documents_runs(path, tmp_path, monkeypatch):
    blocks = list(BLOCK.finditer(path.read_text(encoding="utf-8")))
    if not blocks:
        pytest.skip(f"{path.name} has no python blocks")
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "__main__"}  # the blocks of one document follow each other
    text = path.read_text(encoding="utf-8")
    for block in blocks:
        lines = "\n" * text.count("\n", 0, block.start(1))  # so that an error names the line of the document
        exec(compile(lines + block[1], path, "exec"), names)
