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

"""Publishers and receivers of a case, which run `numbered_nodes` or an img_subscriber."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import re
import sys
import time

from child_processes import Child, Event, shared_files
from conftest import executable, is_fastdds, read_manifest, read_pictures, remove_unused
import numbered_nodes
from numbered_pictures import number_of
from opencv_tools.transport.shared_frames.memory import process_memory
from pair_cases import Case, LOSSY

_IDLE_TICKS = 5
_SLOW_SCALE = 3  # of pictures that take longer to encode than the camera needs for the next one
_SUMMARY = re.compile(
    r'Received (\d+) frames at .*: (\d+) written to .*, (\d+) dropped, (\d+) failed, '
    r'(\d+) lost in transit(?:, (\d+) sent before the first received frame)?(.*)')


@dataclass(frozen=True)
class Counts:
    """
    What a receiver reports.

    :param received: number of frames.
    :param missing: number of lost, skipped and replaced frames.
    :param before: number of frames before the first received ones; None if it does not tell.
    """

    received: int
    missing: int
    before: int | None


class Publisher(Child):
    """A `NumberedPublisher`, whose frames have the name of its life."""

    def __init__(self, life: str, case: Case, folder: Path) -> None:
        self.life = life
        scale = _SLOW_SCALE if case.is_recorder and case.callback == 'slow' else 1
        neighbour = case.transport if (case.joins, life) == ('late', 'first') else ''
        super().__init__(life, [
            sys.executable, numbered_nodes.__file__, 'publisher', life,
            str(folder / f'{life}.journal'), str(scale), case.image, neighbour], folder)

    @property
    def published(self) -> int:
        """Return the number of the last frame."""
        return int(self.events('frame')[-1].words[0])

    @property
    def subscriptions(self) -> int:
        """Return the number of subscriptions of the image topic at the last frame."""
        frames = self.events('frame')
        return int(frames[-1].words[2]) if frames else -1

    def greetings(self, received: int) -> set[int]:
        """Return the numbers of the slow frames until the first one that was received."""
        greeted = {int(event.words[0]) for event in self.events('frame')
                   if event.words[1] == 'greet'}
        return {number for number in greeted if number <= received}

    def wait_for_frames(self, count: int) -> None:
        """Wait until a number of frames is published."""
        self.wait_for(lambda: len(self.events('frame')) >= count, f'frame {count}')

    def end(self) -> None:
        """End the process regularly."""
        self.order('end')
        assert self.finish() == 0, self.output


class OwnReceiver(Child):
    """A `CheckingReceiver`."""

    def __init__(self, case: Case, folder: Path) -> None:
        self._case = case
        super().__init__('receiver', [
            sys.executable, numbered_nodes.__file__, 'receiver', str(folder / 'receiver.journal'),
            case.transport, case.frames, case.receiver, case.camera_info, case.callback], folder,
            on_terminal=case.log == 'terminal')
        self._hold = Path(f'{self.journal}.hold')
        self._interrupted_at = math.inf

    def count(self, life: str) -> int:
        """Return the number of frames of a publisher until now."""
        return sum(call.words[0] == life for call in self.events('call'))

    def wait_until_idle(self) -> None:
        """Wait until no frame is coming."""
        def is_idle() -> bool:
            events = self.events()
            ticks = [event.name for event in events[-_IDLE_TICKS:]] == ['tick'] * _IDLE_TICKS
            return ticks and len(self.events('call')) == len(self.events('done'))

        self.wait_for(is_idle, 'ticks without frames')

    def hold(self) -> None:
        """
        Let the next callback wait until `release`, and return when a callback waits.

        Fails if no callback comes, or if a callback in its own thread delays the timer, which must
        tick three times meanwhile.
        """
        self._hold.touch()
        self.wait_for(lambda: bool(self.events('held')), 'the next callback')
        if self._case.receiver == 'threaded':
            begun = len(self.events('tick'))
            self.wait_for(lambda: len(self.events('tick')) >= begun + 3,
                          'ticks beside a callback in its own thread')

    def press_ctrl_c(self) -> None:
        """Interrupt the process; a callback in its own thread does not delay the end."""
        self._interrupted_at = time.monotonic()
        super().press_ctrl_c()
        if self._case.receiver == 'threaded':
            self.wait_for(lambda: bool(self.events('closing')), 'the end of the node')

    def release(self) -> None:
        """Let the callback return."""
        self._hold.unlink(missing_ok=True)

    def numbers(self) -> list[tuple[str, int]]:
        """Return the publisher and the number of each frame; -1 for wrong pixels."""
        return [(call.words[0], int(call.words[1])) for call in self.events('call')]

    def counts(self) -> Counts:
        """Return what the node has counted; it has failed to read no frame."""
        (closed,) = self.events('closed')
        skipped, failed = map(int, closed.words)
        assert failed == 0, self.output
        return Counts(len(self.numbers()), skipped, None)

    def assert_callback(self) -> None:
        """Check what the callback was given, the timer beside it, and its end."""
        assert not self.events('wrong')
        (closed,) = self.events('closed')
        assert self.events()[-1] == closed
        if self._case.receiver == 'executor':
            assert late_calls(self.events()) == []
            later = [call for call in self.events('call') if call.time > self._interrupted_at]
            assert len(later) <= 1


def late_calls(events: Sequence[Event]) -> list[Event]:
    """
    Return the calls before which the executor has passed over a timer.

    The timer is due at the latest a period after the first call without a tick. When a call
    returns after that, the tick comes before the next call, however busy the machine is.
    """
    late: list[Event] = []
    first_call = returned = 0.0
    for event in events:
        if event.name == 'tick':
            first_call = 0.0
        elif event.name == 'done':
            returned = event.time
        elif event.name == 'call':
            first_call = first_call or event.time
            if returned > first_call + 2 * numbered_nodes.TICK_SECONDS:
                late.append(event)
    return late


class Recorder(Child):
    """An ``img_subscriber`` that writes each frame to a file."""

    def __init__(self, case: Case, folder: Path) -> None:
        self._case = case
        self._folder = folder / 'recorded'
        settings = {'output_dir': self._folder, 'file_name': '"{seq:06d}_{frame_id}.png"',
                    'transport': case.transport, 'on_overflow': case.receiver}
        if case.callback == 'slow':
            settings |= {'queue_size': 2, 'writers': 1, 'png_compression': 9}
        assignments = (word for name, value in settings.items()
                       for word in ('-p', f'{name}:={value}'))
        super().__init__('receiver', [executable('img_subscriber'), '--ros-args', *assignments],
                         folder, on_terminal=case.log == 'terminal')

    def count(self, life: str) -> int:
        """Return the number of frames of a publisher that are written."""
        return len(list(self._folder.glob(f'[0-9]*_{life}.png')))

    def wait_until_idle(self) -> None:
        """Wait until no frame is coming, which is logged once after each of the publishers."""
        self.wait_for(lambda: 'No frames: ' in self.output.rpartition('Frames arrive on')[2],
                      'the warning that no frames arrive')

    def hold(self) -> None:
        """Do nothing: the recorder takes frames all the time."""

    def release(self) -> None:
        """Do nothing."""

    def numbers(self) -> list[tuple[str, int]]:
        """Return the publisher and the number of each file; -1 for wrong pixels."""
        is_exact = self._case.way not in LOSSY
        pictures = zip(read_manifest(self._folder), read_pictures(self._folder))
        return [(line['frame_id'], number_of(image, is_exact=is_exact))
                for line, image in pictures]

    def counts(self) -> Counts:
        """Return the counts of the summary, which account for each received frame."""
        found = _SUMMARY.search(self.output)
        assert found and not found[7].strip(), self.output  # as no frame is left or skipped
        received, written, dropped, failed, lost = map(int, found.groups()[:5])
        assert failed == 0, self.output
        assert received == written + dropped
        assert written == len(self.numbers())
        assert self._case.receiver == 'drop' or dropped == 0
        return Counts(received, lost, int(found[6] or 0))

    def assert_callback(self) -> None:
        """Do nothing: there is no callback of a user."""


class Stage:
    """The processes of a case."""

    def __init__(self, case: Case, folder: Path) -> None:
        self._case = case
        self._folder = folder
        self.publishers: list[Publisher] = []
        self.children: list[Child] = []

    def publisher(self, life: str) -> Publisher:
        """Start a publisher."""
        self.publishers.append(Publisher(life, self._case, self._folder))
        self.children.append(self.publishers[-1])
        return self.publishers[-1]

    def receiver(self) -> OwnReceiver | Recorder:
        """Start the receiver."""
        kind = Recorder if self._case.is_recorder else OwnReceiver
        receiver = kind(self._case, self._folder)
        self.children.append(receiver)
        return receiver

    def left_files(self) -> set[Path]:
        """Return the files in /dev/shm that the processes have left and no process uses."""
        used = set[Path]().union(*(child.shared_files for child in self.children))
        if self._case.publisher_end == 'killed':
            remove_left(used)
        left = {path for path in used if path.exists() and not path.is_dir()}  # as it lists one
        return left.difference(*map(shared_files, Path('/proc').glob('[0-9]*'))) if left else left

    def close(self) -> None:
        """Kill the processes that run, and remove what they leave."""
        running = [child for child in self.children if child.is_running()]
        for child in running:
            print(f'{child.journal.stem}:\n{child.output[-5000:]}')
            child.kill()
        if running:
            remove_left(set[Path]().union(*(child.shared_files for child in running)))


def remove_left(files: set[Path]) -> None:
    """Remove what killed processes have left, as the next process of the user does."""
    process_memory().remove_dead()
    remove_unused({path for path in files if is_fastdds(path)})
