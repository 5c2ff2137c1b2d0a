"""What importing the package costs, and how long its files and functions may be."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import longreach

PACKAGE = Path(longreach.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
NAMES = [path.relative_to(PACKAGE).as_posix() for path in SOURCES]
HEAVY = ("numba", "numpy", "scipy", "matplotlib", "rosbags", "pydantic", "jaxtyping", "typer", "rich")


def loaded_after(statement):
    code = f"import sys; {statement}; print(*[name for name in {HEAVY} if name in sys.modules])"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()


def test_importing_longreach_loads_nothing_heavy():
    assert loaded_after("import longreach") == []


def test_an_error_can_be_caught_without_loading_anything_heavy():
    assert loaded_after("from longreach import LongreachError") == []


@pytest.mark.parametrize("name", longreach.__all__)
def test_every_public_name_is_there(name):
    assert getattr(longreach, name) is not None
    assert name in dir(longreach)


def test_editors_know_the_same_public_names_from_the_same_places():
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    found = {name.name: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for name in node.names}
    assert found == longreach._PUBLIC
    listed = next(node.value for node in stub.body if isinstance(node, ast.Assign))
    assert sorted(ast.literal_eval(listed)) == sorted(longreach.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        longreach.nothing  # noqa: B018


@pytest.mark.parametrize("path", SOURCES, ids=NAMES)
def test_files_have_at_most_500_lines_and_functions_80_and_those_of_kernels_700_and_120(path):
    longest_file, longest_function = (700, 120) if path.stem.endswith("kernels") else (500, 80)
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= longest_file
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = node.end_lineno - node.lineno + 1
            assert length <= longest_function, f"{node.name} has {length} lines"


@pytest.mark.parametrize("path", SOURCES, ids=NAMES)
def test_every_module_says_what_it_is(path):
    assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("word", ["utils", "common", "helpers", "base", "constants", "types"])
def test_no_file_is_named_after_nothing(word):
    assert not [name for name in NAMES if Path(name).stem.strip("_") == word]
