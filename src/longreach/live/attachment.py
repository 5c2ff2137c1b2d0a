"""What is attached to a message, as rmw_zenoh lays it out, and the HMAC behind it; loads nothing that takes time.

Source: rmw_zenoh, attachment_helpers: the number of the message, the time of sending [ns] and who sent it.
"""

import hashlib
import hmac
import struct
import time
from typing import NamedTuple

_ATTACHED = struct.Struct("<qqB16s")  # the 1 byte is the length of what follows
MAC_SIZE = 16


class Attached(NamedTuple):
    """What comes with a message: its number from its sender on, when it was sent [ns], by whom (16 bytes)."""

    number: int
    sent_ns: int
    sender: bytes


def attach(number: int, sender: bytes) -> bytes:
    """Return the attachment of a message that is sent now."""
    return _ATTACHED.pack(number, time.time_ns(), 16, sender)


def attached(data: bytes) -> tuple[Attached, bytes]:
    """Return what an attachment says, and what follows it: the message's authentication, or nothing.

    Raises:
        ValueError: it is none.
    """
    if len(data) not in (_ATTACHED.size, _ATTACHED.size + MAC_SIZE):
        raise ValueError("not an attachment")
    number, sent_ns, length, sender = _ATTACHED.unpack_from(data)
    if length != 16:
        raise ValueError("not an attachment")
    return Attached(number, sent_ns, sender), data[_ATTACHED.size :]


def signed(token: str | None, nonce: bytes, key: str, attachment: bytes, payload: bytes) -> bytes:
    """Return an attachment with the HMAC of its message behind it, where there is a token."""
    return attachment if token is None else attachment + authentication(token, nonce, key, attachment, payload)


def authentication(token: str, nonce: bytes, key: str, attachment: bytes, payload: bytes) -> bytes:
    """Return the HMAC of a message to the server that has drawn the nonce."""
    parts = hmac.new(token.encode(), digestmod=hashlib.sha256)
    for part in (nonce, key.encode(), attachment, payload):
        parts.update(len(part).to_bytes(8, "little") + part)
    return parts.digest()[:MAC_SIZE]
