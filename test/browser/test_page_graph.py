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
"""The page with the nodes and topics of the graph, and the same as text."""

from __future__ import annotations

from collections.abc import Callable

from chromium import Browser
from conftest import NodeProcess
from pages import Camera, Viewer
import rclpy
from rclpy.node import Node
from std_msgs.msg import String
from test_page_layout import check_layout, LATCHED

pytest_plugins = ['pages']

ITEMS = ('(column) => [...document.querySelectorAll(`#${column} .item`)].map('
         '(one) => one.title)')


def test_nodes_and_topics(viewer: Viewer, browser: Browser, camera: Node) -> None:
    Camera(camera, '/front/image_raw', LATCHED).publish(3)
    talk = [camera.create_publisher(String, f'/talk_{number}', 1) for number in range(60)]
    heard = camera.create_subscription(String, '/talk_7', lambda _: None, 1)
    page = browser.new_page(viewer.url)
    page.wait_for('Boolean(tileOf("/front/image_raw"))')
    page.evaluate('document.getElementById("graph-link").click()')
    page.wait_for(f'document.getElementById("topics") && ({ITEMS})("topics").length >= 62')
    assert '/front/camera' in page.evaluate(f'({ITEMS})("publishers")')
    page.evaluate('document.getElementById("search").value = "TALK_7"; document.getElementById('
                  '"search").dispatchEvent(new Event("input")); true')
    assert page.evaluate(f'["publishers", "topics", "subscribers"].map({ITEMS})') == [
        ['/front/camera'], ['/talk_7'], ['/front/camera']]
    assert page.evaluate('document.querySelector("#topics small").textContent'
                         ) == 'std_msgs/msg/String'
    assert page.evaluate('document.querySelector("#lines path").getAttribute("d").match(/M/g)'
                         '.length') == 2  # from the publisher, and to the subscriber
    for width, height in ((1280, 800), (390, 844)):
        page.resize(width, height)
        page.wait_for(f'innerWidth === {width}')
        check_layout(page, width)
    page.evaluate('document.getElementById("search").value = "image_raw"; document.getElementById('
                  '"search").dispatchEvent(new Event("input")); true')
    page.evaluate('document.querySelector("#topics a").click()')
    page.wait_for('numberOf("/front/image_raw") === 3')
    assert len(talk) == 60 and heard.topic_name == '/talk_7'
    assert page.complaints() == []


def test_list_of_nodes_and_topics(start: Callable[..., NodeProcess], camera: Node) -> None:
    publisher = Camera(camera, '/front/image_raw').publisher
    hidden = rclpy.create_node('_hidden', context=camera.context)
    hidden.create_publisher(String, '/hidden', 1)
    listed = start('img_viewer', '--list')
    assert listed.finish() == 0
    lines = listed.output.splitlines()
    assert '  /front/camera' in lines
    place = lines.index(f'  {publisher.topic_name} [sensor_msgs/msg/Image]')
    assert lines[place + 1:place + 3] == ['    publishers: /front/camera', '    subscribers: none']
    assert lines[1:lines.index('Topics:')] == ['  /front/camera']  # not its own
    assert '  /hidden [std_msgs/msg/String]' in lines
    hidden.destroy_node()
