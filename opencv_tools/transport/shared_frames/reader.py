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

"""Reader of frames in shared memory."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from opencv_tools.image.errors import CdrError
from opencv_tools.transport.shared_frames.header import FrameHeader, SharedFrame
from opencv_tools.transport.shared_frames.pages import (
    ServiceMemory, shared_memory_errors, SharedMemoryError)

MAX_VIEWS = 3  # frames that a reader holds in place; more are copied


class FrameReader:
    """Reads the frames of one writer. ``wait`` and ``receive`` may run in different threads."""

    def __init__(
        self, memory: ServiceMemory, service: str, depth: int, max_views: int,
    ) -> None:
        self._memory = memory
        self._max_views = min(max_views, MAX_VIEWS)
        self._views: set[int] = set()  # identifiers of the frames that are held
        frames, events = memory.builders(service)
        # The listener comes first, so that no event is missed.
        self._events = events.open()
        self._listener = self._events.listener_builder().create()
        self._frames = frames.open()
        self._subscriber = self._frames.subscriber_builder().buffer_size(depth).create()

    @property
    def delays_writer(self) -> bool:
        """Whether the writer waits for room, instead of overwriting frames that wait."""
        return not self._frames.static_config.has_safe_overflow

    @property
    def has_writer(self) -> bool:
        """Whether more frames may be sent. A killed writer still counts."""
        return bool(self._events.dynamic_config.number_of_notifiers)

    def wait(self, seconds: float) -> bool:
        """
        Wait for frames and return whether there may be one. Other threads run meanwhile.

        :param seconds: at least 0.001; a shorter wait of iceoryx2 has no end.
        :raises SharedMemoryError: iceoryx2 failed.
        """
        try:
            with shared_memory_errors:
                return bool(self._listener.timed_wait(self._memory.duration(seconds)))
        except SharedMemoryError as err:
            if 'InterruptSignal' in str(err):  # by any signal, such as SIGCONT
                return True
            raise

    def close(self) -> None:
        """Leave a writer that has ended, also while received frames are held."""
        self._subscriber.delete()

    def receive(self) -> SharedFrame | None:
        """
        Return the next frame, or None.

        :raises CdrError: sizes in the header are wrong, or a text is not UTF-8. The next call
            returns the next frame.
        :raises SharedMemoryError: iceoryx2 failed.
        """
        with shared_memory_errors:
            sample = self._subscriber.receive()
        if sample is None:
            return None
        # A copy, which takes a third of the time of memmove after a pause.
        header = FrameHeader.from_buffer_copy(FrameHeader.from_address(sample.user_header_ptr))
        held = _HeldFrame(self._subscriber, sample, self._views)
        payload = np.asarray(held)
        sizes = header.data_size, header.frame_id_size, header.encoding_size
        if sum(sizes) > payload.size:
            raise CdrError(f'the header of a frame declares {sum(sizes)} bytes, but it has '
                           f'{payload.size}')
        data, texts = payload[:sizes[0]], payload[sizes[0]:sum(sizes)].tobytes()
        frame_id, encoding = _decoded(texts, sizes[1])
        if len(self._views) > self._max_views:
            data = data.copy()
            data.flags.writeable = False
        return SharedFrame(header, frame_id, encoding, data)


@lru_cache(16)  # the same for most frames of a publisher
def _decoded(texts: bytes, size: int) -> tuple[str, str]:
    """
    Return frame_id and encoding.

    :param size: bytes of the frame_id.
    """
    try:
        return texts[:size].decode(), texts[size:].decode()
    except UnicodeDecodeError as err:
        raise CdrError(f'a text of a frame is not UTF-8: {err}') from err


class _HeldFrame:
    """The memory of a received frame; it is returned to the writer with the last view of it."""

    def __init__(self, subscriber: Any, sample: Any, views: set[int]) -> None:
        self._held = subscriber, sample
        self._views = views
        views.add(id(self))
        self.__array_interface__ = {
            'shape': (sample.header.number_of_elements,), 'typestr': '|u1',
            'data': (sample.payload_ptr, True), 'version': 3}

    def __del__(self) -> None:
        """Release the memory, and only then count it as released: another thread may receive."""
        del self._held
        self._views.discard(id(self))
