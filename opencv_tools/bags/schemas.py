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
from opencv_tools.video.messages import COMPRESSED_VIDEO, FFMPEG_PACKET, VIDEO_TOPICS

CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'

_SEPARATOR = 80 * '=' + '\nMSG: '
_TIME = f"""\
{_SEPARATOR}builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_HEADER = f"""\
{_SEPARATOR}std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_TIME}"""

#: Text of the schema of each type: its fields, then the types that it uses, as in rosbag2.
MESSAGE_DEFINITIONS = {
    IMAGE: f"""\
std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{_HEADER}""",
    COMPRESSED_IMAGE: f"""\
std_msgs/Header header
string format
uint8[] data
{_HEADER}""",
    CAMERA_INFO: f"""\
std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
RegionOfInterest roi
{_HEADER}{_SEPARATOR}sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
""",
    FFMPEG_PACKET: f"""\
std_msgs/Header header
int32 width
int32 height
string encoding
uint64 pts
uint8 flags
bool is_bigendian
uint8[] data
{_HEADER}""",
    COMPRESSED_VIDEO: f"""\
builtin_interfaces/Time timestamp
string frame_id
uint8[] data
string format
{_TIME}""",
}

# Last parts of the names of topics beside an image topic, as in image_transport.
_SUFFIXES = ('compressed', *VIDEO_TOPICS.values())


def image_topic(topic: str) -> str:
    """Return the image topic beside a topic of compressed images or video."""
    base, _, suffix = topic.rpartition('/')
    return base if base and suffix in _SUFFIXES else topic


def camera_info_topic(topic: str) -> str:
    """Return the topic of the camera_info beside a topic of images or video."""
    return image_topic(topic).rpartition('/')[0] + '/camera_info'
