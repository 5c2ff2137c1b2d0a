"""The line from a client to a robot: sends, asks and gets answers, gives signs of life, compares clocks."""

import secrets
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from longreach.errors import LiveError
from longreach.io import messages
from longreach.live import keys, link, orders
from longreach.live.attachment import attach, attached, signed
from longreach.live.keys import TYPES, Topic
from longreach.live.pulse import BEAT, Pulse

_ANSWER = 2.0  # for how long an answer is waited for [s]
_DOUBT = 2.0  # for how long we believe that we hold the robot where it does not say so [s]
_PINGS, _PING_EVERY = 20, 1.0  # of how many the fastest tells the offset of the clocks; from one to the next [s]


class Line:
    """A connection with a robot."""

    def __init__(self, address: str, token: str | None, certificates: Path | None, timeout: float) -> None:
        self.session = link.open_client(address, token, certificates, timeout)
        self._where = {"address": address, "token": token, "timeout": timeout, "protocol": link.PROTOCOL}
        self._where["certificates"] = None if certificates is None else str(certificates)
        self._pulse: Pulse | None = None
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
            self._nonce = attached(bytes(sample.attachment))[0].sender
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

    def release(self) -> None:
        """Let go of the robot, and give no more signs of life."""
        self.holds = False
        if self._pulse is not None:
            self._pulse.rest()
        self.order("release")

    def order(self, words: str) -> str:
        """Ask for what a few words say."""
        return self.ask(keys.ORDER, TYPES["std_msgs/msg/String"](words))

    def _signed(self, topic: Topic, payload: bytes) -> bytes:
        """Return the attachment of a payload; numbers are of the machine's clock, as those of our pulse are."""
        self._number = max(self._number + 1, time.monotonic_ns())
        attachment = attach(self._number, self.sender)
        return signed(self._token, self._nonce, topic.key, attachment, payload)

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
        while not self._closed.wait(BEAT):
            now = time.monotonic()
            if self.confirmed():
                self._sure = now
            if self.holds and now - self._sure > _DOUBT:
                self.holds = False
            if self.holds and not self._beats_by_itself():
                self._quietly(lambda: self.send(keys.HEARTBEAT, messages.header(TYPES, self.now, "")))
            elif self._pulse is not None and not self.holds:
                self._pulse.rest()

    def _beats_by_itself(self) -> bool:
        """Whether our pulse, a process that has nothing else to do, gives the signs of life."""
        if self._pulse is None:
            payload = keys.HEARTBEAT.pack(messages.header(TYPES, 0.0, ""))
            told = {"payload": payload.hex(), "nonce": self._nonce.hex(), "sender": self.sender.hex()}
            with suppress(OSError):  # it cannot be started here
                self._pulse = Pulse({**self._where, **told, "key": keys.HEARTBEAT.key})
        return self._pulse is not None and self._pulse.beat()

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
        if self._pulse is not None:
            self._pulse.close()
        self.session.close()
