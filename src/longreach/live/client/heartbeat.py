"""A process that gives signs of life for a client whose own Python may be busy for longer than a robot waits.

A garbage collection, a compilation or a long computation in one process lets none of its threads run; the robot would
take the client for gone. This process has nothing else to do. It learns from a pipe that the client lives: a
client that is killed has closed it, and one that was halted, or has said nothing for `PATIENCE`, is not spoken for.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from longreach.live.protocol import transport
from longreach.live.protocol.message_header import pack_header, signed

BEAT = 0.02  # between two signs of life [s]
PATIENCE = 2.0  # with a client that says nothing, but runs [s]; ours
_LIVES, _RESTS, _READY = b"+", b"-", b"!"
_HALTED = ("T", "t", "Z", "X")  # states of a process in Linux' /proc that does not run on by itself


class Heartbeat:
    """The client's end of the pipe.

    settings: what `main` needs to know: where, the token, topic, payload and sender, and the key to sign with.
    """

    def __init__(self, settings: dict[str, Any]) -> None:
        start = f"import sys; sys.path[:] = {sys.path!r}; from longreach.live.client.heartbeat import main; main()"
        self._process = subprocess.Popen(
            [sys.executable, "-c", start], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from, self._ready = self._process.stdin, self._process.stdout, False
        self._to.write(json.dumps(settings).encode() + b"\n")
        for pipe in (self._to, self._from):
            os.set_blocking(pipe.fileno(), False)

    def beat(self) -> bool:
        """Say that the client lives; return whether the process tells the robot, else the client must do it itself."""
        self._say(_LIVES)
        self._ready = self._ready or bool(self._from.read(1))
        return self._ready and self._process.poll() is None

    def rest(self) -> None:
        """Let the process be silent until the next beat."""
        self._say(_RESTS)

    def _say(self, word: bytes) -> None:
        with suppress(OSError, ValueError):  # it has ended, or the pipe is closed
            self._to.write(word)

    def close(self) -> None:
        """End the process."""
        for pipe in (self._to, self._from):
            with suppress(OSError):
                pipe.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        self._process.kill()
        self._process.wait()


def main() -> None:
    """Be the process: connect, and give signs of life while the client does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is the client's to decide what an interrupt ends
    pipe = sys.stdin.buffer.raw  # type: ignore[attr-defined]
    settings, client = json.loads(_line(pipe)), os.getppid()
    heard = [time.monotonic()]
    threading.Thread(target=_listen, args=(pipe, heard), daemon=True).start()
    transport.PROTOCOL, topic, key = settings["protocol"], settings["topic"], settings["key"]
    certificates = None if settings["certificates"] is None else Path(settings["certificates"])
    session = transport.open_client(settings["address"], settings["token"], certificates, settings["timeout"])
    payload, nonce, sender = (bytes.fromhex(settings[name]) for name in ("payload", "nonce", "sender"))
    sys.stdout.buffer.write(_READY)
    sys.stdout.flush()
    while os.getppid() == client:
        time.sleep(BEAT)
        if time.monotonic() - heard[0] < PATIENCE and not _halted(client):
            header = pack_header(time.monotonic_ns(), sender)
            with suppress(transport.zenoh().ZError):  # the connection is down: it comes back by itself
                session.put(topic, payload, attachment=signed(key, nonce, topic, header, payload), express=True)


def _line(pipe: Any) -> bytes:
    """Return the first line in a pipe, and read nothing beyond it."""
    line = b""
    while not line.endswith(b"\n"):
        line += pipe.read(1) or os._exit(0)
    return line


def _listen(pipe: Any, heard: list[float]) -> None:
    """Note when the client said last that it lives; end where it is gone."""
    while said := pipe.read(4096):
        heard[0] = time.monotonic() if said.endswith(_LIVES) else 0.0
    os._exit(0)


def _halted(process: int) -> bool:
    """Return whether a process was stopped by somebody; where that cannot be seen, it was not."""
    with suppress(OSError, IndexError):
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] in _HALTED
    return False
