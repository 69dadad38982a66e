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

"""Names of the topics beside an image topic."""

from __future__ import annotations

from opencv_tools.image.topic_names import camera_info_topic, IMAGE_SUFFIXES, image_topic
from opencv_tools.video.messages import VIDEO_TOPICS
import pytest


def test_suffixes_of_video_are_known() -> None:
    assert {*VIDEO_TOPICS.values()} < {*IMAGE_SUFFIXES}


@pytest.mark.parametrize(('topic', 'images', 'beside'), [
    ('/cam/image_raw', '/cam/image_raw', '/cam/camera_info'),
    ('/cam/image_raw/compressed', '/cam/image_raw', '/cam/camera_info'),
    ('/cam/depth/compressedDepth', '/cam/depth', '/cam/camera_info'),
    ('/video_frames/ffmpeg', '/video_frames', '/camera_info'),
    ('/image_rect', '/image_rect', '/camera_info'),
    ('/compressed', '/compressed', '/camera_info')])
def test_camera_info_of_a_topic(topic: str, images: str, beside: str) -> None:
    assert image_topic(topic) == images
    assert camera_info_topic(topic) == beside
    assert camera_info_topic(topic, {beside}.__contains__) == beside
    own = f'{images}/camera_info'
    assert camera_info_topic(topic, {own, beside}.__contains__) == own
