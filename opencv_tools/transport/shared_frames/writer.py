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

"""Writer of frames in shared memory."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any
import weakref

import numpy as np
from opencv_tools.transport.shared_frames.header import FrameHeader, Pixels
from opencv_tools.transport.shared_frames.pages import (
    allocate_pages, ServiceMemory, shared_memory_errors, SharedMemoryError)

#: Slots that users may fill at once. One more is for frames that are copied.
MAX_LOANS = 3
#: Bytes for frame_id and encoding behind the pixels.
TEXT_BYTES = 512
_HeaderBytes = ctypes.c_char * ctypes.sizeof(FrameHeader)


class _LoanedMemory:
    """The memory of a slot, which returns to the writer with the last view of it."""

    def __init__(self, sample: Any, size: int) -> None:
        self._sample = sample
        self.__array_interface__ = {
            'shape': (size,), 'typestr': '|u1', 'data': (sample.payload_ptr, False), 'version': 3}


class Slot:
    """Memory for one frame, lent by a writer and returned to it if it is not published."""

    def __init__(self, writer: FrameWriter, sample: Any, size: int) -> None:
        self.writer = writer
        self._sample = sample
        memory: Any = (ctypes.c_uint8 * (size + TEXT_BYTES)).from_address(sample.payload_ptr)
        self._payload = np.frombuffer(memory, np.uint8)
        #: Memory for the pixels, (size,) uint8, not initialised. No view of it outlives the slot.
        self.data = self._payload[:size]

    def loan(self) -> tuple[Pixels, weakref.ref[object]]:
        """
        Return the memory for the pixels as an array that the user may keep.

        :returns: the array, and a reference that is dead when no view of the array is left.
        """
        memory = _LoanedMemory(self._sample, len(self.data))
        self.writer.loans.add(memory)
        return np.asarray(memory), weakref.ref(memory)

    def publish(self, header: FrameHeader, frame_id: str, encoding: str) -> bool:
        """
        Send the frame to the readers. The memory must not be written to any more.

        :param header: fields of the frame; the sizes are set here.
        :returns: whether all readers had room for the frame.
        :raises SharedMemoryError: the texts are too long, or iceoryx2 failed.
        """
        texts, *sizes = _encoded(frame_id, encoding)
        size = header.data_size = len(self.data)
        if len(texts) > TEXT_BYTES:
            raise SharedMemoryError(f'frame_id and encoding have {len(texts)} bytes, '
                                    f'{TEXT_BYTES} are possible')
        self._payload[size:size + len(texts)] = texts
        header.frame_id_size, header.encoding_size = sizes
        return self.writer.send(self._sample, header)


class FrameWriter:
    """Writes frames to a service."""

    # Upper limit for the fields of iceoryx2 and ours before the pixels.
    _HEADER_BYTES = 4096

    def __init__(
        self, memory: ServiceMemory, service: str, frame_bytes: int, overwrites: bool,
    ) -> None:
        self.service = service
        self._memory = memory
        self._largest = frame_bytes + TEXT_BYTES
        self._allocated: dict[int, int] = {}  # bytes by the address of a slot
        #: Memory that users hold.
        self.loans: weakref.WeakSet[_LoanedMemory] = weakref.WeakSet()
        frames, events = memory.builders(service)
        self._frames = frames.enable_safe_overflow(overwrites).create()
        growing, discarding = memory.strategies()
        self._publisher = (
            self._frames.publisher_builder().initial_max_slice_len(self._largest)
            .allocation_strategy(growing).backpressure_strategy(discarding)
            .max_loaned_samples(MAX_LOANS + 1).create())
        self._notifier: Any = events.create().notifier_builder().create()

    @property
    def readers(self) -> int:
        """Return the number of readers."""
        return int(self._frames.dynamic_config.number_of_subscribers)

    def end(self) -> None:
        """
        Send nothing more. Readers leave when they have received all frames.

        iceoryx2 opens a segment for a reader with the first frame that it receives from it. If the
        writer is gone by then, the frames in the segment are lost in silence.
        """
        self._notifier = None

    def lend(self, size: int) -> Slot:
        """
        Lend memory for one frame. Beside the loans only one slot can be lent at a time.

        :param size: bytes of the pixels.
        :raises SharedMemoryError: /dev/shm is full, or iceoryx2 failed.
        """
        needed = size + TEXT_BYTES
        if needed > self._largest:  # a new segment, whose slots may have addresses of the old one
            self._memory.check_room(needed)
            self._largest = needed
            self._allocated.clear()
        with shared_memory_errors:
            sample = self._publisher.loan_slice_uninit(needed)
            if self._allocated.get(sample.payload_ptr, 0) < needed:
                # iceoryx2 writes its header of the next slot before it lends that slot.
                allocate_pages(sample.payload_ptr, needed + self._HEADER_BYTES)
                self._allocated[sample.payload_ptr] = needed
            return Slot(self, sample, size)

    def send(self, sample: Any, header: FrameHeader) -> bool:
        """Send a filled slot, see `Slot.publish`."""
        with shared_memory_errors:
            _HeaderBytes.from_address(sample.user_header_ptr).raw = bytes(header)
            received = sample.assume_init().send()
            self._notifier.notify()
            return bool(received >= self.readers)


@lru_cache(16)  # the same for most frames of a publisher
def _encoded(frame_id: str, encoding: str) -> tuple[Pixels, int, int]:
    """Return both texts as bytes, and the number of bytes of each."""
    first, second = frame_id.encode(), encoding.encode()
    return np.frombuffer(first + second, np.uint8), len(first), len(second)
