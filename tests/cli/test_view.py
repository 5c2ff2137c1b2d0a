"""longreach view, where no page is served: tests/view looks at pages."""

import errno
from pathlib import Path


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
