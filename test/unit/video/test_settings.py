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

"""Settings of a video encoder."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
import math
import sys
from typing import Any

from opencv_tools.image.errors import VideoError
from opencv_tools.video.settings import find_encoder, VideoSettings
import pytest


@pytest.mark.parametrize(('values', 'text'), [
    ({'codec': ''}, "codec is '': give one of h264, h265, or an encoder"),
    ({'codec': 'H264'}, "codec is 'H264': give one of h264"),
    ({'codec': 'a' * 100}, 'codec is '),
    ({'codec': 'x\n'}, "codec is 'x"),
    ({'quality': -1}, r'quality is -1: give 0 \(best\) to 51'),
    ({'quality': 52}, r'quality is 52: give 0 \(best\) to 51'),
    ({'codec': 'av1'}, "codec is 'av1': give one of h264, h265, or an encoder"),
    ({'codec': 'libsvtav1'}, "codec is 'libsvtav1': give one of h264, h265"),
    ({'bit_rate': -5}, 'bit_rate is -5: give 10000 to 1000000000 bits per second, or 0'),
    ({'bit_rate': 9999}, 'bit_rate is 9999: '),
    ({'bit_rate': 10 ** 10}, 'bit_rate is 10000000000: '),
    ({'key_interval': 0.0}, 'key_interval is 0.0: give seconds above 0, up to 3600'),
    ({'key_interval': math.nan}, 'key_interval is nan: '),
    ({'key_interval': math.inf}, 'key_interval is inf: '),
    ({'preset': 'quick'}, "preset is 'quick': give ultrafast or superfast"),
    ({'preset': 'a=b', 'codec': 'h264_nvenc'}, "preset is 'a=b': give one of the encoder"),
])
def test_invalid_settings(values: dict[str, Any], text: str) -> None:
    with pytest.raises(VideoError, match=text) as caught:
        VideoSettings(**values)
    assert isinstance(caught.value, ValueError) and str(caught.value).isprintable()


def test_default_settings() -> None:
    settings = VideoSettings()
    assert (settings.codec, settings.quality, settings.bit_rate) == ('h264', 23, 0)
    assert (settings.key_interval, settings.preset) == (2.0, '')
    with pytest.raises(FrozenInstanceError):
        settings.codec = 'h265'  # type: ignore[misc]


def test_missing_pyav(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'av', None)
    with pytest.raises(VideoError, match=r"videos need PyAV, .*'pip install av'"):
        find_encoder(VideoSettings())
