"""longreach view, where no page is served: tests/view looks at pages."""

import errno
from pathlib import Path
from types import SimpleNamespace

from longreach.cli.view import _serve


def test_a_scene_is_exported_whole_or_not_at_all(run, monkeypatch, tmp_path):
    def full(path, text, encoding=None):
        with path.open("w") as file:
            file.write(text[:4])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("longreach.view.replay.read_run", lambda *_: None)
    monkeypatch.setattr("longreach.view.export.page_html", lambda _: "the scene")
    scene = tmp_path / "run.html"
    assert run("view", "run.bag", "--export", scene).code == 0
    assert scene.read_text() == "the scene"
    scene.write_text("precious")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        answer = run("view", "run.bag", "--export", scene)
    assert answer.code == 2
    assert answer.sentence == f"longreach: {scene} cannot be written: No space left on device."
    assert scene.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [scene]


def test_a_page_is_opened_by_a_file_so_that_its_secret_is_in_no_list_of_processes(monkeypatch, tmp_path):
    opened, page = [], SimpleNamespace(gate=SimpleNamespace(address="http://127.0.0.1:8080/?secret=s3cret"))

    def look(address):
        file = Path(address.removeprefix("file://"))
        opened.append((address, file.read_text(), file.parent.stat().st_mode & 0o077))
        return True

    monkeypatch.setattr("webbrowser.open", look)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("longreach.view.page.close_page", lambda _: None)
    _serve(page, lambda until: None, True, None)
    ((address, text, others),) = opened
    assert "s3cret" not in address
    assert page.gate.address in text
    assert others == 0
    assert not list(tmp_path.iterdir())
