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

"""Numbers and structures of <linux/videodev2.h>."""

from __future__ import annotations

from opencv_tools.capture.v4l2 import videodev2
import pytest


@pytest.mark.parametrize(('name', 'number'), [
    ('QUERYCAP', 0x80685600), ('ENUM_FMT', 0xc0405602), ('S_FMT', 0xc0d05605),
    ('REQBUFS', 0xc0145608), ('QUERYBUF', 0xc0585609), ('QBUF', 0xc058560f),
    ('DQBUF', 0xc0585611), ('STREAMON', 0x40045612),
    ('STREAMOFF', 0x40045613), ('G_PARM', 0xc0cc5615),
    ('S_PARM', 0xc0cc5616), ('G_CTRL', 0xc008561b), ('S_CTRL', 0xc008561c),
    ('QUERYMENU', 0xc02c5625), ('ENUM_FRAMESIZES', 0xc02c564a),
    ('ENUM_FRAMEINTERVALS', 0xc034564b), ('DQEVENT', 0x80885659),
    ('SUBSCRIBE_EVENT', 0x4020565a), ('QUERY_EXT_CTRL', 0xc0e85667)])
def test_ioctl_numbers_of_64_bit_linux(name: str, number: int) -> None:
    assert getattr(videodev2, f'VIDIOC_{name}') == number


@pytest.mark.parametrize(('structure', 'field', 'offset'), [
    ('v4l2_capability', 'device_caps', 88), ('v4l2_fmtdesc', 'pixelformat', 44),
    ('v4l2_frmsizeenum', 'union', 12), ('v4l2_frmivalenum', 'union', 20),
    ('v4l2_format', 'fmt', 8), ('v4l2_pix_format', 'bytesperline', 16),
    ('v4l2_pix_format_mplane', 'plane_fmt', 20), ('v4l2_plane_pix_format', 'bytesperline', 4),
    ('v4l2_captureparm', 'timeperframe', 8), ('v4l2_plane', 'm', 8),
    ('v4l2_plane', 'data_offset', 16), ('v4l2_buffer', 'timestamp', 24),
    ('v4l2_buffer', 'sequence', 56), ('v4l2_buffer', 'm', 64), ('v4l2_buffer', 'length', 72),
    ('v4l2_query_ext_ctrl', 'flags', 72), ('v4l2_event', 'id', 96)])
def test_offsets_in_v4l2_structures(structure: str, field: str, offset: int) -> None:
    assert getattr(getattr(videodev2, structure), field).offset == offset
