"""The page's own websocket: STOP, the keys and buttons that are held, and signs of life both ways.

viser's messages queue behind each other, and its hotkeys are dead while a field has the focus. `control.js` in the page
sends {"held": "IU"} every 100 ms and at once when that changes, and {"stop": 1}; each is answered at once with the age
of the robot's newest state, a stop also when the robot has confirmed it.
"""

import asyncio
import json
import threading
import time
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from longreach.rejection_counts import RejectionCounts
from longreach.view.robot_client import RobotClient

# Not W A S D Q E nor the arrows: with those viser moves the camera.
KEYS = {"I": (1, 0, 0), "K": (-1, 0, 0), "J": (0, 1, 0), "L": (0, -1, 0), "U": (0, 0, 1), "O": (0, 0, -1)}
_TURN = 1.5  # how much faster it turns than it drives [rad/m]
_PERIOD = 0.04  # [s] between two twists
_SILENT = 0.25  # [s] after which a page that says nothing holds no key


class ControlChannel:
    """What pages ask of a robot: `serve` hears them, `drive` sends twists while a key is held, and a hold after it.

    pace: returns how fast a key drives [m/s]; command: does what moves the robot, or says why not, and returns whether.
    """

    def __init__(
        self,
        client: RobotClient,
        rejections: RejectionCounts,
        pace: Callable[[], float],
        command: Callable[[Callable[[], None]], bool],
    ) -> None:
        self._client, self._rejections, self._pace, self._command = client, rejections, pace, command
        self._held: dict[Hashable, tuple[str, float]] = {}  # of each page: its keys, and when it said so
        self._changed = threading.Event()
        self._stops = ThreadPoolExecutor(4, "stop")  # of its own: a stop waits for nothing else that the page asks

    async def serve(self, connection: Any) -> None:
        """Hear one page until it is closed."""
        from websockets.exceptions import ConnectionClosed

        stopping: set[asyncio.Task[None]] = set()
        try:
            while True:
                message = parse(await connection.recv())
                if message is None:
                    self._rejections.count("malformed", "the page's control channel")
                    continue
                keys, stop = message
                self.hold(connection.id, keys)
                if stop:
                    task = asyncio.ensure_future(self._stop(connection))
                    stopping.add(task)
                    task.add_done_callback(stopping.discard)
                await connection.send(json.dumps({"age": round(self._client.age, 3)}))
        except ConnectionClosed:
            pass
        finally:
            self.hold(connection.id, "")

    def hold(self, page: Hashable, keys: str) -> None:
        """Take what a page holds now; the thread that drives wakes where that has changed."""
        before, _ = self._held.get(page, ("", 0.0))
        if keys:
            self._held[page] = keys, time.monotonic()
        else:
            self._held.pop(page, None)
        if keys != before:
            self._changed.set()

    async def _stop(self, connection: Any) -> None:
        """Stop the robot, and say whether it has confirmed that."""
        from websockets.exceptions import ConnectionClosed

        try:
            await asyncio.get_running_loop().run_in_executor(self._stops, self._client.stop)
            answer = {"stopped": True}
        except Exception as error:  # whatever it is, the page must say that the robot has not stopped
            answer = {"stopped": False, "why": str(error)[:300]}
        with suppress(ConnectionClosed):
            await connection.send(json.dumps(answer))

    def twist(self) -> np.ndarray | None:
        """Return the sum of what is held, None where nothing is."""
        since = time.monotonic() - _SILENT
        keys = {key for held, heard in tuple(self._held.values()) if heard > since for key in held}
        if not keys:
            return None
        return self._pace() * np.sum([KEYS[key] for key in keys], axis=0) * [1.0, 1.0, _TURN]

    def drive(self, until: threading.Event) -> None:
        """Drive as what is held says, and stand as soon as nothing is, until the event is set."""
        driving = failed = False
        while not until.is_set():
            self._changed.wait(_PERIOD)
            self._changed.clear()
            twist = self.twist()
            failed = failed and twist is not None  # after an error keys have to be released first
            if twist is not None and not failed:
                driving = self._command(partial(self._client.velocity, base=twist))
                failed = not driving
            elif driving:
                driving = False
                self._stand()
        if driving:
            self._stand()

    def _stand(self) -> None:
        with suppress(Exception):  # whatever it is: a base that is sent nothing stands by itself
            self._client.hold()


def parse(raw: Any) -> tuple[str, bool] | None:
    """Return the keys that a message says are held, and whether it says stop; None where it is unusable."""
    if not isinstance(raw, str) or len(raw) > 100:
        return None
    try:
        message = json.loads(raw)
    except ValueError:
        return None
    if message == {"stop": True}:
        return "", True
    keys = message.get("held") if isinstance(message, dict) and len(message) == 1 else None
    if not isinstance(keys, str) or len(set(keys)) < len(keys) or not set(keys) <= KEYS.keys():
        return None
    return keys, False
