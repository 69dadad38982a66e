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

"""Video files as a source."""

from __future__ import annotations

from conftest import CLIP, decode_clip
import numpy as np
from opencv_tools.capture.source import open_source
from playback import frames_of


def test_video_yields_every_frame_and_its_rate() -> None:
    source = open_source(str(CLIP))
    assert source.rate == 25.0 and not source.live
    for expected, frame in zip(decode_clip(), frames_of(source), strict=True):
        assert frame.encoding == 'bgr8'
        assert np.array_equal(frame.image, expected)
    source.rewind()
    assert np.array_equal(source.read().image, decode_clip(1)[0])
    source.close()
