"""The line from a client to a robot: sends, asks and gets answers, gives signs of life, compares clocks."""

import secrets
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from longreach.errors import LiveError
from longreach.io import messages
from longreach.live import keys, orders
from longreach.live.keys import TYPES, Topic
from longreach.live.link import authentication, open_client

_ANSWER = 2.0  # for how long an answer is waited for [s]
_BEAT = 0.02  # between two signs of life of a client that holds the robot [s]
_DOUBT = 2.0  # for how long we believe that we hold the robot where it does not say so [s]
_PINGS, _PING_EVERY = 20, 1.0  # of how many the fastest tells the offset of the clocks; from one to the next [s]


class Line:
    """A connection with a robot."""

    def __init__(self, address: str, token: str | None, certificates: Path | None, timeout: float) -> None:
        self.session = open_client(address, token, certificates, timeout)
        self.sender, self._token, self._nonce, self._number = secrets.token_bytes(16), token, b"", 0
        self._lock, self._closed = Lock(), Event()
        self._pings: deque[tuple[float, float]] = deque(maxlen=_PINGS)  # how long each took, and the offset [s]
        self.holds, self._sure = False, 0.0  # when the robot said last that we do, by time.monotonic() [s]
        self.confirmed: Callable[[], bool] = lambda: False
        self._threads = [Thread(target=run, daemon=True) for run in (self._beat, self._compare_clocks)]

    def start(self) -> None:
        """Compare the clocks, and give signs of life from now on."""
        for _ in range(3):
            self.ping()
        for thread in self._threads:
            thread.start()

    @property
    def offset(self) -> float:
        """The robot's clock less `time.time()` of this machine [s], by the ping that came back fastest."""
        return min(self._pings)[1] if self._pings else 0.0

    @property
    def now(self) -> float:
        """The time on the robot's clock [s]."""
        return max(time.time() + self.offset, 0.0)

    def lasting(self, topic: Topic) -> Any:
        """Return the message of a topic that is said once and lasts, or None where there is none."""
        for reply in self.session.get(topic.key, timeout=_ANSWER):
            sample = reply.ok
            if sample is None or len(sample.payload) > topic.limit or sample.attachment is None:
                continue
            self._nonce = keys.attached(bytes(sample.attachment))[0].sender
            return topic.unpack(bytes(sample.payload))
        return None

    def send(self, topic: Topic, message: Any) -> None:
        """Send a message that nobody answers."""
        payload = topic.pack(message)
        with self._lock:  # so that numbers arrive in their order
            self.session.put(topic.key, payload, attachment=self._signed(topic, payload), express=True)

    def ask(self, topic: Topic, message: Any, sent: Callable[[], None] = lambda: None) -> str:
        """Send a message and return its answer; `sent` is called as soon as it is on its way.

        Raises:
            LiveError: there is no answer, or the robot refuses.
        """
        payload = topic.pack(message)
        with self._lock:
            attachment = self._signed(topic, payload)
            replies = self.session.get(topic.key, payload=payload, attachment=attachment, timeout=_ANSWER)
        sent()
        for reply in replies:
            if reply.ok is None or len(reply.ok.payload) > keys.ORDER.limit:
                continue
            answer = keys.ORDER.unpack(bytes(reply.ok.payload)).data
            if answer.startswith("refused: "):
                raise LiveError(answer.removeprefix("refused: "))
            return answer
        raise LiveError(f"The robot has not answered within {_ANSWER:g} s; look whether it is still there.")

    def take(self, name: str) -> None:
        """Ask for the robot, and give signs of life from then on: the answer may be long under way.

        Raises:
            LiveError: another client holds it.
        """

        def sent() -> None:
            self._sure = time.monotonic()
            self.holds = True

        try:
            self.ask(keys.ORDER, TYPES["std_msgs/msg/String"](f"take {name}"), sent)
        except LiveError:
            self.holds = False
            raise

    def order(self, words: str) -> str:
        """Ask for what a few words say."""
        return self.ask(keys.ORDER, TYPES["std_msgs/msg/String"](words))

    def _signed(self, topic: Topic, payload: bytes) -> bytes:
        self._number += 1
        attachment = keys.attach(self._number, self.sender)
        if self._token is None:
            return attachment
        return attachment + authentication(self._token, self._nonce, topic.key, attachment, payload)

    def ping(self) -> None:
        """Compare the clocks once: ours halfway between question and answer is the robot's in the answer."""
        header, Time = messages.header(TYPES, time.time(), ""), TYPES["builtin_interfaces/msg/Time"]
        asked = TYPES["sensor_msgs/msg/TimeReference"](header, Time(header.stamp.sec, header.stamp.nanosec), "client")
        sent = time.time()
        for reply in self.session.get(keys.CLOCK.key, payload=keys.CLOCK.pack(asked), timeout=_ANSWER):
            if reply.ok is not None:
                took = time.time() - sent
                answer = keys.CLOCK.unpack(bytes(reply.ok.payload))
                self._pings.append((took, orders.stamp_of(answer) - (sent + 0.5 * took)))

    def _compare_clocks(self) -> None:
        while not self._closed.wait(_PING_EVERY):
            self._quietly(self.ping)

    def _beat(self) -> None:
        """Give signs of life while we hold the robot, and see when it has been given to somebody else, or to nobody."""
        while not self._closed.wait(_BEAT):
            now = time.monotonic()
            if self.confirmed():
                self._sure = now
            if self.holds and now - self._sure > _DOUBT:
                self.holds = False
            if self.holds:
                self._quietly(lambda: self.send(keys.HEARTBEAT, messages.header(TYPES, self.now, "")))

    def _quietly(self, do: Any) -> None:
        """Do what may fail while the connection is down: it comes back by itself."""
        try:
            do()
        except Exception:
            if not self._closed.is_set() and self.session.is_closed():
                self._closed.set()

    def close(self) -> None:
        """Hang up."""
        self._closed.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(2.0 * _ANSWER)
        self.session.close()
