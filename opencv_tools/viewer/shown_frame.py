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

"""The frame that a page shows, and another one that it steps to while it is paused."""

from __future__ import annotations

import asyncio

from opencv_tools.viewer.feed import NewFrame


class ShownFrame:
    """Frame of the newest picture that the page has drawn."""

    def __init__(self) -> None:
        """Create an object without a frame."""
        self._drawn: tuple[int, NewFrame | None] = 0, None
        self._stepped: NewFrame | None = None
        self._step: asyncio.Future[str] | None = None

    @property
    def held(self) -> NewFrame | None:
        """Return the frame of a paused page."""
        return self._stepped or self._drawn[1]

    def of(self, sequence: int) -> NewFrame | None:
        """Return the frame of the picture that the page shows; None for another picture."""
        drawn, frame = self._drawn
        return frame if drawn == sequence else None

    def step(self, frame: NewFrame) -> asyncio.Future[str]:
        """
        Hold another frame, and give up an earlier step.

        :returns: future of '' once the page has drawn the frame, or of the reason why it cannot.
        """
        if self._step is None or frame is not self._stepped:
            self.close()
            self._stepped = frame
            self._step = asyncio.get_running_loop().create_future()
        return self._step

    def drawn(self, sequence: int, frame: NewFrame | None) -> None:
        """Use the answer of the page to a picture."""
        if sequence > self._drawn[0]:
            self._drawn = sequence, frame
        if frame and frame is self._stepped:
            self.close()

    def failed(self, frame: NewFrame, reason: str) -> None:
        """Use the reason why a frame has no picture."""
        if frame is self._stepped:
            self.close(reason)

    def close(self, reason: str = '') -> None:
        """End a step."""
        if self._step and not self._step.done():
            self._step.set_result(reason)
