"""Those whom zenoh itself does not let in: without the token, without a certificate, or speaking something else.

zenoh reports them in its log alone, on the standard output of the process; here that is read, and they are counted.
"""

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

from longreach.live.protocol.transport import zenoh
from longreach.rejection_counts import RejectionCounts

_LEVELS = "zenoh_transport::unicast::establishment::accept=debug,zenoh_link_tls=warn"
_ACCEPTED = "New transport link accepted"
_REFUSED = (
    (re.compile(r"Invalid password|Expected extension|Invalid user"), "a connection without the token"),
    (re.compile(r"no certificates|invalid peer certificate"), "a connection without a certificate of ours"),
    (re.compile(r"zenoh_link_tls"), "a connection without TLS"),
    (re.compile(r"establishment::accept"), "a connection that speaks something else"),
)
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


@contextmanager
def counted(rejections: RejectionCounts) -> Iterator[None]:
    """Count connections that are refused while the block runs; call it before a session is opened.

    What the process itself writes on its standard output still goes there.
    """
    shown, (read, write) = os.dup(1), os.pipe()
    os.environ.setdefault("RUST_LOG", _LEVELS)
    os.dup2(write, 1)
    os.close(write)
    reader = Thread(target=_read, args=(read, shown, rejections), name="refused links", daemon=True)
    reader.start()
    zenoh().try_init_log_from_env()
    try:
        yield
    finally:
        os.dup2(shown, 1)  # the last that holds the pipe open: the reader ends
        reader.join(1.0)
        os.close(shown)


def _read(read: int, shown: int, rejections: RejectionCounts) -> None:
    with os.fdopen(read, "rb") as lines:
        for raw in lines:
            text = _COLOUR.sub("", raw.decode(errors="replace"))
            if " zenoh_" not in text:
                os.write(shown, raw)
                continue
            reason = next((reason for pattern, reason in _REFUSED if pattern.search(text)), None)
            if reason is not None and _ACCEPTED not in text:
                rejections.count(reason, "the authentication")
