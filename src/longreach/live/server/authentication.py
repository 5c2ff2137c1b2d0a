"""Who comes in: every message of a client is checked here before anything believes it, and rejections are counted."""

import hmac
from collections import OrderedDict
from typing import Any

from longreach.live.protocol.message_header import authentication, unpack_header
from longreach.live.protocol.topics import Topic
from longreach.rejection_counts import RejectionCounts

_NUMBERS = 1024  # that are remembered, of senders on topics


class Rejected(Exception):
    """A message that is not accepted; its text is the reason, in a few words."""


class Authentication:
    """Lets in a message that is small enough, whole, authentic where there is a token, and new."""

    def __init__(self, token: str | None, nonce: bytes, rejections: RejectionCounts) -> None:
        self._token, self._nonce, self.rejections = token, nonce, rejections
        self._numbers: OrderedDict[tuple[bytes, str], int] = OrderedDict()  # by sender and topic

    def admit(self, topic: Topic, sample: Any) -> tuple[bytes, Any]:
        """Return who sent a sample or query, and its message.

        Raises:
            Rejected: it is not let in.
        """
        payload = sample.payload
        if payload is None or len(payload) > topic.limit:
            raise Rejected("nothing in it" if payload is None else "too large")
        data, header = bytes(payload), b"" if sample.attachment is None else bytes(sample.attachment)
        try:
            about, mac = unpack_header(header)
        except ValueError:
            raise Rejected("without a header") from None
        if self._token is not None:
            signed = header[: len(header) - len(mac)]
            if not hmac.compare_digest(mac, authentication(self._token, self._nonce, topic.key, signed, data)):
                raise Rejected("not authentic")
            # On one topic: messages of different topics may overtake each other, and the topic is authentic, too.
            if about.number <= self._numbers.get((about.sender, topic.key), -1):
                raise Rejected("repeated")
        try:
            message = topic.unpack(data)
        except Exception:
            raise Rejected("malformed") from None
        self._numbers[about.sender, topic.key] = about.number
        self._numbers.move_to_end((about.sender, topic.key))
        while len(self._numbers) > _NUMBERS:
            self._numbers.popitem(last=False)
        return about.sender, message
