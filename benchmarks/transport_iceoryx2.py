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

"""Publisher and subscriber of iceoryx2 alone, in plain Python: the engine of shared frames."""

from __future__ import annotations

import ctypes
from threading import Event
import time
from typing import Any

import iceoryx2
import numpy as np
from numpy.typing import NDArray
from transport_parts import Ages, Camera, listen, Load

_SECONDS = 0.05
_DEPTH = 10


class _Stamp(ctypes.Structure):
    _fields_ = (('stamp_ns', ctypes.c_int64),)

    @staticmethod
    def type_name() -> str:
        """Return the name that both ends compare."""
        return 'opencv_tools_benchmark_stamp'


def publish(load: Load) -> None:
    """Fill and send a loaned slot for each frame of a camera."""
    frames, events = _services(load)
    publisher = frames.publisher_builder().initial_max_slice_len(load.frame_bytes).create()
    notifier = events.notifier_builder().create()
    camera, end = Camera(load), Event()
    listen(camera.begin, end.set)
    while not end.is_set():
        if not camera.wait(_SECONDS):
            continue
        image = camera.read().image
        sample = publisher.loan_slice_uninit(load.frame_bytes)
        with camera.meter.leave_out():
            np.copyto(_array(sample, load), image)
        _stamp(sample).stamp_ns = time.time_ns()
        sample.assume_init().send()
        notifier.notify()
    camera.meter.report()


def subscribe(load: Load) -> None:
    """Record the age of each frame."""
    frames, events = _services(load)
    listener = events.listener_builder().create()
    subscriber = frames.subscriber_builder().create()
    ages, end = Ages(), Event()
    listen(lambda: None, end.set)
    while not end.is_set():
        listener.timed_wait(iceoryx2.Duration.from_secs_f64(_SECONDS))
        while sample := subscriber.receive():
            ages.note(_array(sample, load), _stamp(sample).stamp_ns)
            del sample
    ages.report()


def _services(load: Load) -> tuple[Any, Any]:
    """Return the service of the frames and that of their events."""
    iceoryx2.set_log_level(iceoryx2.LogLevel.Fatal)
    node = (iceoryx2.NodeBuilder.new()
            .signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
            .create(iceoryx2.ServiceType.Ipc))
    name = iceoryx2.ServiceName.new(f'{load.namespace}/{load.topic}')
    frames = (node.service_builder(name).publish_subscribe(iceoryx2.Slice[ctypes.c_uint8])
              .user_header(_Stamp).subscriber_max_buffer_size(_DEPTH))
    return frames.open_or_create(), node.service_builder(name).event().open_or_create()


def _array(sample: Any, load: Load) -> NDArray[np.uint8]:
    payload = sample.payload()
    memory: Any = (ctypes.c_uint8 * payload.len()).from_address(payload.as_ptr())
    return np.frombuffer(memory, np.uint8).reshape(load.height, load.width, -1)


def _stamp(sample: Any) -> _Stamp:
    return _Stamp.from_address(sample.user_header_ptr)
