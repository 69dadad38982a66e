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

from opencv_tools.image.cdr import CdrError, WireCompressedImage
from opencv_tools.ros.subscriber.messages import read_compressed_image
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header


def test_compressed_image_in_another_encapsulation() -> None:
    serialized = serialize_message(CompressedImage(
        header=Header(frame_id='eye'), format='png', data=b'123'))
    assert isinstance(read_compressed_image(serialized), WireCompressedImage)
    try:
        assert read_compressed_image(b'\0\3' + serialized[2:]) == read_compressed_image(serialized)
    except CdrError as err:
        assert 'the middleware cannot read the message' in str(err)
