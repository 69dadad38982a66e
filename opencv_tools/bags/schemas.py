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

"""Types of the messages in bags, and their definitions, which a bag contains as schemas."""

from __future__ import annotations

from opencv_tools.image.cdr import COMPRESSED_IMAGE, IMAGE
from opencv_tools.message_types.definition import read_definition
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'

#: Text of the schema of each type: its fields, then the types that it uses, as in rosbag2.
MESSAGE_DEFINITIONS = {name: read_definition(name).text for name in (
    IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, FFMPEG_PACKET, COMPRESSED_VIDEO)}
