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

"""Check of the parameters of an encoder, which nodes without video do not import."""

from __future__ import annotations

from opencv_tools.image.errors import VideoError
from opencv_tools.topics.errors import ParameterError
from opencv_tools.video.encoder import check_encoder
from opencv_tools.video.settings import VideoSettings


def check_video(settings: VideoSettings, size: tuple[int, int] | None = None) -> None:
    """
    Check that the encoder of the ``video_`` parameters can be opened.

    :param size: width and height in pixels of the video until now; None without one.
    :raises ParameterError: the encoder is missing, or cannot be opened.
    """
    try:
        check_encoder(settings, size)
    except VideoError as err:
        # It begins with the name of a parameter, or with that of the encoder.
        codec = f"codec is '{settings.codec}', but " * str(err).startswith('encoder ')
        raise ParameterError(f'parameter video_{codec}{err}') from err
