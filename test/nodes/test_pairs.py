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

"""Every pair of options and events between a publisher and a receiver, see `pair_cases`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import itertools
from pathlib import Path
import signal

import cv2
from numbered_pictures import number_of, picture
from pair_cases import ALLOWED, Case, cases, EXCLUDED, FACTORS, FOUND
from pair_processes import OwnReceiver, Publisher, Recorder, Stage
from pairs import Part, parts
import pytest
from waiting import pause

pytest.importorskip('iceoryx2')

SEEDS = {1: 3, 2: 4, 3: 5}  # by the number of values of which every group occurs
STRENGTHS = {'test_singles': 1, 'test_pairs': 2, 'test_triples': 3}
FRAMES = {'fast': 12, 'slow': 4, 'raising': 12}
STOPPED_SECONDS = 2.0
Receiver = OwnReceiver | Recorder


@pytest.fixture
def stage(case: Case, tmp_path: Path) -> Iterator[Stage]:
    created = Stage(case, tmp_path)
    yield created
    created.close()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Choose the cases of a test, which takes seconds, unless the test does not run."""
    strength = STRENGTHS.get(metafunc.function.__name__, 0)
    if strength:
        is_left_out = strength > 1 and 'not thorough' in metafunc.config.option.markexpr
        metafunc.parametrize('case', [] if is_left_out else cases(
            strength=strength, seed=SEEDS[strength]), ids=str)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize('strength', SEEDS)
def test_every_possible_part_of_a_case(strength: int, tell: Callable[[str], None]) -> None:
    chosen = cases(strength=strength, seed=SEEDS[strength])
    covered = set().union(*(parts(vars(case), strength) for case in chosen))
    possible = {
        part for names in itertools.combinations(sorted(FACTORS), strength)
        for part in (tuple(zip(names, values)) for values in itertools.product(
            *(FACTORS[name] for name in names)))
        if any(set(part) <= combination.items() for combination in ALLOWED)}
    assert covered == possible
    assert not [part for part in EXCLUDED if occurs(part, chosen)]
    assert all(occurs(part, chosen) for part in FOUND)
    tell(f'{len(chosen)} cases with {len(covered)} groups of {strength} values')


def test_number_of_a_torn_picture() -> None:
    image = picture(70_000)
    decoded = cv2.imdecode(cv2.imencode('.jpg', image)[1], cv2.IMREAD_COLOR)
    assert number_of(image) == number_of(decoded, is_exact=False) == 70_000
    assert number_of(decoded) == -1
    image[-1] = picture(70_001)[-1]
    assert number_of(image, is_exact=False) == 70_000  # as JPEG may change a row
    image[64:] = picture(70_001)[64:]
    assert number_of(image, is_exact=False) == number_of(image) == -1


def occurs(part: Part, chosen: list[Case]) -> bool:
    return any(set(part) <= vars(case).items() for case in chosen)


@pytest.mark.thorough
@pytest.mark.process
def test_singles(case: Case, stage: Stage) -> None:
    check(case, stage)


@pytest.mark.process
@pytest.mark.thorough
def test_pairs(case: Case, stage: Stage) -> None:
    check(case, stage)


@pytest.mark.process
@pytest.mark.thorough
def test_triples(case: Case, stage: Stage) -> None:
    check(case, stage)


def check(case: Case, stage: Stage) -> None:
    receiver, status = play(case, stage)
    assert status == case.status, receiver.output
    assert receiver.output.count('Traceback') == (case.callback == 'raising'), receiver.output
    assert_order(receiver.numbers())
    assert_sum(case, receiver, stage.publishers)
    receiver.assert_callback()
    assert not stage.left_files()


def play(case: Case, stage: Stage) -> tuple[Receiver, int]:
    """Run a case to its end, and return the receiver and its exit status."""
    publisher = stage.publisher('first')
    if case.joins == 'late':
        publisher.order('go')
        publisher.wait_for_frames(FRAMES[case.callback])
        publisher.order('greet')
    receiver = stage.receiver()
    begin(case, publisher, receiver)
    if case.way == 'changing':
        change(case, publisher, receiver)
    if case.publisher_end == 'restarts':
        publisher.end()
        publisher = stage.publisher('second')
        begin(case, publisher, receiver)
    elif case.publisher_end == 'stopped':
        publisher.signal(signal.SIGSTOP)
        pause(STOPPED_SECONDS)
        publisher.signal(signal.SIGCONT)
        flow(case, publisher, receiver)
    return receiver, end(case, publisher, receiver)


def begin(case: Case, publisher: Publisher, receiver: Receiver) -> None:
    """Publish slowly until the receiver has a frame, then at full rate."""
    receiver.wait_for(lambda: receiver.count(publisher.life) > 0, 'the first frame')
    publisher.order('go')
    flow(case, publisher, receiver)


def flow(case: Case, publisher: Publisher, receiver: Receiver, is_shared: bool = True) -> None:
    """Wait for frames that arrive in the way of the case."""
    subscriptions = int(case.way == 'raw' or not is_shared)
    publisher.wait_for(lambda: publisher.subscriptions == subscriptions, 'the way of the case')
    before = receiver.count(publisher.life)
    receiver.wait_for(
        lambda: receiver.count(publisher.life) >= before + FRAMES[case.callback], 'frames')


def change(case: Case, publisher: Publisher, receiver: Receiver) -> None:
    """Send the receiver to the image topic and back to shared memory."""
    for reason in ('withdraw', 'mislead'):
        publisher.order(reason)
        flow(case, publisher, receiver, is_shared=False)
        publisher.order('share')
        flow(case, publisher, receiver)


def end(case: Case, publisher: Publisher, receiver: Receiver) -> int:
    """End the publisher and the receiver as the case says, and return the receiver's status."""
    if case.interrupt != 'idle':
        receiver.hold()
    if case.publisher_end == 'killed':
        publisher.find_shared_files()
        publisher.order('die')
        assert publisher.finish() == -signal.SIGKILL
    elif case.publisher_end == 'ends':
        publisher.end()
    if case.interrupt == 'idle':
        if case.publisher_end in ('restarts', 'stopped'):
            publisher.order('pause')
        receiver.wait_until_idle()
    if case.interrupt != 'never':
        receiver.press_ctrl_c()
    receiver.release()
    status = receiver.finish()
    if case.publisher_end in ('restarts', 'stopped'):
        publisher.end()
    return status


def assert_order(numbers: list[tuple[str, int]]) -> None:
    """Check the pixels, and that the frames of each publisher are in order without doubles."""
    assert all(number > 0 for _, number in numbers), numbers
    assert numbers == sorted(set(numbers)), numbers  # 'first' comes before 'second'


def assert_sum(case: Case, receiver: Receiver, publishers: list[Publisher]) -> None:
    """Check that published = received + missing, up to the last frame that arrived."""
    counts = receiver.counts()
    sums = {0}  # more than one, if the receiver does not tell which frames it counts
    for publisher in publishers:
        numbers = [number for life, number in receiver.numbers() if life == publisher.life]
        first, last = numbers[0], numbers[-1]
        assert last <= publisher.published
        begun = {1}
        if counts.before is None:
            begun |= publisher.greetings(first) if case.may_replace_first else {first}
        ended = case.last_counted(last, publisher.published,
                                  is_followed=publisher is not publishers[-1])
        sums = {total + until - since + 1 for total in sums for since in begun for until in ended}
    found = (counts.before or 0) + counts.received + counts.missing
    assert found in sums, (counts, sums, receiver.numbers())
