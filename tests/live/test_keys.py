"""Keys and attachments are rmw_zenoh's."""

import numpy as np
import pytest

from longreach.live import keys
from longreach.live.attachment import attach, attached
from longreach.live.keys import Topic


def test_a_key_is_domain_name_type_and_hash_as_ros_2_has_them():
    # The example of rmw_zenoh's documentation: ros2 run demo_nodes_cpp talker.
    assert Topic("/chatter", "std_msgs/msg/String").key == (
        "0/chatter/std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    )


def test_an_attachment_has_33_bytes_and_says_what_was_attached():
    data = attach(7, b"0123456789abcdef")
    about, mac = attached(data)
    assert len(data) == 33
    assert (about.number, about.sender, mac) == (7, b"0123456789abcdef", b"")
    assert attached(data + bytes(16))[1] == bytes(16)


@pytest.mark.parametrize("data", [b"", bytes(33), bytes(1000), attach(1, bytes(16))[:-1]], ids=range(4))
def test_what_is_no_attachment_is_refused(data):
    with pytest.raises(ValueError, match="not an attachment"):
        attached(data)


def test_a_message_comes_out_of_its_payload_as_it_went_in():
    message = keys.TYPES["std_msgs/msg/String"]("π")
    assert keys.ORDER.unpack(keys.ORDER.pack(message)).data == "π"
    assert np.frombuffer(keys.ORDER.pack(message), dtype=np.uint8)[1] == 1  # little-endian CDR
