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
Frames in shared memory, carried by iceoryx2. No other module imports iceoryx2.

A writer lends a slot of memory, the caller fills it, and readers of the same user on the same
machine look at the frame there. The memory of a slot is allocated before it is written, so a full
/dev/shm raises an error and never SIGBUS.
"""

from __future__ import annotations

from contextlib import suppress
import ctypes
import os
from pathlib import Path
from threading import Lock
from typing import Any
import uuid
import weakref

from opencv_tools.base.remedies import installation
from opencv_tools.transport.shared_frames.header import FrameHeader
from opencv_tools.transport.shared_frames.pages import (
    private_folder, shared_memory_errors, SharedMemoryError)
from opencv_tools.transport.shared_frames.reader import FrameReader, MAX_VIEWS
from opencv_tools.transport.shared_frames.writer import FrameWriter

SHARED_MEMORY = Path('/dev/shm')
RESERVE_BYTES = 1 << 18
MAX_READERS = 16
MAX_DEPTH = 16  # frames that wait for a reader
#: Why a process cannot receive shared frames.
NOT_SHARED = ('frames cannot be shared with this process, because iceoryx2 is not installed or '
              f'OPENCV_TOOLS_TRANSPORT is default; {installation("iceoryx2")}, or set '
              'transport:=auto')


class FrameMemory:
    """The shared memory of a process: creates writers and opens readers."""

    def __init__(self, shared_memory: Path = SHARED_MEMORY) -> None:
        """
        Join the shared memory of this user and test it with one frame.

        :raises SharedMemoryError: iceoryx2 is not installed, or frames do not pass.
        """
        try:
            import iceoryx2
        except ImportError as err:
            raise SharedMemoryError(f'iceoryx2 cannot be imported: {err}') from err
        self._iceoryx2: Any = iceoryx2
        self._shared_memory = shared_memory
        user = os.getuid()
        folder = private_folder(shared_memory / f'opencv_tools_{user}')
        with shared_memory_errors:
            self.check_room(0)
            iceoryx2.set_log_level(iceoryx2.LogLevel.Fatal)
            config = iceoryx2.config.default()
            config.global_cfg.root_path = iceoryx2.Path.new(str(folder))
            config.global_cfg.prefix = iceoryx2.FileName.new(f'opencv_tools_{user}_')
            self._node = (
                iceoryx2.NodeBuilder.new().config(config)
                .signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
                .create(iceoryx2.ServiceType.Ipc))
        self._test()

    def check_room(self, size: int) -> None:
        """
        Check that /dev/shm has room for a number of bytes beside its reserve.

        :raises SharedMemoryError: it has less.
        """
        found = os.statvfs(self._shared_memory)
        free = found.f_bavail * found.f_frsize
        if free < size + RESERVE_BYTES:
            raise SharedMemoryError(f'{self._shared_memory} has {free} bytes free, but {size} and '
                                    f'a reserve of {RESERVE_BYTES} are needed')

    def remove_dead(self) -> None:
        """Remove the writers and readers of killed processes of this user, and their files."""
        with suppress(SharedMemoryError), shared_memory_errors:
            self._node.try_cleanup_dead_nodes()

    def create_writer(self, frame_bytes: int, *, overwrites: bool = True) -> FrameWriter:
        """
        Create a writer with a service of its own.

        :param frame_bytes: expected size of a frame; larger frames are possible.
        :param overwrites: whether a frame replaces the oldest one that waits for a slow reader;
            otherwise this reader does not get the frame.
        :raises SharedMemoryError: /dev/shm is full, or iceoryx2 failed.
        """
        self.check_room(frame_bytes)
        with shared_memory_errors:
            return FrameWriter(self, uuid.uuid4().hex, frame_bytes, overwrites)

    def open_reader(
        self, service: str, depth: int, max_views: int = MAX_VIEWS,
    ) -> FrameReader:
        """
        Open a reader of a writer of the same user on the same machine.

        :param depth: number of frames that may wait, 1 to ``MAX_DEPTH``.
        :param max_views: number of received frames that may stay in the shared memory.
        :raises SharedMemoryError: there is no such writer, it has its most readers already,
            /dev/shm is full, or iceoryx2 failed.
        """
        self.check_room(0)
        try:
            with shared_memory_errors:
                return FrameReader(self, service, min(depth, MAX_DEPTH), max_views)
        except SharedMemoryError as err:
            if 'Exceeds' not in str(err):
                raise
            raise SharedMemoryError(f'it has {MAX_READERS} readers already, which is the limit; '
                                    'more subscriptions receive the image topic') from err

    def builders(self, service: str) -> tuple[Any, Any]:
        """Return the builders of the frames and of the events of a service."""
        def builder() -> Any:
            return self._node.service_builder(
                self._iceoryx2.ServiceName.new(f'opencv_tools/{service}'))

        frames = (
            builder().publish_subscribe(self._iceoryx2.Slice[ctypes.c_uint8])
            .user_header(FrameHeader).max_publishers(1).max_subscribers(MAX_READERS)
            .max_nodes(MAX_READERS + 2).history_size(0).subscriber_max_buffer_size(MAX_DEPTH)
            .subscriber_max_borrowed_samples(MAX_VIEWS + 1))
        events = (builder().event().max_listeners(MAX_READERS).max_notifiers(1)
                  .max_nodes(MAX_READERS + 2))
        return frames, events

    def strategies(self) -> tuple[Any, Any]:
        """Return the strategies that let frames grow, and that never wait for a reader."""
        return (self._iceoryx2.AllocationStrategy.PowerOfTwo,
                self._iceoryx2.BackpressureStrategy.DiscardData)

    def duration(self, seconds: float) -> Any:
        """Return a duration of iceoryx2."""
        return self._iceoryx2.Duration.from_secs_f64(seconds)

    def _test(self) -> None:
        """Pass one frame from a writer to a reader."""
        writer = self.create_writer(16)
        reader = self.open_reader(writer.service, 1)
        slot = writer.lend(7)
        slot.data[:] = range(7)
        slot.publish(FrameHeader(), 'é', 'mono8')
        received = reader.receive() if reader.wait(1.0) else None
        if received is None or (received.frame_id, received.encoding, received.data.tobytes()) != (
                'é', 'mono8', bytes(range(7))):
            raise SharedMemoryError('iceoryx2 did not pass a frame within 1 s')


_memory: weakref.ref[FrameMemory] | None = None
_lock = Lock()


def process_memory() -> FrameMemory:
    """
    Return the shared memory of this process, which lives as long as its writers and readers.

    :raises SharedMemoryError: see `FrameMemory`.
    """
    global _memory
    with _lock:
        memory = _memory() if _memory else None
        if memory is None:
            memory = FrameMemory()
            _memory = weakref.ref(memory)
        return memory
