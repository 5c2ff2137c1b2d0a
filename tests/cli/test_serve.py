"""longreach serve, connect and view: what is wrong with their options is said at once; tokens come from files."""

import os

import pytest

from longreach.cli.options import WATCHER_TOKEN, read_token
from longreach.errors import ConfigError


@pytest.fixture
def token(tmp_path):
    path = tmp_path / "operator.token"
    path.write_text("correct horse\nwhat follows is for people\n")
    path.chmod(0o600)
    return path


def test_a_token_is_the_first_line_of_its_file_or_what_the_environment_says(token, monkeypatch):
    monkeypatch.setenv("LONGREACH_TOKEN", "of the environment")
    monkeypatch.delenv(WATCHER_TOKEN, raising=False)
    assert read_token(token) == "correct horse"
    assert read_token(None) == "of the environment"
    assert read_token(None, WATCHER_TOKEN) is None


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620])
def test_a_token_that_others_can_read_or_change_is_refused(token, mode):
    token.chmod(mode)
    with pytest.raises(ConfigError, match=rf"Others can read the token in .*; run: chmod 600 {token}"):
        read_token(token)


def test_an_empty_token_is_refused(token):
    token.write_text("\ncorrect horse")
    with pytest.raises(ConfigError, match=r"The first line of .* is empty; write the token there"):
        read_token(token)


@pytest.mark.parametrize(
    "words", [["serve", "--token-file"], ["connect", "--token-file"], ["view", "--connect", "a:1", "--token-file"]]
)
def test_every_verb_of_the_network_refuses_a_token_that_others_can_read(run, token, words):
    token.chmod(0o644)
    answer = run(*words, token)
    assert answer.code == 2
    assert "Others can read the token" in answer.sentence


@pytest.mark.parametrize("verb", ["serve", "connect", "view"])
def test_no_token_is_taken_on_the_command_line(run, verb):
    assert "No such option: --token" in run(verb, "--token", "correct horse").err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--robot", "husky"], "husky is none; simulate it without forces (--hardware kinematic)"),
        (["--hardware", "real"], "There is no hardware 'real'; there are sim, kinematic and ros."),
        (["--world", "moon"], "moon is neither a world that longreach knows"),
        (["--floor", "icy"], "A floor is one of good, worn, wet, slippery, or a friction above 0, but not 'icy'."),
        (["--hardware", "kinematic", "--floor", "wet"], "A kinematic robot slips alike on every floor"),
        (["--hardware", "ros", "--world", "office"], "A robot of ROS has a world and a floor of its own"),
        (["--hardware", "ros", "--seed", "0"], "Nothing of a robot of ROS is random here; leave out --seed."),
        (["--no-scans"], "A robot with physics has its laser always; take --hardware kinematic, or leave out"),
        (["--address", "0.0.0.0:7447"], "can be reached from other machines: give --certificates"),
        (["--address", "nowhere"], "write it as host:port"),
        (["--certificates", "nowhere"], "The folder of certificates nowhere has no server.key."),
        (["--record", "a.bag"], "Nothing can be recorded into a.bag: end it with .mcap."),
        (["--record", "a"], "Nothing can be recorded into a: end it with .mcap."),
        (["--record", "there.mcap"], "The folder there.mcap is there already"),
    ],
)
def test_wrong_options_of_serve_are_refused_before_anything_that_takes_time(
    run, monkeypatch, tmp_path, words, sentence
):
    def never(*_):
        raise AssertionError("it has begun already")

    monkeypatch.setattr("longreach.app.warmup.warm_up", never)
    monkeypatch.setattr("longreach.live.server.serving.rehearse", never)
    for name in ("LONGREACH_TOKEN", WATCHER_TOKEN):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.mcap").mkdir()
    answer = run("serve", *words)
    assert answer.code == 2
    assert sentence in answer.sentence


@pytest.mark.parametrize("operators", ["", "the same"])
def test_a_watchers_token_needs_an_operators_that_is_another_one(run, monkeypatch, operators):
    monkeypatch.setitem(os.environ, "LONGREACH_TOKEN", operators)
    monkeypatch.setitem(os.environ, WATCHER_TOKEN, "the same")
    answer = run("serve", "--hardware", "kinematic")
    assert answer.code == 2
    assert "A watcher's token comes beside an operator's, and is another one: give both." in answer.sentence
