"""The command line, run in this process, and recordings as files for it."""

import pytest

from longreach.app import results
from longreach.cli.main import main
from longreach.io.bag_writer import write_bag
from longreach.io.config import load_description
from longreach.sim.kinematic import make_recording


class Answer:
    """What a command answered."""

    def __init__(self, code, captured):
        self.code, self.out, self.err = code, captured.out, captured.err

    @property
    def sentence(self):
        """The last line on standard error, which must be the only one that is no progress."""
        lines = self.err.splitlines()
        assert [line for line in lines if not line.endswith(" …")] == lines[-1:], self.err
        assert "Traceback" not in self.err
        return lines[-1]


@pytest.fixture
def run(capsys):
    def command(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as caught:
            main([str(a) for a in arguments])
        return Answer(caught.value.code or 0, capsys.readouterr())

    return command


@pytest.fixture(autouse=True)
def quick_pictures(monkeypatch):
    """Figures are made, but not painted."""
    monkeypatch.setattr(results.style, "png", lambda figure: b"picture")


@pytest.fixture(autouse=True)
def without_scene(monkeypatch):
    """No scene is made for the report, which takes a second: tests/view does that."""
    monkeypatch.setattr("longreach.view.export.add_to_report", lambda folder, run=None: False)


@pytest.fixture(scope="session")
def thing():
    return load_description("thing")


@pytest.fixture(scope="session")
def made(thing):
    return make_recording(thing, duration=1.0, lidar_rate=10.0, beams=60)


@pytest.fixture(scope="session")
def bags(made, thing, tmp_path_factory):
    """The same second of driving as each kind of bag."""
    folder = tmp_path_factory.mktemp("bags")
    for name in ("run.bag", "run.mcap", "run"):
        write_bag(folder / name, made, thing)
    return folder
