"""The server in the graph of ROS 2: the tokens by which rmw_zenoh learns of a node and its topics (`ros2 topic list`).

Source: rmw_zenoh, liveliness_utils: @ros2_lv/domain/session/node/entity/kind/enclave/namespace/name, and for publishers
topic, type, hash and qualities of service behind it; % stands for a slash or for nothing.
"""

from collections.abc import Iterable
from typing import Any

from longreach.live.protocol.topics import Topic

_QUALITIES = "::,:,:,:,,"  # all as by default
_NODE = "%/%/longreach"


def announced(session: Any, topics: Iterable[Topic]) -> list[Any]:
    """Return the tokens of a node longreach that publishes on topics; they last as long as they are kept."""
    prefix = f"@ros2_lv/0/{session.zid()}/0"
    keys = [f"{prefix}/0/NN/{_NODE}"]
    for i, topic in enumerate(topics, 1):
        _, type, hash = topic.key.rsplit("/", 2)
        keys.append(f"{prefix}/{i}/MP/{_NODE}/{topic.name.replace('/', '%')}/{type}/{hash}/{_QUALITIES}")
    return [session.liveliness().declare_token(key) for key in keys]
