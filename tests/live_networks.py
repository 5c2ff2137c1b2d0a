"""A robot that is served by a process of its own, and networks between it and a client that misbehave."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

# Shapes are not checked in the server's process, where that is too slow. UDP has no option: it is for tests alone.
_SERVE = "import sys; from longreach.live.protocol import transport; transport.PROTOCOL = sys.argv.pop(1); \
from longreach.cli.main import main; main(sys.argv[1:])"


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class Served:
    """`longreach serve` with a simulated Thing, without scans. tokens: the operators' and the watchers'."""

    def __init__(self, folder, *options, protocol="tcp", tokens=(), before=""):
        self.port, self.fresh = free_port(), True  # fresh: nobody has asked it for anything
        self.address = f"127.0.0.1:{self.port}"
        self.log = Path(folder) / f"server-{self.port}.log"
        command = ["serve", "--hardware", "kinematic", "--no-scans", "--address", self.address, *options]
        known = dict(zip(("LONGREACH_TOKEN", "LONGREACH_WATCHER_TOKEN"), tokens, strict=False))
        program = [sys.executable, "-c", before + _SERVE, protocol, *map(str, command)]
        with self.log.open("w") as log:
            self.process = subprocess.Popen(program, stdout=log, stderr=subprocess.STDOUT, env={**os.environ, **known})

    def ready(self):
        until = time.monotonic() + 60.0
        while "Serving" not in self.output:
            assert self.process.poll() is None, self.output
            assert time.monotonic() < until, self.output
            time.sleep(0.05)
        return self

    @property
    def output(self):
        return self.log.read_text()

    def end(self):
        """End it as an operator does, and return what it said."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        self.process.wait(20.0)
        return self.output


class Network:
    """A network between a client and a server, TCP, that can be slow or cut."""

    def __init__(self, port):
        self.to, self.port, self.delay, self.cut = port, free_port(), 0.0, False
        self._loop, self._ready = asyncio.new_event_loop(), threading.Event()
        threading.Thread(target=self._run, daemon=True).start()
        assert self._ready.wait(5.0)
        self.address = f"127.0.0.1:{self.port}"

    def _run(self):
        asyncio.set_event_loop(self._loop)
        self._server = self._loop.run_until_complete(asyncio.start_server(self._join, "127.0.0.1", self.port))
        self._ready.set()
        self._loop.run_forever()

    async def _join(self, reader, writer):
        other_reader, other_writer = await asyncio.open_connection("127.0.0.1", self.to)
        await asyncio.gather(self._carry(reader, other_writer), self._carry(other_reader, writer))

    async def _carry(self, reader, writer):
        waiting = asyncio.Queue()

        async def deliver():
            while True:
                when, data = await waiting.get()
                await asyncio.sleep(max(when - time.monotonic(), 0.0))
                while self.cut:
                    await asyncio.sleep(0.01)
                writer.write(data)

        task = asyncio.ensure_future(deliver())
        try:
            while data := await reader.read(1 << 16):
                waiting.put_nowait((time.monotonic() + self.delay, data))
        except ConnectionError:
            pass
        task.cancel()
        writer.close()


class Lossy:
    """A network between clients and a server, UDP, that loses some of the datagrams."""

    def __init__(self, port, lost, seed=0):
        self._near, self._server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), ("127.0.0.1", port)
        self._near.bind(("127.0.0.1", 0))
        self.port, self.lost, self.dropped = self._near.getsockname()[1], 0.0, 0
        self.part, self._rng, self._far = lost, np.random.default_rng(seed), {}
        self.address = f"127.0.0.1:{self.port}"
        self._carry(self._near, lambda data, client: self._to(client).sendto(data, self._server))

    def _to(self, client):
        """The socket by which the server sees a client, and answers it."""
        if client not in self._far:
            self._far[client] = far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            far.bind(("127.0.0.1", 0))
            self._carry(far, lambda data, _: self._near.sendto(data, client))
        return self._far[client]

    def _carry(self, near, give):
        threading.Thread(target=self._run, args=(near, give), daemon=True).start()

    def _run(self, near, give):
        while True:
            try:
                data, sender = near.recvfrom(1 << 16)
                if self._rng.random() < self.lost:
                    self.dropped += 1
                    continue
                give(data, sender)
            except OSError:
                return


def until(condition, timeout=5.0):
    """Wait for something to be so, and return how long that took [s]."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < timeout, "it did not come about in time"
        time.sleep(0.01)
    return time.monotonic() - began
