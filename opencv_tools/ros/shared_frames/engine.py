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

from collections.abc import Iterator
from contextlib import contextmanager
import ctypes
import os
from pathlib import Path
import stat
from typing import Any, NamedTuple
import uuid

import numpy as np
from numpy.typing import NDArray

#: Where the memory is, and the folder with the state of the services.
SHARED_MEMORY = Path('/dev/shm')
#: Free bytes of /dev/shm that stay free, because iceoryx2 allocates pages for its own state.
RESERVE_BYTES = 1 << 18
MAX_READERS = 16
MAX_DEPTH = 16  # frames that wait for a reader; the oldest is overwritten
MAX_HELD_FRAMES = 4  # frames that a reader may hold

Pixels = NDArray[np.uint8]


class SharedMemoryError(Exception):
    """Frames cannot be shared; the text is the reason."""


class FrameHeader(ctypes.Structure):
    """
    Fields of a frame beside its pixels. Both texts follow the pixels, in UTF-8.

    ``number`` counts the frames of a writer from 1. ``data_size`` and both ``..._size`` are bytes.
    """

    _fields_ = (
        ('number', ctypes.c_uint64), ('data_size', ctypes.c_uint64), ('sec', ctypes.c_int32),
        ('nanosec', ctypes.c_uint32), ('height', ctypes.c_uint32), ('width', ctypes.c_uint32),
        ('step', ctypes.c_uint32), ('frame_id_size', ctypes.c_uint32),
        ('encoding_size', ctypes.c_uint32), ('is_bigendian', ctypes.c_uint32))

    @staticmethod
    def type_name() -> str:
        """Return the name that writers and readers compare."""
        return 'opencv_tools_frame_header_1'


class SharedFrame(NamedTuple):
    """
    A received frame.

    :param header: fields as the writer set them, unchecked but for the sizes.
    :param data: the pixels in the shared memory, (n,) uint8, read-only. The slot is held until the
        last view of it is gone.
    """

    header: FrameHeader
    frame_id: str
    encoding: str
    data: Pixels


@contextmanager
def _shared_memory_errors() -> Iterator[None]:
    """Convert each failure of iceoryx2, a panic too, to a SharedMemoryError."""
    try:
        yield
    except SharedMemoryError:
        raise
    except Exception as err:
        raise SharedMemoryError(f'iceoryx2: {type(err).__name__}: {err}') from err
    except BaseException as err:
        if type(err).__name__ != 'PanicException':
            raise
        raise SharedMemoryError(f'iceoryx2: {err}') from None


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
        folder = _private_folder(shared_memory / f'opencv_tools_{user}')
        with _shared_memory_errors():
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

    def create_writer(self, frame_bytes: int) -> FrameWriter:
        """
        Create a writer with a service of its own.

        :param frame_bytes: expected size of a frame; larger frames are possible.
        :raises SharedMemoryError: /dev/shm is full, or iceoryx2 failed.
        """
        self.check_room(frame_bytes)
        with _shared_memory_errors():
            return FrameWriter(self, uuid.uuid4().hex, frame_bytes)

    def open_reader(self, service: str, depth: int) -> FrameReader:
        """
        Open a reader of a writer of the same user on the same machine.

        :param service: name of the service of the writer.
        :param depth: number of frames that may wait, 1 to ``MAX_DEPTH``.
        :raises SharedMemoryError: there is no such writer, it has its most readers already,
            /dev/shm is full, or iceoryx2 failed.
        """
        self.check_room(0)
        with _shared_memory_errors():
            return FrameReader(self, service, min(depth, MAX_DEPTH))

    def builders(self, service: str) -> tuple[Any, Any]:
        """Return the builders of the frames and of the events of a service."""
        def builder() -> Any:
            return self._node.service_builder(
                self._iceoryx2.ServiceName.new(f'opencv_tools/{service}'))

        frames = (
            builder().publish_subscribe(self._iceoryx2.Slice[ctypes.c_uint8])
            .user_header(FrameHeader).max_publishers(1).max_subscribers(MAX_READERS)
            .max_nodes(MAX_READERS + 2).history_size(0).enable_safe_overflow(True)
            .subscriber_max_buffer_size(MAX_DEPTH)
            .subscriber_max_borrowed_samples(MAX_HELD_FRAMES))
        events = (builder().event().max_listeners(MAX_READERS).max_notifiers(1)
                  .max_nodes(MAX_READERS + 2))
        return frames, events

    def growing(self) -> Any:
        """Return the strategy that lets frames grow."""
        return self._iceoryx2.AllocationStrategy.PowerOfTwo

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


class Slot:
    """Memory for one frame, lent by a writer."""

    def __init__(self, writer: FrameWriter, sample: Any, size: int) -> None:
        """Create a view of the lent memory."""
        self._writer = writer
        self._sample = sample
        self._payload = _as_array(sample.payload_ptr, sample.payload().len())
        #: Memory for the pixels, (size,) uint8, not initialised.
        self.data = self._payload[:size]

    def publish(self, header: FrameHeader, frame_id: str, encoding: str) -> None:
        """
        Send the frame to the readers. The memory must not be used any more.

        :param header: fields of the frame; number and sizes are set here.
        :raises SharedMemoryError: the texts are too long, or iceoryx2 failed.
        """
        texts = frame_id.encode(), encoding.encode()
        size = len(self.data)
        end = size + sum(map(len, texts))
        if end > len(self._payload):
            raise SharedMemoryError(f'frame_id and encoding have {end - size} bytes, '
                                    f'{len(self._payload) - size} are possible')
        self._payload[size:end] = np.frombuffer(b''.join(texts), np.uint8)
        header.data_size = size
        header.frame_id_size, header.encoding_size = map(len, texts)
        self._writer.send(self._sample, header)


class FrameWriter:
    """Writes frames to a service."""

    # Bytes for frame_id and encoding behind the pixels.
    _TEXT_BYTES = 512

    def __init__(self, memory: FrameMemory, service: str, frame_bytes: int) -> None:
        """Create the service; see `FrameMemory.create_writer`."""
        self.service = service
        self._memory = memory
        self._number = 0
        self._largest = frame_bytes + self._TEXT_BYTES
        self._allocated: dict[int, int] = {}  # bytes by the address of a slot
        frames, events = memory.builders(service)
        self._frames = frames.create()
        self._publisher = (
            self._frames.publisher_builder().initial_max_slice_len(self._largest)
            .allocation_strategy(memory.growing()).max_loaned_samples(1).create())
        self._notifier = events.create().notifier_builder().create()

    @property
    def readers(self) -> int:
        """Number of readers."""
        return int(self._frames.dynamic_config.number_of_subscribers)

    def lend(self, size: int) -> Slot:
        """
        Lend memory for one frame. Only one slot can be lent at a time.

        :param size: bytes of the pixels.
        :raises SharedMemoryError: /dev/shm is full, or iceoryx2 failed.
        """
        needed = size + self._TEXT_BYTES
        if needed > self._largest:  # a new segment, whose slots may have addresses of the old one
            self._memory.check_room(needed)
            self._largest = needed
            self._allocated.clear()
        self._memory.check_room(0)
        with _shared_memory_errors():
            sample = self._publisher.loan_slice_uninit(needed)
            if self._allocated.get(sample.payload_ptr, 0) < needed:
                _allocate(sample.payload_ptr, needed)
                self._allocated[sample.payload_ptr] = needed
            return Slot(self, sample, size)

    def send(self, sample: Any, header: FrameHeader) -> None:
        """Send a filled slot, see `Slot.publish`."""
        self._number += 1
        header.number = self._number
        with _shared_memory_errors():
            ctypes.memmove(sample.user_header_ptr, ctypes.byref(header), ctypes.sizeof(header))
            sample.assume_init().send()
            self._notifier.notify()


class FrameReader:
    """Reads the frames of one writer."""

    def __init__(self, memory: FrameMemory, service: str, depth: int) -> None:
        """Open the service; see `FrameMemory.open_reader`."""
        self._memory = memory
        frames, events = memory.builders(service)
        # The listener comes first, so that no event is missed.
        self._listener = events.open().listener_builder().create()
        self._frames = frames.open()
        self._subscriber = self._frames.subscriber_builder().buffer_size(depth).create()
        #: Whether the last frame could not be received, because too many frames are held.
        self.is_blocked = False

    @property
    def has_writer(self) -> bool:
        """Whether the writer has not been closed. A killed writer still counts."""
        return bool(self._frames.dynamic_config.number_of_publishers)

    def wait(self, seconds: float) -> bool:
        """Wait for frames and return whether there may be one. Other threads run meanwhile."""
        with _shared_memory_errors():
            if seconds < 0.001:  # a shorter wait of iceoryx2 has no end
                return bool(self._listener.try_wait())
            return bool(self._listener.timed_wait(self._memory.duration(seconds)))

    def receive(self) -> SharedFrame | None:
        """
        Return the next frame, None without one or if ``MAX_HELD_FRAMES`` frames are held.

        :raises SharedMemoryError: sizes in the header are wrong, a text is not UTF-8, or iceoryx2
            failed. The next call returns the next frame.
        """
        try:
            sample = self._subscriber.receive()
        except self._memory._iceoryx2.ReceiveError as err:
            self.is_blocked = 'ExceedsMaxBorrows' in str(err)
            if self.is_blocked:
                return None
            raise SharedMemoryError(f'iceoryx2: {err}') from err
        self.is_blocked = False
        if sample is None:
            return None
        header = FrameHeader()
        ctypes.memmove(ctypes.byref(header), sample.user_header_ptr, ctypes.sizeof(header))
        payload = np.asarray(_HeldFrame(self._subscriber, sample))
        sizes = header.data_size, header.frame_id_size, header.encoding_size
        if sum(sizes) > payload.size:
            raise SharedMemoryError(f'the header of a frame tells of {sum(sizes)} bytes, it has '
                                    f'{payload.size}')
        data, texts = payload[:sizes[0]], payload[sizes[0]:sum(sizes)].tobytes()
        try:
            frame_id, encoding = texts[:sizes[1]].decode(), texts[sizes[1]:].decode()
        except UnicodeDecodeError as err:
            raise SharedMemoryError(f'a text of a frame is not UTF-8: {err}') from err
        return SharedFrame(header, frame_id, encoding, data)


class _HeldFrame:
    """The memory of a received frame; it is returned to the writer with the last view of it."""

    def __init__(self, subscriber: Any, sample: Any) -> None:
        """Hold the sample, and its subscriber, which would return the sample when it is gone."""
        self._held = subscriber, sample
        payload = sample.payload()
        self.__array_interface__ = {
            'shape': (payload.len(),), 'typestr': '|u1', 'data': (payload.as_ptr(), True),
            'version': 3}


def _as_array(address: int, size: int) -> Pixels:
    return np.frombuffer((ctypes.c_uint8 * size).from_address(address), np.uint8)


def _private_folder(path: Path) -> Path:
    """
    Create a folder that only this user can use, or check the existing one.

    :raises SharedMemoryError: another user owns it, others may write to it, or it is no folder.
    """
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
    except OSError as err:
        raise SharedMemoryError(f'{path} cannot be created: {err.strerror}') from err
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise SharedMemoryError(f'{path} is not a folder that only this user can access')
    return path


def _allocate(address: int, size: int) -> None:
    """
    Allocate the pages of mapped memory.

    :raises SharedMemoryError: there is no room for them.
    """
    for line in Path('/proc/self/maps').read_text().splitlines():
        first, last = (int(number, 16) for number in line.split(maxsplit=1)[0].split('-'))
        if first <= address < last:
            _, _, offset, _, _, path = line.split(maxsplit=5)
            break
    else:
        raise SharedMemoryError('the memory of a frame is not mapped')
    try:
        file = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            os.posix_fallocate(file, int(offset, 16) + address - first, size)
        finally:
            os.close(file)
    except OSError as err:
        raise SharedMemoryError(f'{size} bytes of {path} cannot be allocated: {err.strerror}') \
            from err
