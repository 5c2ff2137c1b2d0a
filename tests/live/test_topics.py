"""Keys and attachments are rmw_zenoh's."""

import numpy as np
import pytest

from longreach.live.protocol import topics
from longreach.live.protocol.message_header import pack_header, unpack_header
from longreach.live.protocol.topics import Topic


def test_a_key_is_domain_name_type_and_hash_as_ros_2_has_them():
    # The example of rmw_zenoh's documentation: ros2 run demo_nodes_cpp talker.
    assert Topic("/chatter", "std_msgs/msg/String").key == (
        "0/chatter/std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )


def test_an_attachment_has_33_bytes_and_says_what_was_attached():
    data = pack_header(7, b"0123456789abcdef")
    about, mac = unpack_header(data)
    assert len(data) == 33
    assert (about.number, about.sender, mac) == (7, b"0123456789abcdef", b"")
    assert unpack_header(data + bytes(16))[1] == bytes(16)


@pytest.mark.parametrize("data", [b"", bytes(33), bytes(1000), pack_header(1, bytes(16))[:-1]], ids=range(4))
def test_what_is_no_attachment_is_refused(data):
    with pytest.raises(ValueError, match="not a header"):
        unpack_header(data)


def test_a_message_comes_out_of_its_payload_as_it_went_in():
    message = topics.TYPES["std_msgs/msg/String"]("π")
    assert topics.ORDER.unpack(topics.ORDER.pack(message)).data == "π"
    assert np.frombuffer(topics.ORDER.pack(message), dtype=np.uint8)[1] == 1  # little-endian CDR
