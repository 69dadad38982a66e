# Copyright 2026 opencv_tools maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Image messages that are not in plain CDR."""

from __future__ import annotations

from opencv_tools.image.errors import CdrError
from opencv_tools.topics.messages import COMPRESSED_IMAGE, IMAGE, read_message
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header


@pytest.mark.parametrize(('message', 'type_name'), [
    (Image(header=Header(frame_id='eye'), encoding='mono8', data=b'123'), IMAGE),
    (CompressedImage(header=Header(frame_id='eye'), format='png', data=b'123'), COMPRESSED_IMAGE),
], ids=['raw', 'compressed'])
def test_message_in_another_encapsulation(message: object, type_name: str) -> None:
    serialized = serialize_message(message)
    plain = read_message(serialized, type_name)
    assert (plain.header.frame_id, bytes(plain.data)) == ('eye', b'123')
    try:
        assert read_message(b'\0\3' + serialized[2:], type_name) == plain
    except CdrError as err:
        assert 'the middleware cannot read the message' in str(err)
