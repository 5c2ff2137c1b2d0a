"""The connection from a client to a robot: sends, asks and gets answers, gives signs of life, compares clocks."""

import secrets
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

import yaml

from longreach.errors import LiveError
from longreach.io import messages
from longreach.io.config import validated
from longreach.live.client.heartbeat import BEAT, Heartbeat
from longreach.live.protocol import commands, topics, transport
from longreach.live.protocol.message_header import pack_header, signed, unpack_header
from longreach.live.protocol.topics import TYPES, Topic
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator

_ANSWER = 2.0  # for how long an answer is waited for [s]
_WORDS = 200  # characters of an order that a robot reads
_UNCONFIRMED = 2.0  # for how long we believe that we hold the robot where it does not say so [s]
_PINGS, _PING_EVERY = 20, 1.0  # of how many the fastest tells the offset of the clocks; from one to the next [s]


@contextmanager
def explained() -> Iterator[None]:
    """Say in a LiveError what zenoh says of a connection that is closed, or was lost for good."""
    try:
        yield
    except transport.zenoh().ZError as error:
        raise LiveError("The connection with the robot is closed; connect again.") from error


def _packed(topic: Topic, message: Any) -> bytes:
    try:
        payload = topic.pack(message)
    except Exception as error:  # it has what CDR does not, such as half of a character
        raise LiveError(f"What was to be sent on {topic.name} cannot be written as a message.") from error
    if len(payload) > topic.limit:
        raise LiveError(f"What was to be sent on {topic.name} has {len(payload)} bytes, of {topic.limit} at most.")
    return payload


def _unpacked(topic: Topic, payload: Any) -> Any:
    try:
        return topic.unpack(bytes(payload))
    except Exception as error:
        raise LiveError(f"The robot's message on {topic.name} cannot be read; is this a longreach server?") from error


class Connection:
    """A connection with a robot. All that fails in it is a LiveError."""

    def __init__(self, address: str, token: str | None, certificates: Path | None, timeout: float) -> None:
        self.session = transport.open_client(address, token, certificates, timeout)
        self._key = self._role_key() if token is None and certificates is not None else token
        self._where = {"address": address, "token": token, "timeout": timeout, "protocol": transport.PROTOCOL}
        self._where["certificates"] = None if certificates is None else str(certificates)
        self._heartbeat: Heartbeat | None = None
        self.sender, self._nonce, self._number = secrets.token_bytes(16), b"", 0
        self._lock, self._closed = Lock(), Event()
        self._pings: deque[tuple[float, float]] = deque(maxlen=_PINGS)  # how long each took, and the offset [s]
        self.holds, self._sure = False, 0.0  # when the robot said last that we do, by time.monotonic() [s]
        self.confirmed: Callable[[], bool] = lambda: False
        self._threads = [Thread(target=run, daemon=True) for run in (self._beat, self._compare_clocks)]

    def _role_key(self) -> str | None:
        """Return what a server with certificates lets us sign with by ours: an operator's key, or a watcher's."""
        replies = [reply.ok for reply in self.session.get(f"{transport.ROLE_KEYS}/*", timeout=_ANSWER)]
        keys = {str(one.key_expr).split("/")[-1]: bytes(one.payload).decode() for one in replies if one is not None}
        return keys.get(transport.OPERATOR, keys.get(transport.WATCHER))

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

    @cached_property
    def role(self) -> str:
        """What the robot takes us for, operator or watcher; it is asked once. Raises LiveError: no answer."""
        return self.order("role")

    @property
    def now(self) -> float:
        """The time on the robot's clock [s]."""
        return max(time.time() + self.offset, 0.0)

    def lasting(self, topic: Topic) -> Any:
        """Return the message of a topic that is said once and lasts, or None where there is none."""
        with explained():
            replies = self.session.get(topic.key, timeout=_ANSWER)
        for reply in replies:
            sample = reply.ok
            if sample is None or len(sample.payload) > topic.limit or sample.attachment is None:
                continue
            with suppress(ValueError):
                self._nonce = unpack_header(bytes(sample.attachment))[0].sender
                return _unpacked(topic, sample.payload)
        return None

    def send(self, topic: Topic, message: Any) -> None:
        """Send a message that nobody answers."""
        payload = _packed(topic, message)
        with self._lock, explained():  # so that numbers arrive in their order
            self.session.put(topic.key, payload, attachment=self._signed(topic, payload), express=True)

    def ask(self, topic: Topic, message: Any, sent: Callable[[], None] = lambda: None) -> str:
        """Send a message and return its answer; `sent` is called as soon as it is on its way.

        Raises:
            LiveError: there is no answer, or the robot refuses.
        """
        payload = _packed(topic, message)
        with self._lock, explained():
            header = self._signed(topic, payload)
            replies = self.session.get(topic.key, payload=payload, attachment=header, timeout=_ANSWER)
        sent()
        for reply in replies:
            if reply.ok is None or len(reply.ok.payload) > topics.ORDER.limit:
                continue
            answer = _unpacked(topics.ORDER, reply.ok.payload).data
            if answer.startswith("refused: "):
                raise LiveError(_sentence(answer.removeprefix("refused: ")))
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
            self.order(f"take {name}", sent)
        except LiveError:
            self.holds = False
            raise

    def release(self) -> None:
        """Let go of the robot, and give no more signs of life."""
        self.holds = False
        if self._heartbeat is not None:
            self._heartbeat.rest()
        self.order("release")

    def order(self, words: str, sent: Callable[[], None] = lambda: None) -> str:
        """Ask for what a few words say; a stop gets through whatever its reason holds."""
        writable = words[:_WORDS].encode("utf-8", "replace").decode("utf-8")
        return self.ask(topics.ORDER, TYPES["std_msgs/msg/String"](writable), sent)

    def _signed(self, topic: Topic, payload: bytes) -> bytes:
        """Return the header of a payload; numbers are of the machine's clock, as those of our heartbeat are."""
        self._number = max(self._number + 1, time.monotonic_ns())
        header = pack_header(self._number, self.sender)
        return signed(self._key, self._nonce, topic.key, header, payload)

    def ping(self) -> None:
        """Compare the clocks once: ours halfway between question and answer is the robot's in the answer."""
        header, Time = messages.header(TYPES, time.time(), ""), TYPES["builtin_interfaces/msg/Time"]
        asked = TYPES["sensor_msgs/msg/TimeReference"](header, Time(header.stamp.sec, header.stamp.nanosec), "client")
        sent = time.time()
        with explained():
            replies = self.session.get(topics.CLOCK.key, payload=topics.CLOCK.pack(asked), timeout=_ANSWER)
        for reply in replies:
            if reply.ok is not None:
                took = time.time() - sent
                answer = _unpacked(topics.CLOCK, reply.ok.payload)
                self._pings.append((took, commands.stamp_of(answer) - (sent + 0.5 * took)))

    def _compare_clocks(self) -> None:
        while not self._closed.wait(_PING_EVERY):
            self._quietly(self.ping)

    def _beat(self) -> None:
        """Give signs of life while we hold the robot, and see when it has been given to somebody else, or to nobody."""
        while not self._closed.wait(BEAT):
            now = time.monotonic()
            if self.confirmed():
                self._sure = now
            if self.holds and now - self._sure > _UNCONFIRMED:
                self.holds = False
            if self.holds and not self._beats_by_itself():
                self._quietly(lambda: self.send(topics.HEARTBEAT, messages.header(TYPES, self.now, "")))
            elif self._heartbeat is not None and not self.holds:
                self._heartbeat.rest()

    def _beats_by_itself(self) -> bool:
        """Whether our pulse, a process that has nothing else to do, gives the signs of life."""
        if self._heartbeat is None:
            payload = topics.HEARTBEAT.pack(messages.header(TYPES, 0.0, ""))
            known = {"payload": payload.hex(), "nonce": self._nonce.hex(), "sender": self.sender.hex()}
            known |= {"topic": topics.HEARTBEAT.key, "key": self._key}
            with suppress(OSError):  # it cannot be started here
                self._heartbeat = Heartbeat({**self._where, **known})
        return self._heartbeat is not None and self._heartbeat.beat()

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
        if self._heartbeat is not None:
            self._heartbeat.close()
        with suppress(transport.zenoh().ZError):
            self.session.close()


def _sentence(reason: str) -> str:
    """Return why the robot has refused something as a sentence, which some reasons are already."""
    return reason if reason.endswith(".") else f"The robot refuses what is {reason}."


def read_description(connection: Connection) -> MobileManipulator:
    """Return the robot that a server describes.

    Raises:
        LiveError: it describes none.
    """
    description, urdf = connection.lasting(topics.DESCRIPTION), connection.lasting(topics.URDF)
    if description is None or urdf is None:
        raise LiveError("The robot does not describe itself; is this a longreach server?")
    try:
        known = yaml.safe_load(description.data)
    except yaml.YAMLError as error:
        raise LiveError("The robot's description is not YAML; is this a longreach server?") from error
    model = validated(RobotDescription, known, "the robot's description")
    with tempfile.TemporaryDirectory() as folder:
        if model.arm is not None and model.arm.urdf is not None:  # wherever the server has it, not there
            model = model.model_copy(update={"arm": model.arm.model_copy(update={"urdf": "robot.urdf"})})
            (Path(folder) / "robot.urdf").write_text(urdf.data, encoding="utf-8")
        return MobileManipulator.from_description(model, Path(folder))
