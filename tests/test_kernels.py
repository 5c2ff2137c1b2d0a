"""A throw-away package with the real kernels.py and two kernels, one calling the other, run in fresh interpreters."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from longreach import kernels

CALLEE = """from tiny.kernels import kernel

@kernel
def plus(x):
    return x + {}
"""
CALLER = """from tiny.kernels import kernel
from tiny.callee import plus

@kernel
def twice(x):
    return 2.0 * plus(x)
"""
CALL = "from tiny.caller import twice; print(twice(1.0), sum(twice.stats.cache_hits.values()))"
FOLDER = "from tiny.kernels import cache_root; print(cache_root())"
HASH = "from pathlib import Path; from tiny.kernels import source_hash; print(source_hash(Path('tiny/{}')))"


@pytest.fixture
def tiny(tmp_path):
    package = tmp_path / "tiny"
    package.mkdir()
    shutil.copy(kernels.__file__, package / "kernels.py")
    (package / "__init__.py").touch()
    (package / "callee.py").write_text(CALLEE.format(1.0))
    (package / "caller.py").write_text(CALLER)
    return package


def run(tiny, code, **environment):
    kept = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    kept["PYTHONDONTWRITEBYTECODE"] = "1"  # Python notices no edit of the same length within the same second
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=tiny.parent,
        env=kept | environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def test_an_edited_callee_in_another_file_gives_the_new_result(tiny, tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run(tiny, CALL, **cache) == "4.0 0"
    assert run(tiny, CALL, **cache) == "4.0 1"  # loaded, not compiled
    (tiny / "callee.py").write_text(CALLEE.format(2.0))
    assert run(tiny, CALL, **cache) == "6.0 0"


@pytest.mark.parametrize("name", ["callee.py", "caller.py", "kernels.py"])
def test_an_edit_of_what_a_kernel_file_imports_changes_its_hash(tiny, name):
    before = run(tiny, HASH.format("caller.py"))
    (tiny / name).write_text((tiny / name).read_text() + "# edited\n")
    assert run(tiny, HASH.format("caller.py")) != before


def test_an_edit_of_what_a_kernel_file_does_not_import_leaves_its_cache_alone(tiny):
    before = run(tiny, HASH.format("callee.py"))
    (tiny / "caller.py").write_text(CALLER + "# edited\n")
    assert run(tiny, HASH.format("callee.py")) == before


@pytest.mark.parametrize(
    "line",
    [
        "import tiny.callee",
        "from tiny import callee",
        "from tiny.callee import (\n    plus,\n)",
        "from tiny import (\n    callee,\n)",
    ],
)
def test_every_form_of_import_is_followed(tiny, line):
    (tiny / "caller.py").write_text(line + "\n")
    before = run(tiny, HASH.format("caller.py"))
    (tiny / "callee.py").write_text(CALLEE.format(2.0))
    assert run(tiny, HASH.format("caller.py")) != before


def test_the_cache_lies_where_numba_cache_dir_says(tiny, tmp_path):
    folder = Path(run(tiny, FOLDER, NUMBA_CACHE_DIR=str(tmp_path / "mine")))
    assert folder == tmp_path / "mine"
    assert folder.is_dir()


def test_the_cache_lies_in_the_users_cache_folder_otherwise(tiny, tmp_path):
    folder = Path(run(tiny, FOLDER, XDG_CACHE_HOME=str(tmp_path / "home")))
    assert folder == tmp_path / "home" / "longreach"


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "NUMBA_CACHE_DIR"])
def test_where_nothing_can_be_written_the_cache_lies_in_the_temporary_folder(tiny, tmp_path, variable):
    (tmp_path / "file").touch()  # a folder below a file cannot be made, not even by root
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    folder = Path(run(tiny, FOLDER, TMPDIR=str(temporary), **{variable: str(tmp_path / "file" / "cache")}))
    assert folder.parent == temporary
    assert folder.is_dir()


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no user ids on this system")
def test_a_temporary_folder_that_another_user_made_is_not_trusted(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    mine = kernels._private_temporary()
    assert kernels._private_temporary() == mine
    stranger = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: stranger)
    (tmp_path / f"longreach-{stranger}").mkdir()  # belongs to the user who runs the test, not to the stranger
    assert kernels._private_temporary().name.startswith("longreach-")
    assert kernels._private_temporary() != tmp_path / f"longreach-{stranger}"


def test_decorating_leaves_numbas_own_cache_setting_alone():
    before = kernels._settings.CACHE_DIR
    kernels.kernel(lambda x: x)
    assert before == kernels._settings.CACHE_DIR


def test_a_kernel_may_be_given_fastmath():
    @kernels.kernel(fastmath=True)
    def double(x):
        return 2.0 * x

    assert double.targetoptions["fastmath"] is True
    assert double(1.5) == 3.0
