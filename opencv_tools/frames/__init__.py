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

"""
Receive and publish images as arrays in a node of your own.

The middleware is configured for large frames, nothing is copied without need, and the quality of
service follows the other end. `FrameNode` and `main` are enough for a new node, `FrameSubscriber`
and `FramePublisher` add images to an existing node, and `run_filter` needs only a function.
"""

from opencv_tools.frames.frame import Frame
from opencv_tools.frames.loan import LoanedFrame
from opencv_tools.frames.node import FrameNode, main, run_filter
from opencv_tools.frames.publisher import FramePublisher
from opencv_tools.frames.subscriber import FrameSubscriber
from opencv_tools.image.compressed_depth import DepthSettings
from opencv_tools.image.errors import RectificationError
from opencv_tools.transport.fastdds.profile import configured_fastdds
from opencv_tools.video.settings import VideoSettings

__all__ = ['DepthSettings', 'Frame', 'FrameNode', 'FramePublisher', 'FrameSubscriber',
           'LoanedFrame', 'RectificationError', 'VideoSettings', 'configured_fastdds', 'main',
           'run_filter']
