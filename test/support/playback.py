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

"""Playback of sources in tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Event
from typing import Any

from opencv_tools.capture.errors import BrokenFrameError
from opencv_tools.capture.frame import CapturedFrame, Source
from opencv_tools.capture.player import Player
from opencv_tools.capture.settings import CaptureSettings
import pytest
from stepped_clock import SteppedClock


def play(source: Source, on_broken: Callable[[BrokenFrameError], object] = pytest.fail,
         stopped: Event | None = None, clock: SteppedClock | None = None,
         **settings: Any) -> Player:
    """Create a player that is never paused, with a clock whose waits take no time."""
    return Player(source, lambda: CaptureSettings(**settings), stopped or Event(), lambda: False,
                  on_broken, clock or SteppedClock())


def frames_of(source: Source) -> Iterator[CapturedFrame]:
    return iter(source.read, None)


def numbers(player: Player, most: int) -> list[int]:
    return [int(frame.image.flat[0]) for _, frame in zip(range(most), player.frames())]
