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

"""Forced thread switches inside a function, to test locks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import random
import threading
from types import FrameType
from typing import Any

from waiting import pause


@contextmanager
def switching_in(function: Callable[..., object]) -> Iterator[None]:
    """Switch threads before every line of a function, in threads started meanwhile."""
    code = function.__code__
    moments = random.Random(6)

    def trace_lines(frame: FrameType, event: str, argument: Any) -> Any:
        if event == 'line':
            pause(moments.uniform(0, 0.0005))
        return trace_lines

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        return trace_lines if frame.f_code is code else None

    before = threading.gettrace()
    threading.settrace(trace)
    try:
        yield
    finally:
        threading.settrace(before)
