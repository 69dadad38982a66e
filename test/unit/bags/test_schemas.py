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

"""Definitions of the messages, compared with the files of ROS."""

from __future__ import annotations

from pathlib import Path
import re

from ament_index_python import get_package_share_directory
from opencv_tools import message_types
from opencv_tools.bags.schemas import camera_info_topic, MESSAGE_DEFINITIONS
import pytest


def fields(package: str, name: str) -> list[str]:
    """Return the fields of a message of ROS, without comments."""
    own = Path(message_types.__file__).parent / 'msg' / package / f'{name}.msg'
    text = (own if own.exists() else
            Path(get_package_share_directory(package)) / 'msg' / f'{name}.msg').read_text()
    lines = (' '.join(line.partition('#')[0].split()) for line in text.splitlines())
    return list(filter(None, lines))


@pytest.mark.parametrize('type_name', MESSAGE_DEFINITIONS)
def test_definition_is_that_of_ros(type_name: str) -> None:
    package, _, name = type_name.split('/')
    first, *others = re.split('={80}\nMSG: ', MESSAGE_DEFINITIONS[type_name])
    assert first.splitlines() == fields(package, name)
    assert others
    for text in others:
        title, *lines = text.splitlines()
        assert lines == fields(*title.split('/'))


@pytest.mark.parametrize(('topic', 'expected'), [
    ('/video_frames', '/camera_info'), ('/front/image/compressed', '/front/camera_info'),
    ('/compressed', '/camera_info'), ('/a/compressed_image', '/a/camera_info'),
    ('/front/image/ffmpeg', '/front/camera_info'), ('/video/foxglove', '/camera_info')])
def test_topic_of_camera_info(topic: str, expected: str) -> None:
    assert camera_info_topic(topic) == expected
