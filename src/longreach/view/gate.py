"""Who may speak to the page: a browser that was opened with the page's secret, and of its messages the usable ones.

viser's server answers every request and believes every message. Here each request has to name this machine (Host, or
else another name could be made to lead here), to come from the page itself (Origin), and to begin its path with the
secret; viser's client keeps the path of the page for its websocket. Each message is checked before viser sees it.
"""

import hmac
import logging
import math
import secrets
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http import HTTPStatus
from typing import Any

from longreach.errors import ConfigError
from longreach.rejection_counts import RejectionCounts

CONTROL = "/control"  # behind the secret: the websocket of control_channel.py
_NAMES = ("127.0.0.1", "localhost", "[::1]")  # of this machine, as an address in the browser has them
_LARGEST = 1 << 16  # bytes of a message; those of the page have a few hundred
_BOUND = 1e6  # of a number in a message
_PATCHING = threading.Lock()
_HEADERS = {  # the page loads nothing from elsewhere, speaks with nobody else, and is in nobody's frame
    "Content-Security-Policy": "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; connect-src 'self' "
    "ws://127.0.0.1:* ws://localhost:* data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
}
# What viser's client sends while one uses the page, and what each number or list of numbers in it has. All else that it
# could send is refused: files, pictures, and above all the request to publish the page through viser's share tunnel.
_MESSAGES: dict[str, dict[str, Any]] = {
    "ViewerCameraMessage": {
        "wxyz": 4, "position": 3, "fov": 1, "near": 1, "far": 1, "image_height": 1, "image_width": 1,
        "look_at": 3, "up_direction": 3,
    },
    "GuiUpdateMessage": {"uuid": str, "updates": dict},
    "CommandTriggerMessage": {"uuid": str},
    "TransformControlsUpdateMessage": {"name": str, "wxyz": 4, "position": 3, "owner": str},
    "TransformControlsDragStartMessage": {"name": str, "owner": str},
    "TransformControlsDragEndMessage": {"name": str, "owner": str},
}  # fmt: skip


class Rejected(Exception):
    """A request or message that is not accepted; its text is the reason, in a few words."""


@dataclass
class Gate:
    """What stands before a viser server: its secret, what it has refused, and who takes the control channel."""

    server: Any = None
    control: Callable[[Any], Awaitable[None]] | None = None
    secret: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    rejections: RejectionCounts = field(default_factory=lambda: RejectionCounts("longreach.view"))

    @property
    def address(self) -> str:
        """The page's address, with its secret."""
        return f"http://127.0.0.1:{self.server.get_port()}/{self.secret}/"

    def answer(self, serve_file: Callable[[Any, Any], Any], connection: Any, request: Any) -> Any:
        """Return the answer to a request, None where it becomes a websocket."""
        try:
            self._admit(connection.local_address[1], request)
            response = serve_file(connection, request)
        except Rejected as rejection:
            self.rejections.count(str(rejection), "the page")
            words = "This page opens only with the whole address that longreach view has printed.\n"
            response = connection.respond(HTTPStatus.FORBIDDEN, words)
        if response is not None:
            response.headers.update(_HEADERS)
        return response

    def _admit(self, port: int, request: Any) -> None:
        """Take the secret from a request's path.

        Raises:
            Rejected: it has none, or names another host, or comes from another page.
        """
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        host = hosts[0].lower() if len(hosts) == 1 else ""
        if host not in [f"{name}:{port}" for name in _NAMES]:
            raise Rejected("to another host")
        if origins != [f"http://{host}"] and (origins or request.headers.get_all("Upgrade")):
            raise Rejected("from another page")
        secret, _, rest = request.path.partition("?")[0].lstrip("/").partition("/")
        if not hmac.compare_digest(secret.encode(errors="replace"), self.secret.encode()):
            raise Rejected("without the secret")
        request.path = f"/{rest}"

    async def talk(self, handler: Callable[[Any], Awaitable[None]], connection: Any) -> None:
        """Let viser talk with a page, or the control channel."""
        if connection.request.path == CONTROL:
            if self.control is not None:
                await self.control(connection)
        else:
            connection.recv = partial(self._usable, connection.recv)
            await handler(connection)
        closing = connection.protocol.close_sent
        if closing is not None and closing.code == 1009:
            self.rejections.count("too large", "the page")

    async def _usable(self, receive: Callable[[], Awaitable[Any]]) -> bytes:
        """Return the next message that viser can be given."""
        while True:
            raw = await receive()
            try:
                check(self.server, raw)
                return raw
            except Exception as rejection:  # what nobody has thought of is unusable, too: it came from outside
                reason = str(rejection) if isinstance(rejection, Rejected) else "malformed"
                self.rejections.count(reason, "the page")

    def is_news(self, record: logging.LogRecord) -> bool:
        """Whether a line of the log is worth one; what is no request at all is counted instead."""
        error = None if record.exc_info is None else record.exc_info[1]
        if record.getMessage() != "opening handshake failed" or error is None or error.__cause__ is None:
            return True
        if not isinstance(error.__cause__, EOFError):  # browsers open connections and leave them
            self.rejections.count("not a request", "the page")
        return False


@contextmanager
def guarded(gate: Gate) -> Iterator[None]:
    """Put a gate before the viser server that is started meanwhile.

    viser 1.1 gives no access to its websocket server. What we use of it: `viser.infra.WebsockServer` calls
    `websockets.asyncio.server.serve(handler, host, port, process_request=…, max_size=…)` in a thread, before
    `viser.ViserServer()` returns; its handler takes messages by `connection.recv()`. We replace `serve` meanwhile.

    Raises:
        ConfigError: viser has not called it, the page would be open to everybody.
    """
    from websockets.asyncio import server as websockets_server

    serve, called = websockets_server.serve, []
    logger = logging.Logger("longreach.view.requests")  # one for each server
    logger.parent = logging.getLogger("longreach.view")
    logger.addFilter(gate.is_news)

    def serve_guarded(handler: Any, *args: Any, process_request: Any, **options: Any) -> Any:
        called.append(True)
        options |= {"process_request": partial(gate.answer, process_request), "max_size": _LARGEST, "logger": logger}
        return serve(partial(gate.talk, handler), *args, **options)

    with _PATCHING:
        websockets_server.serve = serve_guarded  # type: ignore[assignment]
        try:
            yield
        finally:
            websockets_server.serve = serve
    if not called:
        raise ConfigError("This version of viser cannot be protected from strangers; install viser 1.1.")


def check(server: Any, raw: Any) -> None:
    """Check a message of viser's client: whole, of a kind that the page uses, finite, and of something that is shown.

    Raises:
        Rejected: it is none of that.
    """
    from msgspec import msgpack  # viser's own

    message = msgpack.decode(raw) if isinstance(raw, bytes) else None
    if not isinstance(message, dict):
        raise Rejected("malformed")
    fields = _MESSAGES.get(message.pop("type", ""))
    if fields is None:
        raise Rejected("of a kind that the page does not use")
    if message.keys() | {"owner"} != fields.keys() | {"owner"}:
        raise Rejected("malformed")
    for name, value in message.items():
        if not (_numbers(value, fields[name]) if isinstance(fields[name], int) else isinstance(value, fields[name])):
            raise Rejected("malformed")
    if "wxyz" in message and not 0.99 < math.hypot(*message["wxyz"]) < 1.01:
        raise Rejected("malformed")
    _check_target(server, message)


def _numbers(value: Any, count: int) -> bool:
    """Whether it is one number, or a list of so many, each finite and within bounds."""
    values = [value] if count == 1 else value
    if not isinstance(values, list | tuple) or len(values) != count:
        return False
    return all(isinstance(x, int | float) and not isinstance(x, bool) and -_BOUND < x < _BOUND for x in values)


def _check_target(server: Any, message: dict[str, Any]) -> None:
    """Check that a message is about something that is there, and that its value is one that it can have.

    viser keeps its elements by the name that messages give them, in the three dictionaries that are used here.
    """
    if "name" in message:
        if message["name"] not in server.scene._handle_from_transform_controls_name:
            raise Rejected("of something unknown")
    elif "updates" in message:
        handle = server.gui._gui_input_handle_from_uuid.get(message["uuid"])
        if handle is None or handle.disabled or not handle.visible:
            raise Rejected("of something unknown")
        if message["updates"].keys() != {"value"} or not _can_be(handle, message["updates"]["value"]):
            raise Rejected("malformed")
    elif "uuid" in message and message["uuid"] not in server.gui._command_handle_from_uuid:
        raise Rejected("of something unknown")


def _can_be(handle: Any, value: Any) -> bool:
    """Whether an element's value can be this: of a button or box, of a slider, of a list to choose from."""
    if isinstance(handle.value, bool):
        return isinstance(value, bool)
    if isinstance(handle.value, int | float):
        return _numbers(value, 1) and handle.min <= value <= handle.max
    return isinstance(value, str) and value in handle.options
