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

"""Pictures of ``img_viewer`` as a page gets them."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from typing import Any

from conftest import NodeProcess
import cv2
import numpy as np
from opencv_tools.image_codecs import encode_image
from opencv_tools.viewer.protocol import WIDTHS
import pytest
from rclpy.node import Node
from sending import stamped
from std_msgs.msg import String
from viewing import address_of, Camera, fetch, Page, PausedPage, publishing, run_page
from waiting import LONGEST_SECONDS, pause_loop, until

Start = Callable[..., NodeProcess]
GRAY = np.full((48, 64, 3), 90, np.uint8)


@pytest.fixture
def viewer(start: Start) -> NodeProcess:
    """Start a viewer on any free port."""
    return start('img_viewer', port=0)


def gradient(width: int, height: int) -> np.ndarray:
    """Return a colour image that a JPEG hardly changes."""
    rows, columns = np.mgrid[:height, :width]
    return np.dstack((columns * 255 // width, rows * 255 // height,
                      np.full((height, width), 90))).astype(np.uint8)


async def listed(page: Page, *names: str) -> None:
    """Wait until topics are in the list."""
    while not {topic['name'] for topic in await page.text('topics')} >= {*names}:
        pass


def test_raw_image_is_scaled(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'front/image')
    image = gradient(640, 480)

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        hello = await page.text('hello')
        assert (hello['control'], hello['token'], hello['widths']) == (False, '', list(WIDTHS))
        await listed(page, '/front/image')
        await page.send(subscribe='/front/image', width=300)
        await camera.seen()
        camera.publish(image)
        picture = await page.picture()
        assert picture.stamp == 1.0
        assert picture.sequence == 1
        shown = picture.pixels
        assert shown.shape == (240, 320, 3)  # the next of the shared widths
        assert np.abs(shown.astype(int) - cv2.resize(image, (320, 240))).max() < 16
        state = await page.status(lambda state: state['sent'])
        assert (state['name'], state['width'], state['height'], state['encoding']) == (
            '/front/image', 640, 480, 'bgr8')
        assert (state['frames'], state['lost'], state['broken']) == (1, 0, 0)
        assert state['id'] == picture.topic
        assert (state['sent']['width'], state['sent']['passed_through']) == (320, False)

    run_page(look())


def test_compressed_images_pass_byte_for_byte(viewer: NodeProcess, node: Node) -> None:
    raw, camera = Camera(node, 'image'), Camera(node, 'image/compressed', compressed=True)
    jpegs = [encode_image(gradient(640, 480 - 2 * number), '.jpg').tobytes()
             for number in range(5)]

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/image')
        await page.send(subscribe='/image')
        await camera.seen()
        for jpeg in jpegs:
            camera.publish_compressed(jpeg)
            assert (await page.picture()).data == jpeg
        assert raw.publisher.get_subscription_count() == 0

    run_page(look())


def test_viewers_share_encodings(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')
    frames, widths = 5, (160, 160, 150, 320)

    async def look() -> None:
        pages = [await Page.connect(address_of(viewer)) for _ in widths]
        for page, width in zip(pages, widths):
            await listed(page, '/image')
            await page.send(subscribe='/image', width=width)
            await page.status(lambda state: state['name'] == '/image')
        await camera.seen()
        for number in range(1, frames + 1):
            camera.publish(gradient(640, 480))
            pictures = [await page.picture() for page in pages]
            assert [picture.stamp for picture in pictures] == [number] * len(pages)
            assert len({picture.data for picture in pictures}) == 2
        state = await pages[0].status(lambda state: state['frames'] == frames)
        assert state['encodings'] == 2 * frames

    run_page(look())


def test_busy_page_gets_the_newest_frame_and_delays_no_other(
        viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')

    async def look() -> None:
        url = address_of(viewer)
        busy, quick = await Page.connect(url), await Page.connect(url)
        for page in (busy, quick):
            await listed(page, '/image')
            await page.send(subscribe='/image')
            await page.status(lambda state: True)
        await camera.seen()
        camera.publish(GRAY)
        first = await busy.picture(answers=False)
        assert (await quick.picture()).stamp == first.stamp == 1
        for number in range(2, 12):
            camera.publish(GRAY)
            assert (await quick.picture()).stamp == number
        state = await busy.status(lambda state: state['frames'] == 11)
        assert state['sent']['rate'] == 0  # a second picture would have arrived before this text
        await busy.send(got=first.sequence)
        second = await busy.picture()
        assert (second.stamp, second.sequence) == (11, first.sequence + 1)

    run_page(look())


@pytest.mark.thorough
def test_page_that_reads_nothing_delays_no_other(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')
    noise = np.random.default_rng(5).integers(0, 255, (1080, 1920, 3), np.uint8)

    async def look() -> None:
        url = address_of(viewer)
        deaf, quick = await Page.connect(url), await Page.connect(url)
        await listed(quick, '/image')
        await deaf.send(subscribe='/image', fixed=True, quality=100)
        await quick.send(subscribe='/image', width=160)
        await camera.seen()
        stamps = []
        for _ in range(20):
            picture = await publishing(lambda: camera.publish(noise), quick.picture())
            stamps.append(picture.stamp)
        assert stamps == sorted(set(stamps))
        deaf.socket.stream.close()  # as a page that crashes
        topic = {'viewers': 2}
        while topic['viewers'] > 1:
            (topic,) = json.loads((await fetch(url, '/topics')).body)['topics']

    run_page(look())
    viewer.interrupt()
    assert viewer.finish() == 0
    assert 'ERROR' not in viewer.output


def test_latched_picture_reaches_every_page(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'map', latched=True)
    camera.publish(gradient(64, 48))

    async def look() -> None:
        url = address_of(viewer)
        first, second = await Page.connect(url), await Page.connect(url)
        for page in (first, second):
            await listed(page, '/map')
            await page.send(subscribe='/map')
            assert (await page.picture()).stamp == 1
        state = await first.status(lambda state: state['quiet'] > 2)
        assert state['reason'] == ''  # there is nothing to wait for
        answer = await fetch(url, '/snapshot?topic=/map')
        assert answer.code == 200

    run_page(look())


def test_publisher_restarts_with_another_size_and_transport(
        viewer: NodeProcess, node: Node) -> None:
    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        camera = Camera(node, 'image')
        await listed(page, '/image')
        await page.send(subscribe='/image')
        await camera.seen()
        camera.publish(gradient(640, 480))
        assert (await page.picture()).pixels.shape == (480, 640, 3)
        camera.destroy()
        state = await page.status(lambda state: state['reason'])
        assert state['reason'].startswith('no publisher on /image')
        camera = Camera(node, 'image')
        await camera.seen()
        camera.publish(gradient(320, 200), 'rgb8')
        assert (await page.picture()).pixels.shape == (200, 320, 3)
        await page.status(lambda state: (state['width'], state['encoding']) == (320, 'rgb8'))
        camera.destroy()
        camera = Camera(node, 'image/compressed', compressed=True)
        jpeg = encode_image(gradient(160, 120), '.jpg').tobytes()
        picture = await publishing(lambda: camera.publish_compressed(jpeg), page.picture())
        assert picture.data == jpeg

    run_page(look())


@pytest.mark.thorough
@pytest.mark.parametrize(('number', 'transport'), [
    (signal.SIGINT, 'raw'), (signal.SIGKILL, 'auto')])
def test_camera_that_starts_again(
        number: signal.Signals, transport: str, start: Start) -> None:
    viewer = start('img_viewer', port=0, transport=transport)
    cameras = [start('img_publisher', source='pattern:64x48', publish_rate=20.0)]

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/video_frames')
        await page.send(subscribe='/video_frames')
        state = await page.status(lambda state: state['frames'] > 40)
        assert state['restarted'] is None
        cameras[0].interrupt(number)
        cameras[0].finish()
        cameras.append(start('img_publisher', source='pattern:64x48', publish_rate=20.0))
        state = await page.status(lambda state: state['restarted'] is not None)
        frames = state['frames']
        # Another camera joins, which is no restart.
        cameras.append(start('img_publisher', source='pattern:64x48', publish_rate=20.0))
        before = state['restarted']
        state = await page.status(lambda state: state['frames'] > frames + 200)
        assert state['restarted'] > before + 4

    run_page(look())


@pytest.mark.thorough
def test_broken_images_are_left_out_and_counted(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image/compressed', compressed=True)
    jpeg = encode_image(gradient(320, 240), '.jpg').tobytes()

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/image')
        await page.send(subscribe='/image')
        await camera.seen()
        for number, broken in enumerate((jpeg[:-100], b'', b'rubbish' * 1000), 1):
            camera.publish_compressed(broken)
            await page.status(lambda state, number=number: state['broken'] == number)
        camera.publish_compressed(jpeg)
        picture = await page.picture()
        assert (picture.stamp, picture.data, picture.sequence) == (4, jpeg, 1)
        assert (await page.status(lambda state: state['sent']))['broken'] == 3

    run_page(look())
    assert 'frame of /image left out' in viewer.output


@pytest.mark.thorough
def test_reason_of_a_broken_image(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/image')
        await page.send(subscribe='/image')
        await camera.seen()

        def publish(encoding: str) -> None:
            message = stamped(GRAY, 'bgr8', 0)
            message.encoding = encoding
            camera.publisher.publish(message)

        def shows(text: str) -> Callable[[dict[str, Any]], bool]:
            return lambda state: text in state['reason'] and state['broken'] > 3

        await publishing(lambda: publish('foo8'), page.status(shows('[foo8]')))
        await publishing(lambda: publish('bgr8'), page.status(lambda state: not state['reason']))
        await publishing(lambda: publish('foo9'), page.status(shows('[foo9]')))
        count = (await page.status(lambda state: True))['broken']
        await publishing(lambda: publish('foo9'), page.status(
            lambda state: state['broken'] > count + 30))

    run_page(look())
    assert viewer.output.count('frame of /image left out') == 2


@pytest.fixture(scope='module')
def large_jpeg() -> bytes:
    """Return a picture that the buffers of a connection cannot hold."""
    noise = np.random.default_rng(5).integers(0, 255, (2000, 2500, 3), np.uint8)
    return encode_image(noise, '.jpg', 100).tobytes()


@pytest.mark.thorough
def test_answer_to_a_picture_that_is_not_sent(
        viewer: NodeProcess, node: Node, large_jpeg: bytes) -> None:
    camera = Camera(node, 'image/compressed', compressed=True)

    async def look() -> None:
        url = address_of(viewer)
        paused, quick = await PausedPage.connect(url), await Page.connect(url)
        await listed(quick, '/image')
        paused.send(subscribe='/image')
        await paused.begin_of(b'"status"')
        await quick.send(subscribe='/image')
        await quick.status(lambda state: True)
        await camera.seen()
        camera.publish_compressed(large_jpeg)
        await quick.picture()
        await quick.read_until(paused.begin_of())
        paused.send(got=1)
        await quick.read_until(paused.end())
        camera.publish_compressed(large_jpeg)
        assert (await quick.picture()).stamp == 2

    run_page(look())


@pytest.mark.thorough
def test_unread_pictures_of_topics_that_a_page_has_left(
        viewer: NodeProcess, node: Node, large_jpeg: bytes) -> None:
    camera = Camera(node, 'image/compressed', compressed=True)

    async def look() -> None:
        url = address_of(viewer)
        deaf, quick = await Page.connect(url), await Page.connect(url)
        await listed(quick, '/image')
        await quick.send(subscribe='/image')
        await camera.seen()
        camera.publish_compressed(large_jpeg)
        await quick.picture()
        for _ in range(20):
            await deaf.send(subscribe='/image')
            await pause_loop(0.1)
            await deaf.send(unsubscribe='/image')
        assert await deaf.close_code() in (1008, None)

    run_page(look())


def test_depth_has_a_range(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'depth')
    depth = np.tile(np.linspace(1000, 3000, 64).astype(np.uint16), (48, 1))

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/depth')
        await page.send(subscribe='/depth', colors='gray')
        await camera.seen()
        camera.publish(depth, '16UC1')
        shown = (await page.picture()).pixels
        assert shown[24, 0] < 8
        assert shown[24, -1] > 247
        state = await page.status(lambda state: state['range'])
        assert (state['range'], state['unit']) == ([depth[0, 1], depth[0, -2]], 'mm')
        await page.send(subscribe='/depth', range=[0, 6000], colors='gray')  # the same frame again
        shown = (await page.picture()).pixels
        assert abs(int(shown[24, -1]) - 128) < 8
        await page.send(subscribe='/depth', range=[0, 6000])
        assert (await page.picture()).pixels.shape == (48, 64, 3)

    run_page(look())


def test_each_page_has_the_range_of_its_own_picture(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'depth', latched=True)
    depth = np.tile(np.linspace(1000, 3000, 64).astype(np.uint16), (48, 1))
    camera.publish(depth, '16UC1')

    async def look() -> None:
        url = address_of(viewer)
        fixed, automatic = [await Page.connect(url) for _ in range(2)]
        for page, options in ((automatic, {}), (fixed, {'range': [0, 500]})):
            await listed(page, '/depth')
            await page.send(subscribe='/depth', **options)
            await page.picture()
        for _ in range(2):  # the fixed picture is the last one that was encoded
            assert (await fixed.status(lambda state: state['range']))['range'] == [0, 500]
            low, high = (await automatic.status(lambda state: state['range']))['range']
            assert 1000 <= low < high <= 3000

    run_page(look())


def test_topics_of_another_type_and_unknown_topics(viewer: NodeProcess, node: Node) -> None:
    chatter, camera = node.create_publisher(String, 'chatter', 10), Camera(node, 'image')

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/image')
        for name in ('/chatter', '/nothing', '/bad name', '/'):
            await page.send(subscribe=name)
            assert (await page.text('error')).endswith(
                'is not an image topic; the image topics are /image')
        await page.send(subscribe='/image')
        await camera.seen()
        camera.publish(GRAY)
        assert (await page.picture()).stamp == 1
        assert chatter.get_subscription_count() == 0

    run_page(look())


def test_reason_of_silence_and_the_chosen_topics(start: Start, node: Node) -> None:
    viewer = start('img_viewer', port=0, topics="'/front/*, rear'")
    cameras = [Camera(node, name) for name in ('front/image', 'rear', 'rear/other')]

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front/image', '/rear')
        await page.send(subscribe='/rear')
        state = await page.status(lambda state: state['reason'])
        assert state['reason'].startswith(
            'no frame arrives from the publisher of /rear (node /plain)')
        assert state['quiet'] is None
        await page.send(subscribe='/rear/other')
        assert 'the image topics are /front/image, /rear' in await page.text('error')

    run_page(look())
    assert cameras[2].publisher.get_subscription_count() == 0


@pytest.mark.thorough
def test_rate_is_limited(start: Start, node: Node) -> None:
    viewer = start('img_viewer', port=0, rate=2.0)
    camera = Camera(node, 'image')

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/image')
        await page.send(subscribe='/image', rate=100)
        await camera.seen()

        async def read() -> float:
            return [(await page.picture()).sent for _ in range(6)][-1]

        start_time = time.time()
        sixth = await publishing(lambda: camera.publish(GRAY), read())
        # Five periods of 0.5 s, of which one may be halved. The first may come late.
        assert sixth - start_time >= 2.2

    run_page(look())


@pytest.mark.thorough
def test_opened_and_closed_pages_leave_nothing(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')
    descriptors = Path('/proc', str(viewer.pid), 'fd')

    def sockets() -> int:
        links = []
        for descriptor in descriptors.iterdir():
            try:
                links.append(str(descriptor.readlink()))
            except FileNotFoundError:
                continue
        return sum(link.startswith('socket:') for link in links)

    async def look() -> None:
        url = address_of(viewer)
        page = await Page.connect(url)
        await listed(page, '/image')
        page.socket.close()
        await page.close_code()
        before = sockets()
        for number in range(200):
            page = await Page.connect(url)
            await page.send(subscribe='/image', width=160)
            if number % 50 == 0:
                await page.text('status')
            if number % 2:
                page.socket.close()
            else:
                page.socket.stream.close()  # as a page that crashes
        await until(lambda: sockets() <= before)
        await until(lambda: camera.publisher.get_subscription_count() == 0)
        page = await Page.connect(url)
        await page.send(subscribe='/image')
        await camera.seen()
        camera.publish(GRAY)
        assert (await page.picture()).sequence == 1

    run_page(look())


def test_pages_are_limited(start: Start) -> None:
    viewer = start('img_viewer', port=0, viewers=2)

    async def look() -> None:
        url = address_of(viewer)
        pages = [await Page.connect(url) for _ in range(2)]
        with pytest.raises(Exception, match='503'):
            await Page.connect(url)
        answer = await fetch(url, '/stream?topic=/image')
        assert answer.code == 503
        assert answer.body.decode().startswith('2 pages look already')
        pages[0].socket.close()
        await pages[0].close_code()
        assert await (await Page.connect(url)).text('hello')

    run_page(look())


async def answer_to(page: Page, **question: Any) -> dict[str, Any]:
    """Return the answer to a question about pixels."""
    await page.send(**question)
    return await page.text(next(iter(question)))


async def look_into(page: Page, camera: Camera, **options: Any) -> int:
    """Look into a topic, and return the number of its picture."""
    await page.send(subscribe=camera.publisher.topic_name, looks=True, **options)
    return (await page.picture()).sequence


def test_questions_about_the_pixels_of_the_shown_frame(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'front', latched=True)
    first, second = (np.full((48, 64, 3), (level, 2, 3), np.uint8) for level in (1, 200))
    camera.publish(first)

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front')
        number = await look_into(page, camera)
        pixel = {'pixel': '/front', 'at': [63, 47]}
        assert await answer_to(page, **pixel, picture=number) == {
            'topic': '/front', 'picture': number, 'text': 'B 1, G 2, R 3'}
        camera.publish(second)
        shown = await page.read()
        while isinstance(shown, dict):
            shown = await page.read()
        # The page has not drawn the second picture yet, and asks about the first one.
        assert (await answer_to(page, **pixel, picture=number))['text'] == 'B 1, G 2, R 3'
        await page.send(got=shown.sequence)
        later = await answer_to(page, **pixel, picture=shown.sequence)
        assert later['text'] == 'B 200, G 2, R 3'
        assert 'no more' in (await answer_to(page, **pixel, picture=number))['error']
        line = await answer_to(page, profile='/front', picture=shown.sequence,
                               **{'from': [0, 0], 'to': [9, 0]})
        assert line['curves'] == [[200] * 10, [2] * 10, [3] * 10]
        counts = await answer_to(page, histogram='/front', picture=shown.sequence, region=None)
        assert counts['curves'][0][50] == 1
        assert 'there is no pixel 64, 0' in (await answer_to(
            page, pixel='/front', at=[64, 0], picture=shown.sequence))['error']

    run_page(look())


@pytest.mark.thorough
def test_region_of_a_large_image(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'front', latched=True)
    image = gradient(3840, 2160)
    camera.publish(image)

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front')
        await page.send(subscribe='/front', width=1280)
        whole = await page.picture()
        assert whole.place == (0, 0, 3840, 2160, 3840, 2160)
        await page.send(subscribe='/front', width=1280, region=[1001, 500, 640, 360])
        part = await page.picture()
        assert part.place == (1000, 500, 642, 360, 3840, 2160)
        assert part.pixels.shape == (360, 642, 3)
        assert np.abs(part.pixels.astype(int) - image[500:860, 1000:1642]).max() < 12
        await page.send(subscribe='/front', width=1280, region=[9000, 9000, 10, 10])
        assert (await page.picture()).place == whole.place

    run_page(look())


def test_held_picture(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'front', latched=True)
    camera.publish(gradient(640, 480))

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/front')
        await look_into(page, camera)
        held = {'subscribe': '/front', 'looks': True, 'held': True}
        await page.send(**held)
        await page.read_until(until(lambda: camera.publisher.get_subscription_count() == 0))
        camera.publish(GRAY)
        await page.send(**held, region=[100, 100, 64, 48])
        part = await page.picture()
        assert part.place == (100, 100, 64, 48, 640, 480)
        values = ', '.join(f'{name} {value}' for name, value in zip(
            'BGR', gradient(640, 480)[5, 600], strict=True))
        assert (await answer_to(page, pixel='/front', picture=part.sequence, at=[600, 5])
                )['text'] == values
        await page.send(subscribe='/front', looks=True)
        while (await page.picture()).place[4:] != (64, 48):
            pass  # the publisher keeps both images
        await page.send(unsubscribe='/front')
        await page.send(**held)  # there is no picture to hold
        await until(lambda: camera.publisher.get_subscription_count() == 0)
        assert 'no more' in (await answer_to(
            page, pixel='/front', picture=part.sequence, at=[0, 0]))['error']

    run_page(look())


def test_picture_that_is_held_twice_leaves_that_of_another_page(
        viewer: NodeProcess, node: Node) -> None:
    camera, rear = Camera(node, 'front', latched=True), Camera(node, 'rear')
    camera.publish(GRAY)

    async def look() -> None:
        url = address_of(viewer)
        other, page = [await Page.connect(url) for _ in range(2)]
        for one in (other, page):
            await listed(one, '/front')
            await one.send(codecs=['h264'])
            await look_into(one, camera)
        for options in ({'looks': True}, {'video': True}, {'looks': True, 'video': True}):
            await page.send(subscribe='/front', held=True, **options)
        await page.send(ping=1)
        await page.text('pong')
        await other.send(subscribe='/rear')
        await other.read_until(rear.seen())
        await other.send(unsubscribe='/rear')  # a topic that is unused from later on
        await page.read_until(until(lambda: rear.publisher.get_subscription_count() == 0))
        assert camera.publisher.get_subscription_count() == 1
        camera.publish(GRAY)
        await other.picture()
        page.socket.close()
        await other.send(ping=2)
        await other.text('pong')

    run_page(look())
    viewer.interrupt()
    assert viewer.finish() == 0
    assert 'Traceback' not in viewer.output and 'KeyError' not in viewer.output


def test_questions_of_a_hostile_page(viewer: NodeProcess, node: Node) -> None:
    cameras = [Camera(node, f'front_{number}', latched=True) for number in range(6)]
    for camera in cameras:
        camera.publish(GRAY)

    async def look() -> None:
        url = address_of(viewer)
        page = await Page.connect(url)
        await listed(page, *(camera.publisher.topic_name for camera in cameras))
        numbers = [await look_into(page, camera) for camera in cameras]
        answers = [await answer_to(page, pixel=f'/front_{place}', picture=number, at=[0, 0])
                   for place, number in enumerate(numbers)]
        # The frames of four topics are kept.
        assert ['error' in answer for answer in answers] == [False] * 4 + [True] * 2
        for wrong in ({'pixel': '/front_0'}, {'pixel': 5, 'at': [0, 0]},
                      {'pixel': '/front_0', 'picture': 1, 'at': [-1, 0]},
                      {'pixel': '/front_0', 'picture': 'a', 'at': [0, 0]},
                      {'profile': '/front_0', 'picture': 1, 'from': [0, 0]},
                      {'histogram': '/front_0', 'picture': 1, 'region': [0]},
                      {'subscribe': '/front_0', 'region': [0, 0, 0, 0]}):
            await page.send(**wrong)
            assert await page.text('error')
        for _ in range(3000):
            page.socket.write_message(json.dumps(
                {'histogram': '/front_0', 'picture': numbers[0], 'region': None}))
        await page.send(ping=7)
        answered = 0
        while True:
            message = await page.read()
            if isinstance(message, dict) and 'pong' in message:
                break
            answered += isinstance(message, dict) and 'histogram' in message
        assert answered < 3000  # a question replaces one that waits
        await page.send(subscribe='/front_0', video=True, held=True)
        assert (await fetch(url, '/healthz')).body == b'ok\n'

    run_page(look())
    viewer.interrupt()
    assert viewer.finish() == 0
    assert 'Traceback' not in viewer.output


@pytest.mark.thorough
def test_steps_of_a_hostile_page(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'front', latched=True)
    camera.publish(GRAY)

    async def look() -> None:
        url = address_of(viewer)
        page = await Page.connect(url)
        await listed(page, '/front')
        await look_into(page, camera)
        await page.send(step='/front', by=-1)
        assert 'pause' in (await page.text('step'))['error']
        await page.send(subscribe='/front', looks=True, held=True)
        for wrong in ({'step': 5, 'by': 1}, {'step': '/front'}, {'step': '/front', 'by': 'b'},
                      {'step': '/front', 'by': -10**30}, {'step': '/front', 'by': 1, 'beside': 5}):
            await page.send(**wrong)
            assert await page.text('error')
        for _ in range(3000):
            page.socket.write_message(json.dumps({'step': '/front', 'by': -1, 'beside': '/no'}))
        await page.send(ping=7)
        answers = []
        while True:
            message = await page.read()
            if isinstance(message, dict) and 'pong' in message:
                break
            if isinstance(message, dict) and 'step' in message:
                answers.append(message['step'])
            elif not isinstance(message, dict):
                await page.send(got=message.sequence)
        assert len(answers) < 3000  # a step replaces one that waits
        assert all(one['text'] == 'frame 1 of 1, 0.0 s before, the first one' for one in answers)
        assert (await fetch(url, '/healthz')).body == b'ok\n'

    run_page(look())
    viewer.interrupt()
    assert viewer.finish() == 0
    assert 'Traceback' not in viewer.output


def test_rubbish_in_the_websocket(viewer: NodeProcess) -> None:
    async def look() -> None:
        url = address_of(viewer)
        page = await Page.connect(url)
        rubbish = ('', 'x', '[]', '{"got": "a"}', '{"got": 5}', '{"subscribe": 5}',
                   '{"subscribe": "/a", "width": -1}', '{"unsubscribe": null}', '{}')
        for text in rubbish:
            await page.socket.write_message(text)
            assert await page.text('error')
        await page.send(ping=7)
        assert await page.text('pong') == 7
        await page.socket.write_message(bytes(100), binary=True)  # the tenth
        assert await page.close_code() == 1008
        page = await Page.connect(url)
        await page.socket.write_message('x' * 5000)
        assert await page.close_code() in (1009, None)  # Tornado may close without a code
        assert (await fetch(url, '/healthz')).body == b'ok\n'

    run_page(look())


def test_open_pages_do_not_delay_the_end(viewer: NodeProcess, node: Node) -> None:
    camera = Camera(node, 'image')

    async def look() -> None:
        page = await Page.connect(address_of(viewer))
        await listed(page, '/image')
        await page.send(subscribe='/image')
        await camera.seen()
        viewer.interrupt()
        assert await page.close_code() == 1001

    run_page(look())
    assert viewer.finish() == 0


@pytest.mark.process
def test_tornado_is_missing(domain: int) -> None:
    script = ('import sys; sys.modules.update(tornado=None); '
              'from opencv_tools.image_viewer import main; sys.exit(main(["img_viewer"]))')
    finished = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True,
                              timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 1
    assert 'Traceback' not in finished.stderr
    assert re.search("img_viewer needs Tornado; install it with .*'pip install tornado'",
                     finished.stderr)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_idle_viewer_ends_at_a_signal(viewer: NodeProcess, number: int) -> None:
    address_of(viewer)
    viewer.interrupt(number)
    assert viewer.finish() == 0
    assert viewer.output.splitlines()[-1].endswith('Closed all pages')


def test_port_in_use(start: Start, viewer: NodeProcess) -> None:
    port = address_of(viewer).rstrip('/').rpartition(':')[2]
    second = start('img_viewer', port=port)
    assert second.finish() == 1
    assert f'port {port} of 127.0.0.1 cannot be used: Address already in use' in second.output
    assert viewer.is_running()


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize(('parameters', 'status', 'sentence'), [
    ({'address': '192.0.2.1'}, 1, 'port 8080 of 192.0.2.1 cannot be used: Cannot assign'),
    ({'address': 'no.such.host.invalid'}, 1, "address 'no.such.host.invalid' is unknown"),
    ({'certificate': '/nowhere.pem'}, 1, 'certificate /nowhere.pem and key /nowhere.pem cannot'),
    ({'key': '/nowhere.pem'}, 2, "key is '/nowhere.pem', but certificate is empty"),
    ({'token': 'short'}, 2, "parameter token is 'short': give 8 to 200"),
    ({'token_file': '/nowhere/token'}, 1, "token_file '/nowhere/token' cannot be used: No such"),
    ({'token_file': '/a', 'token': 'open-sesame'}, 2, "token_file is '/a', but token is set"),
    ({'allowed_origins': 'robot'}, 2, 'robot is not an origin: give the beginning'),
    ({'control': 'true', 'token': "''"}, 2, 'control is true and token is'),
    ({'rate': '0.0'}, 2, 'parameter rate is 0.0: give a number from 0.1 to 240'),
    ({'port': '70000'}, 2, 'parameter port is 70000')])
def test_parameters_that_cannot_be_used(
        start: Start, parameters: dict[str, str], status: int, sentence: str) -> None:
    viewer = start('img_viewer', **parameters)
    assert viewer.finish() == status
    assert sentence in viewer.output
