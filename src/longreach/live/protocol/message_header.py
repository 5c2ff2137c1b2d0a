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


class MessageHeader(NamedTuple):
    """What comes with a message: its number from its sender on, when it was sent [ns], by whom (16 bytes)."""

    number: int
    sent_ns: int
    sender: bytes


def pack_header(number: int, sender: bytes) -> bytes:
    """Return the header of a message that is sent now."""
    return _ATTACHED.pack(number, time.time_ns(), 16, sender)


def unpack_header(data: bytes) -> tuple[MessageHeader, bytes]:
    """Return what a header says, and what follows it: the message's authentication, or nothing.

    Raises:
        ValueError: it is none.
    """
    if len(data) not in (_ATTACHED.size, _ATTACHED.size + MAC_SIZE):
        raise ValueError("not a header")
    number, sent_ns, length, sender = _ATTACHED.unpack_from(data)
    if length != 16:
        raise ValueError("not a header")
    return MessageHeader(number, sent_ns, sender), data[_ATTACHED.size :]


def signed(token: str | None, nonce: bytes, key: str, header: bytes, payload: bytes) -> bytes:
    """Return a header with the HMAC of its message behind it, where there is a token."""
    return header if token is None else header + authentication(token, nonce, key, header, payload)


def authentication(token: str, nonce: bytes, key: str, header: bytes, payload: bytes) -> bytes:
    """Return the HMAC of a message to the server that has drawn the nonce."""
    parts = hmac.new(token.encode(), digestmod=hashlib.sha256)
    for part in (nonce, key.encode(), header, payload):
        parts.update(len(part).to_bytes(8, "little") + part)
    return parts.digest()[:MAC_SIZE]
