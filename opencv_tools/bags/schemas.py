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

"""Definitions of the types of the messages in bags, which a bag contains as schemas."""

from __future__ import annotations

from opencv_tools.image.types import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE

__all__ = ['CAMERA_INFO', 'COMPRESSED_IMAGE', 'IMAGE', 'MESSAGE_DEFINITIONS', 'camera_info_topic']

_SEPARATOR = 80 * '=' + '\nMSG: '
_HEADER = f"""\
{_SEPARATOR}std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_SEPARATOR}builtin_interfaces/Time
int32 sec
uint32 nanosec
"""

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
}


def camera_info_topic(topic: str) -> str:
    """Return the topic of the camera_info beside a topic of raw or compressed images."""
    return topic.removesuffix('/compressed').rpartition('/')[0] + '/camera_info'
