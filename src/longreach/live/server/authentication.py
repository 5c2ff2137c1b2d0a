"""Who comes in: every message of a client is checked here before anything believes it, and rejections are counted.

A message is signed with the key of its sender's role. A watcher's may ask for a stop and its role, an operator's for
anything.
"""

import hmac
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from longreach.live.protocol import topics
from longreach.live.protocol.message_header import MessageHeader, authentication, unpack_header
from longreach.live.protocol.topics import Topic
from longreach.live.protocol.transport import OPERATOR, WATCHER
from longreach.rejection_counts import RejectionCounts

_NUMBERS = 1024  # that are remembered, of senders on topics


class Rejected(Exception):
    """A message that is not accepted; its text is the reason, in a few words."""


class Authentication:
    """Lets in a message that is small enough, whole, of one that may send it, and new.

    keys: what each role signs with; where there are none, everybody is an operator.
    """

    def __init__(self, keys: Mapping[str, str], nonce: bytes, rejections: RejectionCounts) -> None:
        self._keys, self._nonce, self.rejections = keys, nonce, rejections
        self._numbers: OrderedDict[tuple[bytes, str], int] = OrderedDict()  # by sender and topic

    def admit(self, topic: Topic, sample: Any) -> tuple[MessageHeader, Any]:
        """Return the header of a sample or query, and its message.

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
        role = OPERATOR
        if self._keys:
            role = self._role(topic, header[: len(header) - len(mac)], data, mac)
            if role != OPERATOR:  # everybody sees the holder's sender: who uses it as a watcher is somebody else
                about = about._replace(sender=role.encode() + about.sender)
            # On one topic: messages of different topics may overtake each other, and the topic is authentic, too.
            if about.number <= self._numbers.get((about.sender, topic.key), -1):
                raise Rejected("repeated")
        try:
            message = topic.unpack(data)
        except Exception:
            raise Rejected("malformed") from None
        if role != OPERATOR and not (topic is topics.ORDER and message.data.split(" ")[0] in ("stop", "role")):
            raise Rejected("from a watcher, who may look and stop only")
        self._numbers[about.sender, topic.key] = about.number
        self._numbers.move_to_end((about.sender, topic.key))
        while len(self._numbers) > _NUMBERS:
            self._numbers.popitem(last=False)
        return about, message

    def _role(self, topic: Topic, header: bytes, data: bytes, mac: bytes) -> str:
        """Return the role that has signed a message."""
        for role, key in self._keys.items():
            if hmac.compare_digest(mac, authentication(key, self._nonce, topic.key, header, data)):
                return role
        raise Rejected("not authentic")


def is_watcher(about: MessageHeader) -> bool:
    """Whether a watcher has signed a message, by its header as `Authentication` returns it."""
    return about.sender.startswith(WATCHER.encode()) and len(about.sender) > 16  # of which a sender has no more
