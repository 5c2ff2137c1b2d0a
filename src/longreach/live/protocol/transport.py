"""The network below: zenoh, set to find nobody by itself and to let in only who may come in.

Only this machine can reach a server unless it is given certificates: on any other address it demands TLS, and of each
client a certificate or a token. With a token nobody joins who does not know it (zenoh's own challenge with an HMAC,
the token is never sent), and each command carries an HMAC, which a router between client and server cannot make.
With certificates alone the server draws a key for each role, which zenoh hands out by the common name, for that HMAC.
No client can publish what the server publishes, or answer in its place: zenoh's access control drops that.
"""

import hashlib
import hmac
import ipaddress
import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from longreach.errors import LiveError

OPERATOR, WATCHER = "operator", "watcher"  # roles; and the common name of an operator's certificate
ROLE_KEYS = "longreach/role_keys"  # there a server with certificates keeps what a role's commands are signed with
_ROS_GRAPH = "@ros2_lv/**"  # which ** does not match
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


def server_settings(
    address: str, token: str | None, certificates: Path | None, watcher_token: str | None = None
) -> dict[str, Any]:
    """Return zenoh's settings for a server at an address, host:port, or say why it must not listen there.

    Raises:
        LiveError: other machines could reach it that anyone may use, a certificate is missing, or there is a token for
            watchers alone.
    """
    if watcher_token is not None and (token is None or token == watcher_token):
        raise LiveError("A watcher's token comes beside an operator's, and is another one: give both.")
    host, _ = split_address(address)
    if certificates is None and not _is_loopback(host):
        raise LiveError(
            f"{address} can be reached from other machines: give --certificates, a folder with server.pem, server.key "
            "and ca.pem, and a token unless clients shall have certificates; or listen on 127.0.0.1."
        )
    settings = _common("router", token)
    settings["listen/endpoints"] = [_endpoint(address, certificates)]
    settings["listen/exit_on_failure"] = True
    settings["access_control"] = _access_control()
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
    return settings


def open_server(address: str, token: str | None, certificates: Path | None, watcher_token: str | None = None) -> Any:
    """Return a session that listens at an address, host:port.

    Raises:
        LiveError: it must not, see `server_settings`, or it cannot.
    """
    settings = server_settings(address, token, certificates, watcher_token)
    with tempfile.TemporaryDirectory() as folder:
        if token is not None:
            users = Path(folder) / "users"
            users.touch(0o600)
            known = [one for one in (token, watcher_token) if one is not None]
            users.write_text("".join(f"{_user(one)}:{_password(one)}\n" for one in known), encoding="utf-8")
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
        settings["transport/auth/usrpwd"] = {"user": _user(token), "password": _password(token)}
    return settings


def _access_control() -> dict[str, Any]:
    """Return zenoh's rules of what clients may send, and of who is answered with an operator's key."""
    from longreach.live.protocol import topics  # loads what takes time, which a client's heartbeat does without

    def allow(name: str, flow: str, messages: Sequence[str], *keys: str) -> dict[str, Any]:
        return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}

    everything = ("**", _ROS_GRAPH)
    asking = ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query")
    saying = ("put", "delete", "declare_subscriber", "declare_queryable", "query", "liveliness_token")
    rules = [
        allow("listen and ask", "ingress", asking, *everything),
        allow("command", "ingress", ("put",), *(topic.key for topic in topics.COMMANDS)),
        allow("hear the server", "egress", saying, *everything),
        allow("get answers", "egress", ("reply",), "0/**", _ROS_GRAPH, f"{ROLE_KEYS}/{WATCHER}"),
        allow("get the key", "egress", ("reply",), f"{ROLE_KEYS}/{OPERATOR}"),
    ]
    *general, operators = [rule["id"] for rule in rules]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": "anybody"}, {"id": OPERATOR, "cert_common_names": [OPERATOR]}],
        "policies": [{"rules": general, "subjects": ["anybody"]}, {"rules": [operators], "subjects": [OPERATOR]}],
    }


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


def _user(token: str) -> str:
    """Return the name that zenoh knows whoever has a token by: one need not say whether it is an operator's."""
    return hmac.new(token.encode(), b"longreach user", hashlib.sha256).hexdigest()[:16]


def _password(token: str) -> str:
    """Return what zenoh is given instead of the token itself, without characters that its files use."""
    return hmac.new(token.encode(), b"longreach session", hashlib.sha256).hexdigest()
