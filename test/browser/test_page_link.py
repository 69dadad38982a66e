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
"""A page at the end of a link of 8 Mbit/s, which cannot carry the frames of the camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import statistics

from chromium import Browser, new_browser, Page
from conftest import NodeProcess
import cv2
from hosts import Host, linked_hosts
import numpy as np
from pages import numbered_frame, SCRIPT, Viewer
import pytest

pytest_plugins = ['pages']

RATE = 30.0
FILES = 30
DRAWN = 60
GROUP = 10  # frames of which the median age is taken


@pytest.fixture
def link() -> Iterator[tuple[Host, Host]]:
    """Create the hosts of the viewer and the browser."""
    with linked_hosts('8mbit', '64kb', '200ms') as hosts:
        yield hosts


@pytest.fixture
def camera_folder(tmp_path: Path) -> Path:
    """Write numbered frames with noise, about 180 kB each."""
    folder = tmp_path / 'frames'
    folder.mkdir()
    noise = np.random.default_rng(1).integers(0, 120, (480, 640, 3), np.uint8)
    for number in range(FILES):
        frame = numbered_frame(number, 640, 480) // 255 * np.uint8(120) + noise
        assert cv2.imwrite(str(folder / f'{number:02d}.jpg'), frame)
    return folder


@pytest.fixture
def slow_viewer(
        link: tuple[Host, Host], camera_folder: Path, start: Callable[..., NodeProcess],
        start_viewer: Callable[..., Viewer]) -> Viewer:
    """Start a camera and a viewer on the one host."""
    near = link[0]
    start('img_publisher', within=near.within, source=camera_folder, publish_rate=RATE,
          on_end='loop')
    return start_viewer(within=near.within, address=near.address)


@pytest.fixture
def far_browser(link: tuple[Host, Host], slow_viewer: Viewer) -> Iterator[Browser]:
    """Start a browser on the other host."""
    with new_browser(link[1].within, SCRIPT) as started:
        yield started


def check_newest_frames(page: Page) -> None:
    """Check that old frames are skipped, in order, and that none of them waits in a queue."""
    drawn = page.evaluate('drawn')
    stamps = [frame['stamp'] for frame in drawn]
    assert stamps == sorted(set(stamps))
    assert {frame['number'] for frame in drawn} <= set(range(FILES))
    assert (stamps[-1] - stamps[0]) * RATE > 1.5 * len(drawn), 'no frame was skipped'
    ages = [frame['age'] for frame in drawn]
    first, last = (statistics.median(part) for part in (ages[GROUP:2 * GROUP], ages[-GROUP:]))
    assert last < 2 * first + 1, (first, last)


def test_old_frames_are_skipped(slow_viewer: Viewer, far_browser: Browser) -> None:
    page = far_browser.new_page(f'{slow_viewer.url}&width=640&quality=90')
    page.wait_for(f'drawn.length >= {DRAWN}')
    check_newest_frames(page)


def test_pictures_become_smaller(slow_viewer: Viewer, far_browser: Browser) -> None:
    page = far_browser.new_page(slow_viewer.url)
    page.wait_for('/quality [1-7][0-9],/.test(factOf("/video_frames", "shown"))'
                  ' || tileOf("/video_frames")?.querySelector("canvas").width < 640')
    page.wait_for('parseFloat(factOf("/video_frames", "link")) < 10')  # also while it settles


def test_quick_page_beside_a_slow_page(
        link: tuple[Host, Host], slow_viewer: Viewer, far_browser: Browser) -> None:
    with new_browser(link[0].within, SCRIPT) as near_browser:
        address = f'{slow_viewer.url}&width=640&quality=90'
        slow, quick = far_browser.new_page(address), near_browser.new_page(address)
        for page in (slow, quick):
            page.wait_for('drawn.length > 0')
        link[1].disconnect()  # the page answers no more
        quick.wait_for(f'drawn.length >= {quick.evaluate("drawn.length") + 2 * GROUP}')
        link[1].connect()
        slow.wait_for(f'drawn.length >= {slow.evaluate("drawn.length") + GROUP}')


def test_slow_page_gets_a_smaller_video(
        link: tuple[Host, Host], camera_folder: Path, start: Callable[..., NodeProcess],
        start_viewer: Callable[..., Viewer]) -> None:
    near, far = link
    start('img_publisher', within=near.within, source=camera_folder, publish_rate=RATE,
          on_end='loop', video_quality=10, video_key_interval=0.5)
    viewer = start_viewer(within=near.within, address=near.address, certificate='auto')
    options = ['--ignore-certificate-errors']
    with (new_browser(near.within, SCRIPT, options) as near_browser,
          new_browser(far.within, SCRIPT, options) as far_browser):
        quick, slow = near_browser.new_page(viewer.url), far_browser.new_page(viewer.url)
        for page in (quick, slow):
            page.wait_for('factOf("/video_frames", "shown")?.includes("h264")')
        slow.wait_for('factOf("/video_frames", "shown")?.includes("h264 for a slow link")')
        slow.wait_for(f'drawn.length >= {slow.evaluate("drawn.length") + DRAWN}')
        quick.wait_for('!factOf("/video_frames", "shown").includes("slow")')
