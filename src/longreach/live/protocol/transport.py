"""The network below: zenoh, set to find nobody by itself and to let in only who may come in.

Only this machine can reach a server unless it is given certificates: on any other address it demands TLS, and of each
client a certificate or the token. With a token nobody joins who does not know it (zenoh's own challenge with an HMAC,
the token is never sent), and each command carries an HMAC, which a router between client and server cannot make.
"""

import hashlib
import hmac
import ipaddress
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from longreach.errors import LiveError

USER = "longreach"
PROTOCOL = "tcp"  # without certificates; the tests' lossy network takes udp
_LARGEST = 1 << 25  # message that is put together from its parts [bytes]; everything of ours is half of that at most


def zenoh() -> Any:
    """Return the module zenoh.

    Raises:
        LiveError: it is not installed.
    """
    try:
        import zenoh
    except ImportError as error:
        raise LiveError("A robot over a network needs zenoh: pip install 'longreach[live]'.") from error
    return zenoh


def open_server(address: str, token: str | None, certificates: Path | None) -> Any:
    """Return a session that listens at an address, host:port, or says why it must not.

    Raises:
        LiveError: another machine could reach it, and it would be let in by anyone.
    """
    host, _ = split_address(address)
    if certificates is None and not _is_loopback(host):
        raise LiveError(
            f"{address} can be reached from other machines: give --certificates, a folder with server.pem, server.key "
            "and ca.pem, and a token unless clients shall have certificates; or listen on 127.0.0.1."
        )
    settings = _common("router", token)
    settings["listen/endpoints"] = [_endpoint(address, certificates)]
    settings["listen/exit_on_failure"] = True
    settings["transport/link/rx/max_message_size"] = _LARGEST
    # A watcher that is slow loses messages; the loop never waits for it.
    settings["transport/link/tx/queue/congestion_control/drop/wait_before_drop"] = 0
    settings["transport/link/tx/queue/size"] = dict.fromkeys(_PRIORITIES, 16)
    if certificates is not None:
        files = {"listen_private_key": "server.key", "listen_certificate": "server.pem"}
        if token is None:
            files["root_ca_certificate"] = "ca.pem"
            settings["transport/link/tls/enable_mtls"] = True
        settings |= _tls(certificates, files)
    with tempfile.TemporaryDirectory() as folder:
        if token is not None:
            users = Path(folder) / "users"
            users.touch(0o600)
            users.write_text(f"{USER}:{_password(token)}\n", encoding="utf-8")
            settings["transport/auth/usrpwd"] |= {"dictionary_file": str(users)}
        return _opened(settings, f"Nothing can listen at {address}")


def open_client(address: str, token: str | None, certificates: Path | None, timeout: float) -> Any:
    """Return a session that is connected to an address, host:port.

    Raises:
        LiveError: nobody answers, or the server refuses us.
    """
    settings = _common("client", token)
    settings["connect/endpoints"] = [_endpoint(address, certificates)]
    settings["connect/timeout_ms"] = max(int(1000 * timeout), 1)
    settings["connect/exit_on_failure"] = True
    if certificates is not None:
        files = {"root_ca_certificate": "ca.pem"}
        if (certificates / "client.pem").exists():
            files |= {"connect_private_key": "client.key", "connect_certificate": "client.pem"}
            settings["transport/link/tls/enable_mtls"] = True
        settings |= _tls(certificates, files)
    reason = "wants another token or certificate" if token or certificates else "wants a token or a certificate"
    return _opened(settings, f"No robot answers at {address}, or it {reason}")


_PRIORITIES = (
    "control", "real_time", "interactive_high", "interactive_low", "data_high", "data", "data_low", "background",
)  # fmt: skip


def _common(mode: str, token: str | None) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": [],
        "transport/shared_memory/enabled": False,
        "adminspace/enabled": False,
        "transport/unicast/max_sessions": 64,
    }
    if token is not None:
        settings["transport/auth/usrpwd"] = {"user": USER, "password": _password(token)}
    return settings


def _opened(settings: Mapping[str, Any], otherwise: str) -> Any:
    z = zenoh()
    config = z.Config()
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        return z.open(config)
    except z.ZError as error:
        raise LiveError(f"{otherwise}.") from error


def split_address(address: str) -> tuple[str, int]:
    """Return host and port.

    Raises:
        LiveError: it is not host:port.
    """
    host, _, port = str(address).rpartition(":")
    if not host or not (port.isascii() and port.isdigit()):
        raise LiveError(f"{address!r} is no address; write it as host:port, such as 127.0.0.1:7447.")
    if len(port) > 5 or not 0 < int(port) <= 65535:
        raise LiveError(f"{address} has no port that there is; a port is a number from 1 to 65535.")
    return host, int(port)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _endpoint(address: str, certificates: Path | None) -> str:
    host, port = split_address(address)
    return f"{PROTOCOL if certificates is None else 'tls'}/{host}:{port}"


def _tls(folder: Path, files: Mapping[str, str]) -> dict[str, Any]:
    missing = [name for name in files.values() if not (folder / name).is_file()]
    if missing:
        raise LiveError(f"The folder of certificates {folder} has no {missing[0]}.")
    return {f"transport/link/tls/{key}": str(folder / name) for key, name in files.items()}


def _password(token: str) -> str:
    """Return what zenoh is given instead of the token itself, without characters that its files use."""
    return hmac.new(token.encode(), b"longreach session", hashlib.sha256).hexdigest()
