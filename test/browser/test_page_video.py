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

"""Video topics on the page: decoded by the browser, or sent as JPEG where it cannot decode."""

from __future__ import annotations

from collections.abc import Callable

from chromium import Browser, new_browser, Page
from conftest import NodeProcess, spin_until
from hosts import new_host
import numpy as np
from opencv_tools.image.cdr import WireHeader
from opencv_tools.topics.frame_topics import VideoTopics
from opencv_tools.video.settings import VideoSettings
from pages import Camera, numbered_frame, SCRIPT, STRIPE, Viewer
import pytest
from rclpy.node import Node
from sending import NANO

pytest_plugins = ['pages']

TOPIC = '/front/video_frames'
SHOWN = f'factOf({TOPIC!r}, "shown")'
NOTICE = 'document.getElementById("notice").textContent'

# Keeps the callbacks of each decoder.
WATCHED_DECODERS = """
window.decoders = [];
window.VideoDecoder = class extends VideoDecoder {
  constructor(callbacks) { super(callbacks); decoders.push(callbacks); }
};
"""
BROKEN_DECODERS = """
VideoDecoder.prototype.configure = () => { throw new DOMException('not here'); };
"""


class VideoCamera:
    """A publisher of numbered frames as video only."""

    def __init__(self, node: Node, topic: str = TOPIC, codec: str = 'h264') -> None:
        self.node = node
        self.topic = topic
        self.topics = VideoTopics(node, topic, VideoSettings(codec=codec))

    def publish(self, number: int, size: tuple[int, int] = (320, 240)) -> None:
        """Publish a numbered frame; its stamp is now."""
        sec, nanosec = divmod(self.node.get_clock().now().nanoseconds, NANO)
        self.topics.publish(lambda: (numbered_frame(number, *size), 'bgr8'),
                            WireHeader(sec, nanosec, 'camera'))

    def show(self, page: Page, number: int, size: tuple[int, int] = (320, 240)) -> None:
        """Publish a frame again and again, until the page draws it."""
        def is_shown() -> bool:
            self.publish(number, size)
            return bool(page.evaluate(f'numberOf({self.topic!r}) === {number}'))

        spin_until(self.node, is_shown)

    def is_watched(self) -> bool:
        """Return whether the viewer subscribes."""
        return self.topics.count_subscribers() > 0

    def wait_for_no_viewer(self) -> None:
        """Wait until the viewer has ended its subscription."""
        spin_until(self.node, lambda: not self.is_watched())


def colors(page: Page, topic: str = TOPIC) -> np.ndarray:
    """Return the colours of the stripe of a numbered frame in BGR."""
    return np.array([page.evaluate(
        f'pixel(tileOf({topic!r}).querySelector("canvas"), {x}, 0.9)')[::-1]
        for x in (0.125, 0.375, 0.625, 0.875)])


@pytest.mark.parametrize('codec', ['h264'])
def test_pixels_of_video(
        codec: str, viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = VideoCamera(camera, codec=codec), browser.new_page(viewer.url)
    for number in (1, 0x8000, 0xA5C3, 0):
        front.show(page, number)
    assert np.abs(colors(page) - np.array(STRIPE)).max() < 24
    assert codec in page.wait_for(SHOWN)
    assert page.evaluate(f'factOf({TOPIC!r}, "encoding")') == codec
    assert page.evaluate(f'factOf({TOPIC!r}, "size")') == '320 \u00d7 240'
    assert page.evaluate(NOTICE) == ''
    assert page.complaints() == []


def test_two_pages_share_a_subscription(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front = VideoCamera(camera)
    pages = [browser.new_page(viewer.url)]
    front.show(pages[0], 5)
    pages.append(browser.new_page(viewer.url))
    for page in pages:
        front.show(page, 6)
        assert 'h264' in page.wait_for(SHOWN)
    assert front.topics.count_subscribers() == 1


def test_late_page_without_another_frame(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = VideoCamera(camera), browser.new_page(viewer.url)
    front.show(page, 7)
    late = browser.new_page(viewer.url)
    late.wait_for(f'numberOf({TOPIC!r}) === 7')
    assert page.evaluate(f'numberOf({TOPIC!r})') == 7


def test_video_after_a_restart_of_the_publisher(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = VideoCamera(camera), browser.new_page(f'{viewer.url}?topic={TOPIC}')
    front.show(page, 1)
    front.topics.destroy()
    front = VideoCamera(camera)
    front.show(page, 2, (400, 302))
    page.wait_for(f'factOf({TOPIC!r}, "size") === "400 \u00d7 302"')
    assert page.complaints() == []


def test_video_after_a_restart_of_the_viewer(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    front, viewer = VideoCamera(camera), start_viewer()
    page = browser.new_page(viewer.url)
    front.show(page, 1)
    viewer.process.interrupt()
    assert viewer.process.finish() == 0
    page.wait_for('document.getElementById("state").dataset.state === "lost"')
    start_viewer(port=viewer.port)
    front.show(page, 2)
    assert 'h264' in page.wait_for(SHOWN)
    page.wait_for(f'{NOTICE} === ""')


def test_odd_size(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = VideoCamera(camera), browser.new_page(viewer.url)
    front.show(page, 3, (321, 241))
    assert page.evaluate(f'[tileOf({TOPIC!r}).querySelector("canvas")].map('
                         '({width, height}) => [width, height])') == [[321, 241]]


def test_hidden_page_gets_no_video(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = VideoCamera(camera), browser.new_page(viewer.url)
    front.show(page, 1)
    page.hide()
    front.wait_for_no_viewer()
    page.show()
    front.show(page, 2)
    assert {one['number'] for one in page.evaluate('drawn')} <= {1, 2}


def test_decoder_after_an_error(viewer: Viewer, camera: Node) -> None:
    with new_browser(script=SCRIPT + WATCHED_DECODERS) as watched:
        front, page = VideoCamera(camera), watched.new_page(viewer.url)
        front.show(page, 1)
        for number in (2, 3):
            count = page.evaluate('decoders.length')
            page.evaluate('decoders.at(-1).error(new DOMException("damaged"))')
            front.show(page, number)
            assert page.evaluate('decoders.length') > count
        assert page.evaluate('sent.filter(({ key }) => key).length') >= 2
        assert 'h264' in page.wait_for(SHOWN)


def test_decoder_that_always_fails(viewer: Viewer, camera: Node) -> None:
    with new_browser(script=SCRIPT + BROKEN_DECODERS) as poor:
        front, page = VideoCamera(camera), poor.new_page(viewer.url)
        front.show(page, 4)
        assert 'quality' in page.wait_for(SHOWN)


def test_jpeg_page_beside_a_video_page(
        viewer: Viewer, browser: Browser, camera: Node) -> None:
    front = VideoCamera(camera)
    page, other = browser.new_page(viewer.url), browser.new_page(f'{viewer.url}?width=160')
    for number in (9, 10):
        front.show(page, number)
        front.show(other, number)
    assert 'h264' in page.wait_for(SHOWN)
    assert 'quality' in other.wait_for(SHOWN)
    assert other.evaluate(f'tileOf({TOPIC!r}).querySelector("canvas").width') == 160
    assert front.topics.count_subscribers() == 2


def test_video_never(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer(video='never')
    front, page = VideoCamera(camera), browser.new_page(viewer.url)
    front.show(page, 4)
    assert 'quality' in page.wait_for(SHOWN)
    assert page.evaluate(NOTICE) == ''


def test_raw_topic_stays_jpeg(viewer: Viewer, browser: Browser, camera: Node) -> None:
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    front.show(page, 4)
    assert 'quality' in page.wait_for(SHOWN)


def test_raw_topic_as_video(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer(video='always')
    front, page = Camera(camera, TOPIC), browser.new_page(viewer.url)
    for number in (1, 0xA5C3, 2):
        front.show(page, number)
    assert 'h264' in page.wait_for(SHOWN)
    late = browser.new_page(viewer.url)
    late.wait_for(f'numberOf({TOPIC!r}) === 2')
    front.show(late, 3)
    page.wait_for(f'numberOf({TOPIC!r}) === 3')


def test_depth_stays_jpeg(
        start_viewer: Callable[..., Viewer], browser: Browser, camera: Node) -> None:
    viewer = start_viewer(video='always')
    depth, page = Camera(camera, '/depth'), browser.new_page(viewer.url)
    depth.wait_for_viewer()

    def is_shown() -> bool:
        depth.publish_image(np.eye(48, 64, dtype=np.uint16), '16UC1')
        return bool(page.evaluate('factOf("/depth", "shown")?.includes("quality")'))

    spin_until(camera, is_shown)
    assert '16UC1' in page.evaluate(NOTICE)


def test_created_certificate_makes_a_page_secure(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer]) -> None:
    with new_host('10.77.0.1') as host:
        host.run('ip', 'address', 'add', '10.77.0.1/24', 'dev', 'lo')
        start('img_publisher', within=host.within, source='pattern:320x240@10', publish_rate=10.0)
        viewer = start_viewer(within=host.within, address='10.77.0.1', certificate='auto')
        assert viewer.url.startswith('https://10.77.0.1:')
        viewer.process.wait_for('its SHA-256 is ')
        options = ['--ignore-certificate-errors']
        with new_browser(host.within, SCRIPT, options) as browser:
            page = browser.new_page(viewer.url)
            page.wait_for('factOf("/video_frames", "shown")?.includes("h264")')
            assert page.evaluate('isSecureContext')
            assert page.evaluate(NOTICE) == ''


def test_video_on_an_insecure_page(
        start: Callable[..., NodeProcess], start_viewer: Callable[..., Viewer]) -> None:
    with new_host('10.77.0.1') as host:
        host.run('ip', 'address', 'add', '10.77.0.1/24', 'dev', 'lo')
        start('img_publisher', within=host.within, source='pattern:320x240@10', publish_rate=10.0)
        viewer = start_viewer(within=host.within, address='10.77.0.1')
        with new_browser(host.within, SCRIPT) as browser:
            page = browser.new_page(viewer.url)
            sentence = page.wait_for(NOTICE)
            assert 'pictures come as JPEG' in sentence
            assert f'ssh -L {viewer.port}:localhost:{viewer.port} ' in sentence
            assert 'certificate:=auto' in sentence
            assert page.wait_for('factOf("/video_frames", "shown")')
            assert page.evaluate('isSecureContext') is False
