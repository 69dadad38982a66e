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


"""Recordings that pages of ``img_viewer`` start and stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
import re
import shutil
import signal
import subprocess
from typing import Any

from conftest import NodeProcess, read_manifest, recorded_files
import cv2
import numpy as np
from opencv_tools.bags.open_bag import Bag
from opencv_tools.bags.reading import BagMessage
from opencv_tools.image.cdr import cdr_to_compressed_image, cdr_to_image
import pytest
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image
from stereo_msgs.msg import DisparityImage
from viewing import address_of, Camera, Page, publishing, run_page, ShownPicture
from waiting import until

Start = Callable[..., NodeProcess]
GRAY = np.full((48, 64, 3), 90, np.uint8)


def picture(number: int) -> np.ndarray:
    """Return an image that no other number has."""
    return np.random.default_rng(number).integers(0, 256, (48, 64, 3), np.uint8)


def images_in(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return the stamps in seconds and the pixels or JPEGs of each topic of a bag."""
    bag, found = Bag(path), dict[str, list[tuple[int, Any]]]()
    with closing(bag):
        for message in bag.messages([*bag.topics]):
            assert isinstance(message, BagMessage)
            if message.topic.type_name == 'sensor_msgs/msg/CameraInfo':
                found.setdefault(message.topic.name, []).append((
                    deserialize_message(bytes(message.load()), CameraInfo).header.stamp.sec, None))
                continue
            is_raw = message.topic.type_name == 'sensor_msgs/msg/Image'
            image = (cdr_to_image if is_raw else cdr_to_compressed_image)(message.load())
            content = bytes(image.data)
            found.setdefault(message.topic.name, []).append((
                image.header.sec,
                np.frombuffer(content, np.uint8).reshape(48, 64, 3) if is_raw else content))
    return found


class Recording:
    """A page that records."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.since: float | None = None  # of the recording that the page shows

    @classmethod
    async def connect(cls, viewer: NodeProcess) -> Recording:
        return cls(await Page.connect(address_of(viewer)))

    @classmethod
    async def begin(cls, viewer: NodeProcess, camera: Camera) -> Recording:
        """Record the topic /image of a camera."""
        recording = await cls.connect(viewer)
        assert (await recording.ask(await recording.numbers('/image')))['ok']
        await camera.seen()
        return recording

    async def numbers(self, *names: str) -> list[int]:
        """Wait until topics are listed; return their numbers."""
        while True:
            listed = {one['name']: one['id'] for one in await self.page.text('topics')}
            if set(names) <= set(listed):
                return [listed[name] for name in names]

    async def ask(self, wanted: Any) -> dict[str, Any]:
        await self.page.send(record=wanted, since=self.since)
        while True:
            message = await self.page.read()
            if isinstance(message, ShownPicture):
                await self.page.send(got=message.sequence)
                continue
            self.since = message.get('recording', {}).get('since', self.since)
            if 'record' in message:
                answer: dict[str, Any] = message['record']
                return answer

    async def state(self, condition: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
        """Read until the account of the recording has a property."""
        while True:
            state = await self.page.text('recording')
            self.since = state.get('since')
            if condition(state):
                return state


def test_frames_of_two_topics(start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    raw = Camera(node, '/left/image', depth=100)
    jpeg = Camera(node, '/right/image/compressed', compressed=True, depth=100)
    other = Camera(node, '/other')
    info = node.create_publisher(CameraInfo, '/left/camera_info', 10)
    jpegs = [cv2.imencode('.jpg', picture(number))[1].tobytes() for number in range(60)]

    async def act() -> dict[str, Any]:
        recording = await Recording.connect(viewer)
        numbers = await recording.numbers('/left/image', '/right/image', '/other')
        answer = await recording.ask(numbers[:2])
        assert answer == {'ok': True, 'message': 'Recording 2 topics'}
        await raw.seen()
        await jpeg.seen()
        await until(lambda: info.get_subscription_count() > 0)
        second = await Recording.connect(viewer)
        refused = await second.ask(await second.numbers('/other'))
        assert not refused['ok']
        assert re.fullmatch(r'already recording 2 topics since \d\d:\d\d:\d\d', refused['message'])
        for number in range(60):  # at once, while no page looks
            calibration = CameraInfo()
            calibration.header.stamp.sec = number
            info.publish(calibration)
            raw.publish(picture(number))
            jpeg.publish_compressed(jpegs[number])
            other.publish(GRAY)
        state = await second.state(lambda state: state['frames'] == 120)
        assert (state['topics'], state['dropped'], state['failed'], state['problem']) == (
            ['/left/image', '/right/image'], 0, 0, '')
        assert state['bytes'] == 60 * picture(0).nbytes + sum(map(len, jpegs))
        assert 0 < state['left'] <= shutil.disk_usage(folder).total
        stopped = await second.ask(False)  # any page can
        assert stopped == {'ok': True, 'message': f'Recorded 120 frames in {state["name"]}'}
        return await recording.state(lambda state: not state['phase'])

    state = run_page(act())
    (bag,) = recorded_files(folder)
    assert state['name'] == bag.name
    assert re.fullmatch(r'\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d\.mcap', bag.name)
    found = images_in(bag)
    assert set(found) == {'/left/image', '/right/image/compressed', '/left/camera_info'}
    calibrations = [stamp for stamp, _ in found['/left/camera_info']]
    assert len(calibrations) == len({*calibrations})  # each once
    # A bag is in the order of reception, by the clock of the middleware.
    images = sorted(found['/left/image'], key=lambda image: image[0])
    assert [stamp for stamp, _ in images] == [*range(1, 61)]
    assert all(np.array_equal(pixels, picture(number))
               for number, (_, pixels) in enumerate(images))
    assert sorted(found['/right/image/compressed']) == [*zip(range(1, 61), jpegs)]
    assert [line['frames'] for line in read_manifest(folder)] == [120]
    assert f'Recorded 120 frames of 2 topics in {state["seconds"]} s to {bag}: 0 dropped' in (
        viewer.output)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_bag_of_a_viewer_that_ends(
        start: Start, node: Node, tmp_path: Path, number: int) -> None:
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'bags')
    camera = Camera(node, '/image')

    async def act() -> None:
        recording = await Recording.begin(viewer, camera)
        recording.page.socket.close()  # the recording goes on
        again = await Recording.connect(viewer)
        for index in range(20):
            camera.publish(picture(index))
        await again.state(lambda state: state.get('frames') == 20)

    run_page(act())
    viewer.interrupt(number)
    assert viewer.finish() == 0, viewer.output
    (bag,) = recorded_files(tmp_path / 'bags')
    assert len(images_in(bag)['/image']) == 20
    assert not Bag(bag).warnings
    assert 'Traceback' not in viewer.output
    assert 'the node has ended' in viewer.output


def test_bag_of_a_killed_viewer(start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    camera = Camera(node, '/image')

    async def act() -> None:
        recording = await Recording.begin(viewer, camera)
        for index in range(20):
            camera.publish(picture(index))
        await recording.state(lambda state: state['frames'] == 20)

    run_page(act())
    viewer.interrupt(signal.SIGKILL)
    viewer.finish()
    (bag,) = recorded_files(folder)
    assert Bag(bag).warnings  # without an index
    address_of(start('img_viewer', port=0, control='true', record_dir=folder))
    assert not Bag(bag).warnings
    assert len(images_in(bag)['/image']) == 20


@pytest.mark.thorough
def test_second_bag_of_a_second(start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    camera = Camera(node, '/image', latched=True)
    camera.publish(GRAY)

    async def act() -> list[dict[str, Any]]:
        recording = await Recording.connect(viewer)
        numbers = await recording.numbers('/image')
        answers = []
        for _ in range(500):
            answers += [await recording.ask(numbers), await recording.ask(False)]
        return answers

    answers = run_page(act())
    sentences = {answer['message'] for answer in answers if not answer['ok']}
    assert sentences <= {'the last recording began less than a second ago: try again',
                         'nothing is being recorded'}
    assert sentences
    begun = sum(answer['message'] == 'Recording 1 topic' for answer in answers)
    assert begun < 50 and len(recorded_files(folder)) <= begun
    assert viewer.is_running() and 'Traceback' not in viewer.output


def test_stop_of_another_recording_is_refused(start: Start, node: Node, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'bags')
    camera = Camera(node, '/image')

    async def act() -> None:
        late = await Recording.begin(viewer, camera)  # it shows the first recording
        await late.state(lambda state: state['phase'] == 'recording')
        other = await Recording.connect(viewer)
        numbers = await other.numbers('/image')
        await other.state(lambda state: state['phase'] == 'recording')
        assert (await other.ask(False))['ok']
        while not (await other.ask(numbers))['ok']:  # the last one began less than a second ago
            pass
        for shown in (late.since, None, 1e9):
            late.since = shown
            assert await late.ask(False) == {
                'node': False, 'name': None, 'ok': False,
                'message': 'another recording has begun since: look at it, then stop it'}
        await other.state(lambda state: state['phase'] == 'recording')
        assert (await other.ask(False))['ok']

    run_page(act())


def test_requests_that_are_refused(start: Start, node: Node, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'bags')
    Camera(node, '/image')

    async def act() -> None:
        recording = await Recording.connect(viewer)
        await recording.numbers('/image')
        for wanted, sentence in (
                ([], 'there is no topic to record'),
                (['../../etc/passwd'], '../../etc/passwd is not the number of a topic'),
                ([1e300], '1e+300 is not the number of a topic'),
                (False, 'nothing is being recorded')):
            answer = await recording.ask(wanted)
            assert (answer['ok'], answer['message']) == (False, sentence)

    run_page(act())
    assert recorded_files(tmp_path / 'bags') == []


def test_ten_thousand_names(start: Start, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'bags')

    async def act() -> None:
        page = await Page.connect(address_of(viewer))
        await page.send(record=[f'/camera_{number}' for number in range(10_000)])
        assert await page.close_code() in (1009, 1006)
        await (await Page.connect(address_of(viewer))).text('recording')

    run_page(act())


@pytest.mark.thorough
def test_last_seconds_of_two_topics(start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    raw, jpeg = Camera(node, '/left'), Camera(node, '/right/compressed', compressed=True)
    Camera(node, '/other')
    jpegs = [cv2.imencode('.jpg', picture(number))[1].tobytes() for number in range(20)]

    async def act() -> dict[str, Any]:
        recording = await Recording.connect(viewer)
        left, right, other = await recording.numbers('/left', '/right', '/other')
        page = recording.page
        await page.send(keep=[other])
        assert await page.text('keep') == {
            'node': [other], 'name': None, 'ok': False,
            'message': 'no frames of /other are in memory'}
        for name, camera in (('/left', raw), ('/right', jpeg)):
            await page.send(subscribe=name, looks=True)
            await camera.seen()

        async def shown(*cameras: Camera) -> None:
            wanted = {camera.number for camera in cameras}
            while wanted:
                wanted -= {(await page.picture()).stamp}

        await publishing(lambda: raw.publish(GRAY), page.picture())
        await publishing(lambda: jpeg.publish_compressed(jpegs[0]), page.status(
            lambda state: state['name'] == '/right' and state['frames']))
        raw.number, jpeg.number = 100, 200
        for number in range(20):  # as they are displayed
            raw.publish(picture(number))
            jpeg.publish_compressed(jpegs[number])
            await shown(raw, jpeg)
        await page.send(keep=[left, right, other])
        answer = await page.text('keep')
        assert answer['ok'], answer
        assert viewer.is_running()
        return answer

    answer = run_page(act())
    (bag,) = recorded_files(folder)
    found = images_in(bag)
    assert set(found) == {'/left', '/right/compressed'}
    count = sum(map(len, found.values()))
    assert answer['message'] == f'Recorded {count} frames from memory in {bag.name}'
    assert all(np.array_equal(pixels, picture(number))
               for number, (_, pixels) in enumerate(found['/left'][-20:]))
    assert found['/right/compressed'][-20:] == [*zip(range(201, 221), jpegs)]
    assert [line['frames'] for line in read_manifest(folder)] == [count]


def test_no_frames_are_kept(start: Start, node: Node, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'bags',
                   history_bytes=0)
    Camera(node, '/image')

    async def act() -> None:
        # A page reads the first list of topics, or the first account.
        first = await Recording.connect(viewer)
        assert (await first.state(lambda _: True))['keeps'] is False
        recording = await Recording.connect(viewer)
        await recording.page.send(keep=await recording.numbers('/image'))
        assert (await recording.page.text('keep'))['message'] == (
            'this node keeps no frames in memory')

    run_page(act())


def test_no_recording_by_default(start: Start) -> None:
    viewer = start('img_viewer', port=0, control='true')

    async def act() -> None:
        recording = await Recording.connect(viewer)
        answer = await recording.ask([1])
        assert answer['message'] == (
            'this node does not record: start it with record_dir:=FOLDER')

    run_page(act())


def test_no_recording_without_control(start: Start, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, record_dir=tmp_path / 'bags')
    assert viewer.finish() == 2
    assert 'but control is false: set control to true' in viewer.output
    assert not (tmp_path / 'bags').exists()
    looking = start('img_viewer', port=0)

    async def act() -> None:
        recording = await Recording.connect(looking)
        assert (await recording.ask([1]))['message'].startswith('control is off')

    run_page(act())


def test_folder_that_cannot_be_used(start: Start, tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'file')
    assert viewer.finish() == 1
    assert (f'record_dir {tmp_path}/file cannot be used: it is a file or a broken link; set '
            'record_dir to a folder') in viewer.output
    assert 'Traceback' not in viewer.output


@pytest.mark.thorough
def test_folder_without_permission(
        start: Start, tmp_path: Path, mount_namespace: tuple[str, ...]) -> None:
    within = [*mount_namespace, 'sh', '-c',
              f'mount -t tmpfs -o ro none {tmp_path}/bags && exec "$@"', 'sh']
    (tmp_path / 'bags').mkdir()
    viewer = start('img_viewer', within=within, port=0, control='true',
                   record_dir=tmp_path / 'bags')
    assert viewer.finish() == 1
    assert f'record_dir {tmp_path}/bags cannot be used: Read-only file system' in viewer.output
    assert 'Traceback' not in viewer.output


@pytest.mark.thorough
def test_topic_without_frames_and_topic_that_ends(
        start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    camera = Camera(node, '/image')

    async def act() -> None:
        recording = await Recording.connect(viewer)
        assert (await recording.ask(await recording.numbers('/image')))['ok']
        state = await recording.state(lambda state: state['problem'])
        assert state['problem'].startswith('no frames of /image: ')
        assert state['name'] == ''
        await publishing(lambda: camera.publish(GRAY), recording.state(
            lambda state: state['frames'] and not state['problem']))
        camera.destroy()
        await recording.state(lambda state: state['problem'].startswith('no frames of /image: '))
        assert (await recording.ask(False))['ok']

    run_page(act())
    (bag,) = recorded_files(folder)
    assert '/image' in images_in(bag)
    assert 'Traceback' not in viewer.output


@pytest.mark.thorough
def test_silent_topics_have_reasons_of_their_own(
        start: Start, node: Node, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'bags')
    cameras = [Camera(node, f'/image{number}') for number in range(5)]
    names = [camera.publisher.topic_name for camera in cameras]

    async def act() -> None:
        recording = await Recording.connect(viewer)
        assert (await recording.ask(await recording.numbers(*names)))['ok']
        cameras[1].destroy()
        found = re.compile('; '.join([
            r'no frames of /image0: no frame arrives from the publisher of /image0 \(node /\S+\)',
            r'no frames of /image1: no publisher on /image1',
            r'no frames of /image2: no frame arrives from the publisher of /image2 \(node /\S+\)',
            'and 2 more']))
        await recording.state(lambda state: found.fullmatch(state['problem']))

    run_page(act())


def test_disparity(start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    publisher = node.create_publisher(DisparityImage, '/disparity', 10)
    numbers = np.arange(20, dtype=np.float32)
    image = Image(height=4, width=5, encoding='32FC1', step=20, data=numbers.tobytes())
    message = DisparityImage(image=image)

    async def act() -> None:
        recording = await Recording.connect(viewer)
        assert (await recording.ask(await recording.numbers('/disparity')))['ok']
        await until(lambda: publisher.get_subscription_count() > 0)
        for message.header.stamp.sec in range(1, 4):
            publisher.publish(message)
        await recording.state(lambda state: state['frames'] == 3)
        assert (await recording.ask(False))['ok']

    run_page(act())
    (path,) = recorded_files(folder)
    bag = Bag(path)
    with closing(bag):
        assert [(one.header.sec, one.encoding, bytes(one.data)) for one in (
            cdr_to_image(message.load()) for message in bag.messages([*bag.topics]))
        ] == [(sec, '32FC1', numbers.tobytes()) for sec in range(1, 4)]


def test_recording_without_a_frame(start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    camera = Camera(node, '/image')

    async def act() -> None:
        recording = await Recording.begin(viewer, camera)
        assert await recording.ask(False) == {
            'ok': True, 'message': 'Recorded 0 frames: none has arrived'}

    run_page(act())
    assert recorded_files(folder) == []


@pytest.mark.thorough
def test_removed_folder(start: Start, node: Node, tmp_path: Path) -> None:
    folder = tmp_path / 'bags'
    viewer = start('img_viewer', port=0, control='true', record_dir=folder)
    camera = Camera(node, '/image')

    async def act() -> None:
        recording = await Recording.connect(viewer)
        assert (await recording.ask(await recording.numbers('/image')))['ok']
        await publishing(lambda: camera.publish(GRAY), recording.state(
            lambda state: state['frames'] > 3))
        shutil.rmtree(folder)
        await publishing(lambda: camera.publish(GRAY), recording.state(
            lambda state: 'was removed' in state['problem']))
        await publishing(lambda: camera.publish(GRAY), until(lambda: recorded_files(folder)))
        assert (await recording.ask(False))['ok']

    run_page(act())
    (bag,) = recorded_files(folder)
    assert images_in(bag)['/image']
    assert 'Traceback' not in viewer.output


@pytest.fixture
def disk(tmp_path: Path, mount_namespace: tuple[str, ...]) -> tuple[Path, list[str]]:
    """Return a folder, and the prefix of a command that has a disk of 1030 MB there."""
    folder = tmp_path / 'disk'
    folder.mkdir()
    return folder, [*mount_namespace, 'sh', '-c',
                    f'mount -t tmpfs -o size=1030000000 none {folder} && exec "$@"', 'sh']


@pytest.mark.thorough
def test_recording_ends_before_the_disk_is_full(
        start: Start, node: Node, disk: tuple[Path, Sequence[str]]) -> None:
    folder, within = disk
    viewer = start('img_viewer', within=within, port=0, control='true', record_dir=folder)
    camera = Camera(node, '/image')
    large = np.zeros((1000, 1000, 3), np.uint8)
    sentence = re.compile(r'the disk has \d+ MB left, and recordings leave 1000 MB free')

    async def act() -> None:
        recording = await Recording.connect(viewer)
        numbers = await recording.numbers('/image')
        assert (await recording.ask(numbers))['ok']
        await camera.seen()
        state = await publishing(lambda: camera.publish(large), recording.state(
            lambda state: not state['phase'] and state['frames']))
        assert sentence.fullmatch(state['problem'])
        assert state['left'] < 10**9 and state['frames'] >= 5
        await until(lambda: camera.publisher.get_subscription_count() == 0)
        refused = await recording.ask(numbers)
        while 'less than a second' in refused['message']:
            refused = await recording.ask(numbers)
        assert sentence.match(refused['message'])
        await recording.page.send(subscribe='/image')  # the pictures go on
        await publishing(lambda: camera.publish(GRAY), recording.page.picture())

    run_page(act())
    (bag,) = recorded_files(Path(f'/proc/{viewer.pid}/root{folder}'))
    assert not Bag(bag).warnings
    assert 'Recording limit reached: the disk has' in viewer.output
    assert 'Traceback' not in viewer.output


@pytest.mark.thorough
def test_full_disk(start: Start, node: Node, tmp_path: Path) -> None:
    viewer = start('img_viewer', port=0, control='true', record_dir=tmp_path / 'bags')
    camera = Camera(node, '/image')
    large = np.zeros((2000, 2000, 3), np.uint8)

    async def act() -> None:
        recording = await Recording.begin(viewer, camera)
        # A disk that has no room although `statvfs` says so: no file may be larger.
        subprocess.run(['prlimit', f'--pid={viewer.pid}', '--fsize=13000000:'], check=True)
        await publishing(lambda: camera.publish(large), recording.state(
            lambda state: 'a frame was not written: File too large' in state['problem']))
        await recording.page.send(subscribe='/image')
        await publishing(lambda: camera.publish(large), recording.page.picture())
        subprocess.run(['prlimit', f'--pid={viewer.pid}', '--fsize=unlimited:'], check=True)
        await publishing(lambda: camera.publish(GRAY), recording.state(
            lambda state: state['failed'] and not state['problem']))
        assert (await recording.ask(False))['ok']

    run_page(act())
    assert 'Traceback' not in viewer.output
