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

"""The page of robot_view: what it draws, compared with the kinematics of the package."""

from __future__ import annotations

from collections.abc import Iterator
import json
import math
from pathlib import Path
from random import Random
import re
import signal
import struct
import subprocess
import sys
from typing import Any
from xml.sax.saxutils import escape
import zlib

from chromium import Browser, new_browser, Page
import cv2
import numpy as np
from opencv_tools.robot.compare.properties import random_position
from opencv_tools.robot.kinematics import Kinematics, with_mimics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import FrameId, Robot
from opencv_tools.robot.pose import normalised, Transform
from opencv_tools.robot.renaming import with_original_names
from opencv_tools.robot.view.content import read_content, to_json, ViewOptions
from opencv_tools.robot.view.single_file import html_page
from opencv_tools.robot.xml.report import Report
import pytest
from test_page_layout import check_contrast
from waiting import communicate

ROOT = Path(__file__).parents[2]
ROBOTS = sorted(path for path in (ROOT / 'test' / 'data' / 'robots').glob('*/[otw]*_*df*')
                if path.is_file())
SHIPPED = [ROOT / 'urdf' / 'my_arm.urdf', ROOT / 'urdf' / 'my_robot.urdf',
           ROOT / 'urdf' / 'my_robot.urdf.xacro', ROOT / 'sdf' / 'my_arm' / 'model.sdf',
           ROOT / 'sdf' / 'my_robot' / 'model.sdf']
SAMPLES = 20
TOLERANCE = 1e-6
# Without a graphics processor, Chromium draws with SwiftShader if it is asked to.
OPTIONS = ('--enable-unsafe-swiftshader',)

# Moves the joints as the sliders do, and returns what the page draws then: matrices in columns,
# and the directions of the arrows of the axes.
_DRAWN = """
((samples) => samples.map((sample) => {
  const [view] = robotView.page.views;
  view.motion.reset();
  sample.forEach((position, joint) => position.forEach(
    (value, index) => robotView.move(joint, index, value)));
  const matrices = (objects) => objects.map(({ matrixWorld }) => [...matrixWorld.elements]);
  const direction = (arrow) => arrow.matrixWorld.elements.slice(4, 7);
  const place = (arrow) => arrow.matrixWorld.elements.slice(12, 15);
  return {
    links: matrices(view.links.map((link) => link.group)),
    shapes: view.links.map((link) => matrices(
      link.shapes.filter((shape) => shape.userData.part !== 'inertia'))),
    inertials: view.links.map((link) => matrices(
      link.shapes.filter((shape) => shape.userData.part === 'inertia'))),
    joints: matrices(view.frames.joint), frames: matrices(view.frames.frame),
    axes: view.axes.map((arrows) => arrows.map(direction)),
    places: view.axes.map((arrows) => arrows.map(place)),
  };
}))
"""


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    """Start a browser that draws without a graphics processor."""
    with new_browser(options=OPTIONS) as started:
        yield started


@pytest.fixture(scope='module')
def page(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Page:
    """Return a page with the first robot, from a file."""
    return open_robot(browser, tmp_path_factory.mktemp('robot'), SHIPPED[0])


def open_robot(browser: Browser, folder: Path, *robots: Path, **size: int) -> Page:
    """Write a page for one or two robots, and open the file."""
    path = folder / 'robot.html'
    path.write_bytes(b''.join(html_page(read_content(
        ViewOptions(paths=[*map(str, robots)]), Report()))))
    page = browser.new_page(path.as_uri(), **size)
    page.wait_for('window.robotView?.stage?.draws > 0')
    return page


def show(page: Page, *robots: Path) -> Any:
    """Show one or two robots in a page, and return their document."""
    content = read_content(ViewOptions(paths=[*map(str, robots)]), Report())
    text = b''.join(html_page(content)).decode()
    document = text.partition('type="application/json">')[2].partition('</script>')[0]
    page.evaluate(f'robotView.show({document})')
    return content.document


def rows(elements: list[float]) -> list[float]:
    """Return the rotation in row order and the translation of a matrix in column order."""
    rotation = [elements[column * 4 + row] for row in range(3) for column in range(3)]
    return rotation + elements[12:15]


def numbers(transform: Transform) -> list[float]:
    return [*transform.rotation, *transform.translation]


def expected(robot: Robot, sample: list[list[float]]) -> dict[str, Any]:
    """Return what the page has to draw at some joint positions, in the form of ``_DRAWN``."""
    kinematics = Kinematics(robot)
    positions = {joint.name: position for joint, position in zip(robot.joints, sample)}
    poses = kinematics.forward(with_mimics(robot, positions))

    def placed(link: Any, placement: Any) -> list[float]:
        frame = FrameId('link', link.name)
        return numbers(poses[frame] @ kinematics.within(frame, placement).transform())

    def axes(joint: Any) -> list[list[float]]:
        frame = poses[FrameId('joint', joint.name)]
        parent = FrameId('link', joint.parent)
        before = frame if joint.is_loop else poses[parent] @ kinematics.between(
            parent, FrameId('joint', joint.name)).transform()
        return [list((frame if index else before).rotate(normalised(axis.xyz)))
                for index, axis in enumerate(joint.axes[:joint.kind.axes])]

    return {
        'links': [numbers(poses[FrameId('link', link.name)]) for link in robot.links],
        'shapes': [[placed(link, shape.placement) for shape in (*link.visuals, *link.collisions)]
                   for link in robot.links],
        'joints': [numbers(poses[FrameId('joint', joint.name)]) for joint in robot.joints],
        'frames': [numbers(poses[FrameId('frame', frame.name)]) for frame in robot.frames],
        'axes': [axes(joint) for joint in robot.joints],
        'places': [[[*poses[FrameId('joint', joint.name)].translation]] * len(axes(joint))
                   for joint in robot.joints],
    }


_SHOWN = """['visuals', 'collisions', 'inertia', 'frames', 'names', 'axes'].filter(
  (name) => document.getElementById(`show-${name}`).checked)"""
_MARKS = """(robotView.stage.draw(),
  robotView.page.views[0].marks.filter((one) => one.visible).length)"""
# Names that are shown, with their rectangles in pixels.
_NAMES = """(robotView.stage.draw(), [...document.querySelectorAll('#names span')].filter(
  (one) => one.style.visibility === 'visible').map((one) => {
    const { left, top, right, bottom } = one.getBoundingClientRect();
    return [one.textContent, left, top, right, bottom];
  }))"""
# Rectangles of the visuals in a view, as parts of it: left, right, top and bottom.
_EXTENTS = """robotView.page.views.flatMap((view) => {
  robotView.stage.draw();
  const seen = view.corners(new Set(['visuals'])).map(
    (one) => one.project(robotView.stage.camera));
  return ['x', 'y'].flatMap((axis) => [Math.min, Math.max].map(
    (find) => find(...seen.map((one) => one[axis]))));
})"""


def test_robot_alone_and_large_at_the_start(browser: Browser, tmp_path: Path) -> None:
    for width, height in ((1280, 800), (390, 844), (2000, 500)):
        page = open_robot(browser, tmp_path, SHIPPED[0], width=width, height=height)
        assert page.evaluate(_SHOWN) == ['visuals']
        assert page.evaluate(_MARKS) == 0
        assert page.evaluate(_NAMES) == []
        # Side by side, each robot fills its half; the frames are what differs.
        for key, parts in (('', ['visuals']), ('3', ['visuals', 'frames'])):
            if key:
                page.press(key)
            assert page.evaluate(_SHOWN) == parts
            left, right, bottom, top = page.evaluate(_EXTENTS)
            assert 1.8 < max(right - left, top - bottom) < 2
            assert (left, bottom) == (pytest.approx(-right), pytest.approx(-top, abs=0.05))
        page.close()


@pytest.mark.parametrize(('shape', 'parts'), [
    ('', ['visuals', 'frames']), ('collision', ['visuals', 'collisions']),
    ('visual', ['visuals'])])
def test_first_picture_is_not_empty(shape: str, parts: list[str], browser: Browser, tmp_path: Path
                                    ) -> None:
    box = f'<{shape}><geometry><box size="1 1 1"/></geometry></{shape}>' if shape else ''
    (tmp_path / 'robot.urdf').write_text(f'<robot name="r"><link name="l">{box}</link></robot>')
    page = open_robot(browser, tmp_path, tmp_path / 'robot.urdf')
    assert page.evaluate(_SHOWN) == parts
    page.close()


def point_at(page: Page, x: float, y: float) -> None:
    """Move the pointer to a part of the picture."""
    page.evaluate(f"""(() => {{
      const {{ left, top, width, height }} = (
        robotView.stage.renderer.domElement.getBoundingClientRect());
      robotView.stage.renderer.domElement.dispatchEvent(new PointerEvent('pointermove', {{
        clientX: left + width * {x}, clientY: top + height * {y} }}));
    }})()""")


def test_name_of_the_link_below_the_pointer_and_of_the_chosen_one(
        browser: Browser, tmp_path: Path) -> None:
    (tmp_path / 'robot.urdf').write_text(
        f'<robot name="r">{body("first", "1 1 1")}{body("second", "1 1 1")}<joint name="j" '
        'type="fixed"><parent link="first"/><child link="second"/><origin xyz="0 0 3"/></joint>'
        '</robot>')
    page = open_robot(browser, tmp_path, tmp_path / 'robot.urdf')
    names = f'{_NAMES}.map(([name]) => name)'
    for y, found in ((0.9, ['first']), (0.1, ['second'])):
        point_at(page, 0.5, y)
        page.wait_for(f'String({names}) === "{found[0]}"')
    point_at(page, 0.01, 0.5)
    page.wait_for(f'{names}.length === 0')
    page.evaluate('robotView.choose(0)')
    assert page.evaluate(names) == ['first']
    point_at(page, 0.5, 0.1)
    page.wait_for(f'String({names}) === "second,first"')
    page.press('n')
    assert page.evaluate(names) == ['second', 'first']
    page.close()


@pytest.mark.parametrize('links', [2, 30, 500, 37])
def test_names_are_never_over_each_other(links: int, browser: Browser, tmp_path: Path) -> None:
    """A chain whose links are closer than the names, in each convention and side by side."""
    page = open_robot(browser, tmp_path, chain(tmp_path, links))
    page.wait_for('!!robotView.page')
    page.press('n')
    for key in '123':
        page.press(key)
        for position in (0, 0.3):
            page.evaluate(f'robotView.move(0, 0, {position})')
            names = page.evaluate(_NAMES)
            assert len(names) >= min(links - 1, 10)
            for number, (_, left, top, right, bottom) in enumerate(names):
                for _, x, y, other_right, other_bottom in names[:number]:
                    assert (left >= other_right or x >= right or top >= other_bottom
                            or y >= bottom)
    page.close()


@pytest.mark.parametrize('path', [*SHIPPED, *ROBOTS], ids=lambda path: path.name)
def test_drawn_poses_are_those_of_the_kinematics(path: Path, page: Page) -> None:
    robot = with_original_names(read_robot(str(path), Report())[0])
    show(page, path)
    generator = Random(0)
    samples = [[random_position(joint, generator) for joint in robot.joints]
               for _ in range(SAMPLES)]
    drawn = page.evaluate(f'{_DRAWN}({to_json(samples)})')  # type: ignore[arg-type]
    for sample, found in zip(samples, drawn):
        for link, inertials in zip(robot.links, found['inertials']):
            assert len(inertials) <= (link.inertial is not None)
        wanted = expected(robot, sample)
        for kind in ('links', 'joints', 'frames'):
            assert [*map(rows, found[kind])] == [
                pytest.approx(one, rel=TOLERANCE, abs=TOLERANCE) for one in wanted[kind]]
        for found_link, wanted_link in zip(found['shapes'], wanted['shapes'], strict=True):
            assert [*map(rows, found_link)] == [
                pytest.approx(one, rel=TOLERANCE, abs=TOLERANCE) for one in wanted_link]
        for kind in ('axes', 'places'):
            assert found[kind] == [
                [pytest.approx(one, rel=TOLERANCE, abs=TOLERANCE) for one in arrows]
                for arrows in wanted[kind]]
    assert page.complaints() == []


@pytest.mark.parametrize('roll', [1.57, -1.57, 1.5708, -1.5707, 0.0])
def test_axis_near_a_direction_of_the_model(roll: float, page: Page, tmp_path: Path) -> None:
    (tmp_path / 'robot.urdf').write_text(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
        f'<parent link="a"/><child link="b"/><origin rpy="{roll} 0 0"/><axis xyz="0 0 1"/></joint>'
        '</robot>')
    test_drawn_poses_are_those_of_the_kinematics(tmp_path / 'robot.urdf', page)


def chain(folder: Path, links: int, shape: str = '') -> Path:
    """Write a robot of links above each other, some with a shape, and return its file."""
    joints = ''.join(
        f'<link name="{number}">{"" if number % 50 else shape}</link>'
        f'<joint name="j{number}" type="revolute">'
        f'<parent link="{number - 1}"/><child link="{number}"/><origin xyz="0 0 0.1"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for number in range(1, links))
    path = folder / 'chain.urdf'
    path.write_text(f'<robot name="r"><link name="0"/>{joints}</robot>')
    return path


def test_nothing_is_drawn_while_nothing_moves(browser: Browser, tmp_path: Path) -> None:
    page = open_robot(browser, tmp_path, chain(tmp_path, 100))
    page.wait_for('robotView.page?.views[0].links.length === 100')  # built in slices
    page.evaluate('robotView.stage.request()')
    page.wait_for('!robotView.stage.wanted')
    # Two pictures of the screen pass, and nothing asks for another one.
    page.wait_for_paint()
    before = page.evaluate('robotView.stage.draws')
    for _ in range(20):
        page.wait_for_paint()
    assert page.evaluate('robotView.stage.draws') == before
    # Each picture of the screen that a joint moves in is drawn once, or not if drawing is slow.
    page.evaluate("""(async () => {
      for (let number = 0; number < 20; number += 1) {
        robotView.move(0, 0, number / 100);
        robotView.move(1, 0, number / 100);
        await new Promise((done) => requestAnimationFrame(done));
      }
    })()""")
    assert before < page.evaluate('robotView.stage.draws') <= before + 20


def test_slider_and_mimic_joint(page: Page) -> None:
    show(page, ROOT / 'test/data/robots/sdf/ok_mimic.sdf')
    joints = page.evaluate('robotView.page.document.robots[0].joints')
    number, mimic = next((number, joint['mimic'][0]) for number, joint in enumerate(joints)
                         if joint['mimic'])
    _, leader, multiplier, offset = mimic
    sliders = [joint['name'] for joint in joints for _ in joint['spans']]
    page.evaluate(f"""(() => {{
      const slider = document.querySelectorAll('.joint input')[
        {sliders.index(joints[leader]['name'])}];
      slider.value = 0.1;
      slider.dispatchEvent(new Event('input'));
    }})()""")
    moved = page.evaluate('robotView.page.views[0].motion.positions')
    assert moved[number][0] == pytest.approx(multiplier * moved[leader][0] + offset)
    assert page.evaluate('[...document.querySelectorAll(".joint input")].map((one) => '
                         'one.disabled)')[sliders.index(joints[number]['name'])]
    page.press('0')
    assert not any(map(any, page.evaluate('robotView.page.views[0].motion.positions')))


def test_offsets_of_mimics_at_zero(page: Page) -> None:
    path = ROOT / 'test/data/robots/urdf/ok_mimic_of_a_mimic.urdf'
    show(page, path)
    robot, _ = read_robot(str(path), Report())
    at_zero = with_mimics(robot, {joint.name: [0.0] for joint in robot.joints})
    positions = [pytest.approx(at_zero[joint.name]) for joint in robot.joints]
    shown = 'robotView.page.views[0].motion.positions'
    assert page.evaluate(shown) == positions and any(map(any, at_zero.values()))
    page.evaluate(f'robotView.move({[joint.name for joint in robot.joints].index("first")}, 0, 1)')
    assert page.evaluate(shown) != positions
    page.press('0')
    assert page.evaluate(shown) == positions


def test_numbers_and_lines_of_both_files(page: Page) -> None:
    show(page, SHIPPED[0])
    page.evaluate("[...document.querySelectorAll('#tree button')].find((one) => "
                  "one.firstChild.data === 'forearm').click()")
    cell = "document.querySelector('[data-name={}]').firstChild.data".format
    assert page.evaluate(cell('urdf-joint')) == '0  0  0.4  0  0  0\nin link upper_arm'
    assert page.evaluate(cell('sdf-link')) == '0  0  0.5  0  0  0\nin model'
    for name, start in (('urdf-joint', '<joint name="elbow"'),
                        ('sdf-link', '<link name="forearm"')):
        page.evaluate(f"document.querySelector('[data-name={name}] .line').click()")
        marked = page.evaluate("document.querySelector('mark').textContent")
        assert marked.strip().startswith(start)
    page.evaluate('robotView.move(1, 0, Math.PI / 2)')
    assert page.evaluate(cell('now')) == '0  0  0.5  0  1.5708  0'


def test_both_conventions_with_their_arrows(browser: Browser, tmp_path: Path) -> None:
    page = open_robot(browser, tmp_path, SHIPPED[0])
    page.press('3')
    assert page.evaluate('robotView.stage.views') == ['urdf', 'sdf']
    page.evaluate('robotView.move(1, 0, 0.5), robotView.stage.draw()')
    tips = """(() => {
      const [view] = robotView.page.views;
      return ['urdf', 'sdf'].map((kind) => view.arrows[kind].map((arrow) => {
        const length = arrow.cone.position.y;
        return [arrow.position.toArray(), new THREE.Vector3(0, length, 0).applyMatrix4(
          arrow.matrixWorld).toArray()];
      }));
    })()"""
    urdf, sdf = page.evaluate(tips)
    places = page.evaluate('robotView.page.views[0].motion.links.map((one) => '
                           'new THREE.Vector3().setFromMatrixPosition(one).toArray())')
    # Each joint is in its parent link; each link is in the model. The slide moves nothing here.
    for (start, tip), parent, child in zip(urdf, places, places[1:]):
        assert (start, tip) == (pytest.approx(parent), pytest.approx(child, abs=TOLERANCE))
    for (start, tip), link in zip(sdf[1:], places[1:]):
        assert (start, tip) == ([0, 0, 0], pytest.approx(link, abs=TOLERANCE))
    assert page.complaints() == []


def test_differences_are_red(browser: Browser, tmp_path: Path) -> None:
    other = tmp_path / 'other.urdf'
    other.write_text(SHIPPED[0].read_text().replace('lower="-1.57', 'lower="-1.2').replace(
        '<sphere radius="', '<sphere radius="1'))
    page = open_robot(browser, tmp_path, SHIPPED[0], other)
    assert page.evaluate("document.getElementById('count').textContent").endswith('differences')
    assert page.evaluate("""robotView.page.views.map((view) => view.links.map(({ shapes }) => (
        shapes.map(({ userData }) => userData.material?.color.getHex() === 0xe03131))))""") == [
            [[False, False, False], [False, False, False], [False, False, False],
             [True, True, False]]] * 2
    assert 'lower' in page.evaluate("document.getElementById('differences').innerText")
    page.evaluate("""(() => {
      const fade = document.getElementById('fade');
      fade.value = 1;
      fade.dispatchEvent(new Event('input'));
    })()""")
    assert page.evaluate('robotView.page.views.map(({ group }) => group.visible)') == [False, True]
    page.evaluate('robotView.move(1, 0, 0.5)')
    assert page.evaluate('robotView.page.views.map(({ motion }) => motion.positions[1][0])') == [
        0.5, 0.5]


_TINTED = """robotView.page.views.map(({ materials }) => [...new Set(materials.filter(
  ({ material }) => material.emissive?.getHex() === 0x977103).map(({ link }) => link))])"""
# Press and release in the middle of the picture.
_CLICK = """(() => {
  const canvas = robotView.stage.renderer.domElement;
  const { left, top, width, height } = canvas.getBoundingClientRect();
  for (const kind of ['pointerdown', 'pointerup']) {
    canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1, bubbles: true,
      clientX: left + width / 2, clientY: top + height / 2 }));
  }
})()"""


def body(name: str, size: str) -> str:
    return f'<link name="{name}"><visual><geometry><box size="{size}"/></geometry></visual></link>'


def test_click_on_a_link_of_the_second_robot(browser: Browser, tmp_path: Path) -> None:
    paths = tmp_path / 'a.urdf', tmp_path / 'b.urdf'
    for path, links in zip(paths, (body('a', '1 1 1'), body('b', '1 1 1'))):
        path.write_text(f'<robot name="r">{links}</robot>')
    page = open_robot(browser, tmp_path, *paths)
    chosen = "document.querySelector('#numbers td').textContent"
    assert (page.evaluate(_TINTED), page.evaluate(chosen)) == ([[], []], 'a')
    for amount, tinted, name in ((0, [[0], []], 'a'), (1, [[], [0]], 'b')):
        page.evaluate(f"""(() => {{
          const fade = document.getElementById('fade');
          fade.value = {amount};
          fade.dispatchEvent(new Event('input'));
          robotView.stage.draw();
        }})(), {_CLICK}""")
        assert (page.evaluate(_TINTED), page.evaluate(chosen)) == (tinted, name)
    # The choice stays after a reload, until the link is gone.
    show(page, *paths)
    assert page.evaluate(_TINTED) == [[], [0]]
    show(page, paths[0])
    assert page.evaluate(_TINTED) == [[]]


def test_second_robot_with_other_numbers(page: Page, tmp_path: Path) -> None:
    joint = ('<link name="{0}"/><joint name="j{0}" type="continuous"><parent link="l"/>'
             '<child link="{0}"/></joint>')
    for file, names in (('a.urdf', 'pq'), ('b.urdf', 'qp')):
        (tmp_path / file).write_text('<robot name="r"><link name="l"/>' + ''.join(
            map(joint.format, names)) + '</robot>')
    show(page, tmp_path / 'a.urdf', tmp_path / 'b.urdf')
    page.evaluate('robotView.move(0, 0, 0.5)')
    assert page.evaluate('robotView.page.views.map(({ motion }) => motion.positions)') == [
        [[0.5], [0]], [[0], [0.5]]]


def test_camera_after_a_reload(browser: Browser, tmp_path: Path) -> None:
    small, large = tmp_path / 'small.urdf', tmp_path / 'large.urdf'
    small.write_text(f'<robot name="r">{body("l", "1 1 1")}</robot>')
    large.write_text(f'<robot name="r">{body("l", "9 9 9")}</robot>')
    page = open_robot(browser, tmp_path, small)
    camera = 'robotView.stage.camera.position.toArray()'
    near = page.evaluate(camera)
    show(page, large)
    assert page.evaluate(camera) == pytest.approx([9 * number for number in near])
    # The keys of the picture move the camera, which stays there.
    page.evaluate("robotView.stage.renderer.domElement.dispatchEvent(new KeyboardEvent('keydown', "
                  "{ code: 'ArrowUp' }))")
    moved = page.evaluate(camera)
    assert moved != pytest.approx([9 * number for number in near])
    show(page, small)
    assert page.evaluate(camera) == moved
    page.press('f')
    assert page.evaluate(camera) == pytest.approx(near)


def test_picture_of_all_axes(page: Page) -> None:
    show(page, SHIPPED[0])
    page.press('a')
    page.evaluate("document.getElementById('fit').click(), robotView.stage.draw()")
    tips = page.evaluate("""robotView.page.views[0].axes.flat().map((arrow) => (
      new THREE.Vector3(0, arrow.cone.position.y, 0).applyMatrix4(arrow.matrixWorld)
        .project(robotView.stage.camera).toArray()))""")
    page.press('a')
    assert len(tips) == 3
    assert all(abs(number) < 1 for tip in tips for number in tip)


def test_keys_after_a_slider(page: Page) -> None:
    show(page, SHIPPED[0])
    views = 'robotView.stage.views'
    page.evaluate("document.querySelector('.joint input').focus()")
    for key, shown in (('3', ['urdf', 'sdf']), ('1', ['urdf'])):
        page.press(key)
        assert page.evaluate(views) == shown
    axes = "document.getElementById('show-axes').checked"
    for key, is_shown in (('a', True), ('A', False)):
        page.press(key)
        assert page.evaluate(axes) is is_shown


def test_position_within_a_smaller_limit(page: Page, tmp_path: Path) -> None:
    for upper, position in ((2, 1.5), (0.5, 0.5), (2, 0.5)):
        (tmp_path / 'robot.urdf').write_text(
            '<robot name="r"><link name="a"/><link name="b"/><joint name="new" type="prismatic">'
            '<parent link="a"/><child link="b"/>'
            f'<limit lower="0" upper="{upper}" effort="1" velocity="1"/></joint></robot>')
        show(page, tmp_path / 'robot.urdf')
        if position == 1.5:
            page.evaluate('robotView.move(0, 0, 1.5)')
        assert page.evaluate('robotView.page.views[0].motion.positions[0]') == [position]
        assert page.evaluate("document.querySelector('.joint output').textContent") == (
            f'{position} m')


def test_arrow_from_the_frame_of_a_pose(page: Page, tmp_path: Path) -> None:
    (tmp_path / 'robot.sdf').write_text(
        '<sdf version="1.10"><model name="m"><link name="a"><pose>5 0 0 0 0 0</pose></link>'
        '<frame name="f" attached_to="a"><pose>0 2 0 0 0 1</pose></frame>'
        '<link name="b"><pose relative_to="a">1 0 0 0 0 0</pose></link>'
        '<link name="c"><pose relative_to="f">0 0 3 0 0 0</pose></link>'
        '<joint name="j" type="revolute"><parent>a</parent><child>b</child>'
        '<axis><xyz>0 0 1</xyz></axis></joint>'
        '<joint name="k" type="revolute"><pose relative_to="a"/><parent>b</parent>'
        '<child>c</child><axis><xyz>0 0 1</xyz></axis></joint></model></sdf>')
    show(page, tmp_path / 'robot.sdf')
    starts = page.evaluate('robotView.page.views[0].arrows.sdf.map(({ position }) => '
                           'position.toArray())')
    assert starts == [[0, 0, 0], [5, 0, 0], [5, 2, 0]]


STL = b'solid a\n' + b''.join(
    b'facet normal 0 0 1\nouter loop\nvertex %d %d 0\nvertex 2 0 0\nvertex 0 3 1\nendloop\n'
    b'endfacet\n' % corner for corner in ((0, 0), (1, 1))) + b'endsolid a\n'
OBJ = b'v 0 0 0\nv 2 0 0\nv 0 3 1\nf 1 2 3\n'
DAE = b"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.5"/><up_axis>%s</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="9">0 0 0 4 0 0 0 6 2</float_array><technique_common>
<accessor source="#a" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def glb(uri: str = '') -> bytes:
    """Return a binary glTF with a triangle; ``uri`` names another file with its points."""
    points = struct.pack('<9f', 0, 0, 0, 2, 0, 0, 0, 3, 1)
    text = json.dumps({
        'asset': {'version': '2.0'}, 'scene': 0, 'scenes': [{'nodes': [0]}],
        'nodes': [{'mesh': 0}], 'meshes': [{'primitives': [{'attributes': {'POSITION': 0}}]}],
        'buffers': [{'byteLength': 36, **({'uri': uri} if uri else {})}],
        'bufferViews': [{'buffer': 0, 'byteLength': 36}],
        'accessors': [{'bufferView': 0, 'componentType': 5126, 'count': 3, 'type': 'VEC3',
                       'min': [0, 0, 0], 'max': [2, 3, 1]}]}).encode()
    text += b' ' * (-len(text) % 4)
    return (struct.pack('<4sII', b'glTF', 2, 28 + len(text) + len(points))
            + struct.pack('<I4s', len(text), b'JSON') + text
            + struct.pack('<I4s', len(points), b'BIN\0') + points)


def nested(levels: int, last: int = -1) -> bytes:
    """Return Collada with nodes that have ten nodes of the level below; ``last`` has a cycle."""
    nodes = ''.join(f'<node id="n{level}">' + f'<instance_node url="#n{level - 1}"/>' * 10
                    + '</node>' for level in range(1, levels + 1))
    end = '<instance_geometry url="#g"/>' if last else f'<instance_node url="#n{levels}"/>'
    nodes = f'<library_nodes><node id="n0">{end}</node>{nodes}</library_nodes>'
    return (DAE % b'Z_UP').replace(
        b'<library_visual_scenes>', nodes.encode() + b'<library_visual_scenes>').replace(
        b'<node id="n"><instance_geometry url="#g"/>',
        f'<node id="n"><instance_node url="#n{levels}"/>'.encode())


MESH = ('<robot name="r"><link name="l"><visual><geometry><mesh filename="{}" scale="1 1 2"/>'
        '</geometry></visual></link></robot>')
_BOX = """(() => {
  const box = new THREE.Box3().setFromObject(robotView.page.views[0].links[0].shapes[0]);
  return box.isEmpty() ? null : [...box.min.toArray(), ...box.max.toArray()];
})()"""


@pytest.mark.parametrize(('name', 'data'), [
    ('a.stl', STL), ('a.obj', OBJ), ('z.dae', DAE % b'Z_UP'), ('y.dae', DAE % b'Y_UP'),
    ('a.glb', glb())])
def test_mesh_of_each_format(name: str, data: bytes, page: Page, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    (tmp_path / 'robot.urdf').write_text(MESH.format(name))
    show(page, tmp_path / 'robot.urdf')
    page.wait_for(f'{_BOX} !== null')
    assert page.evaluate(_BOX) == pytest.approx([0, 0, 0, 2, 3, 2], abs=TOLERANCE)
    assert page.complaints() == []


def polygon(corners: int, *, ordered: bool) -> bytes:
    """Return a mesh of one face, whose corners are on a circle or anywhere."""
    generator = Random(0)
    angles = [math.tau * number / corners for number in range(corners)]
    points = [(math.cos(angle), math.sin(angle), 0.0) if ordered else
              (generator.random(), generator.random(), generator.random()) for angle in angles]
    return ''.join(f'v {x:.6f} {y:.6f} {z:.6f}\n' for x, y, z in points).encode() + (
        f'f {" ".join(map(str, range(1, corners + 1)))}\n'.encode())


@pytest.mark.parametrize(('corners', 'ordered', 'is_shown'), [
    (4, True, True), (3_000, True, True), (300_000, True, False),
    (10, False, True), (1_000, False, True), (77_777, False, False), (300_000, False, False)])
def test_face_with_many_corners(
    corners: int, ordered: bool, is_shown: bool, page: Page, tmp_path: Path,
) -> None:
    (tmp_path / 'a.obj').write_bytes(polygon(corners, ordered=ordered))
    (tmp_path / 'robot.urdf').write_text(MESH.format('a.obj'))
    show(page, tmp_path / 'robot.urdf')
    child = 'robotView.page.views[0].links[0].shapes[0].children[0]'
    page.wait_for(f'!!{child}')
    reason = page.evaluate(f'{child}.userData.reason')
    assert reason is None if is_shown else 'too many for their size' in reason


def test_browser_that_does_not_unpack(page: Page, tmp_path: Path) -> None:
    (tmp_path / 'a.stl').write_bytes(STL)
    (tmp_path / 'robot.urdf').write_text(MESH.format('a.stl'))
    page.evaluate('window.kept = DecompressionStream, delete window.DecompressionStream')
    try:
        show(page, tmp_path / 'robot.urdf')
        page.wait_for('document.getElementById("numbers").innerText.includes('
                      '"not shown: this browser does not unpack it (no DecompressionStream); '
                      'use a newer browser")')
    finally:
        page.evaluate('void (window.DecompressionStream = window.kept)')


TEXTURED_OBJ = (b'mtllib a.mtl\nv 0 0 0\nv 2 0 0\nv 0 3 1\nvt 0 0\nvt 1 0\nvt 0 1\n'
                b'usemtl painted\nf 1/1 2/2 3/3\n')
TEXTURED_DAE = (DAE % b'Z_UP').replace(b'<library_geometries>', b"""
<library_images><image id="i"><init_from>a.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="s"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>
<technique sid="c"><phong><diffuse><texture texture="t" texcoord="UV"/></diffuse></phong>
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m" name="m"><instance_effect url="#e"/></material>
</library_materials><library_geometries>""").replace(b'<vertices', b"""
<source id="q"><float_array id="b" count="6">0 0 1 0 0 1</float_array><technique_common>
<accessor source="#b" count="3" stride="2"><param name="S" type="float"/>
<param name="T" type="float"/></accessor></technique_common></source><vertices""").replace(
    b'<triangles count="1">', b'<triangles count="1" material="p">').replace(
    b'<p>', b'<input semantic="TEXCOORD" source="#q" offset="0" set="0"/><p>').replace(
    b'<instance_geometry url="#g"/>', b"""<instance_geometry url="#g"><bind_material>
<technique_common><instance_material symbol="p" target="#m"/></technique_common></bind_material>
</instance_geometry>""")
_BLUE = """(() => {
  robotView.stage.draw();
  const gl = robotView.stage.renderer.getContext();
  const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const pixels = new Uint8Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  return pixels.filter((blue, at) => at % 4 === 2 && blue > pixels[at - 1] + 30
    && blue > pixels[at - 2] + 30).length;
})()"""


def painted(folder: Path, name: str) -> Path:
    """Write a robot of a mesh with a blue texture, and return its file."""
    (folder / name).write_bytes(TEXTURED_OBJ if name == 'a.obj' else TEXTURED_DAE)
    (folder / 'a.mtl').write_text('newmtl painted\nKd 1 1 1\nmap_Kd a.png\nmap_d lost.png\n')
    cv2.imwrite(str(folder / 'a.png'), np.full((4, 4, 3), (255, 0, 0), np.uint8))
    (folder / 'robot.urdf').write_text(MESH.format(name))
    return folder / 'robot.urdf'


@pytest.mark.parametrize('name', ['a.obj', 'a.dae'])
def test_texture_of_a_mesh(name: str, page: Page, tmp_path: Path) -> None:
    path = painted(tmp_path, name)
    show(page, path)
    page.wait_for(f'{_BOX} !== null')
    page.wait_for(f'{_BLUE} > 1000')
    page.evaluate("document.getElementById('show-visuals').click()")
    assert page.evaluate(_BLUE) == 0
    page.evaluate("document.getElementById('show-visuals').click()")
    # Without its texture, a mesh has its colour, and the panel the reason.
    (tmp_path / 'a.png').unlink()
    show(page, path)
    page.wait_for(f'{_BOX} !== null')
    assert page.evaluate(_BLUE) == 0
    assert 'a.png not shown: it is not found' in page.evaluate(
        "document.getElementById('numbers').innerText")
    assert page.complaints() == []


def test_nodes_that_are_used_again(page: Page, tmp_path: Path) -> None:
    (tmp_path / 'a.dae').write_bytes(nested(3))
    (tmp_path / 'robot.urdf').write_text(MESH.format('a.dae'))
    show(page, tmp_path / 'robot.urdf')
    page.wait_for(f'{_BOX} !== null')
    assert page.evaluate(_BOX) == pytest.approx([0, 0, 0, 2, 3, 2], abs=TOLERANCE)


def test_textures_with_a_reason(page: Page, tmp_path: Path) -> None:
    path = painted(tmp_path, 'a.obj')
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    whole = cv2.imencode('.png', noise)[1].tobytes()
    large = struct.pack('>II', 11_000, 11_000)
    header = whole[:16] + large + whole[24:29]
    header += struct.pack('>I', zlib.crc32(header[12:]))
    for data, reason in ((whole[:len(whole) // 2], 'it is damaged'), (b'no', 'it is damaged'),
                         (header + whole[33:], 'all textures have more than 100000000 pixels')):
        (tmp_path / 'a.png').write_bytes(data)
        show(page, path)
        page.wait_for(f'{_BOX} !== null')
        page.wait_for("document.getElementById('numbers').innerText.includes("
                      f"'a.png not shown: {reason}')")
    assert page.evaluate(_BLUE) == 0


@pytest.mark.parametrize(('name', 'data', 'reason'), [
    ('a.stl', None, 'it is not found'), ('a.stl', b'', ''), ('a.stl', b'\xff' * 90, 'damaged'),
    ('a.stl', b'solid ' * 200_000, 'beginnings without an end'),
    ('a.stl', b'solid a\n' + b'facet ' * 200_000 + b'endsolid a', 'beginnings without an end'),
    ('a.obj', b'\n' * 3_000_000, 'it has no triangles'), ('a.obj', b'f 1 2 3', ''),
    ('a.dae', b'<COLLADA', ''), ('a.glb', b'glTF', ''),
    ('a.glb', glb('https://example.org/points.bin'), ''), ('a.ply', b'ply', 'only stl'),
    ('a.glb', b'glTF' + struct.pack('<5I', 2, 100, 50, 0x4e4f534a, 0), 'damaged ('),
    ('a.glb', glb().replace(b'"bufferView": 0, ', b' ' * 11).replace(
        b'"count": 3', b'"count": 9999999'), 'it counts more than it contains'),
    ('a.obj', b'v 0 0 0\n' + b'o a\nf 1 1 1\n' * 20_001, 'more than 20000 parts'),
    ('a.dae', nested(9), 'more than 20000 parts'), ('a.dae', nested(1, 0), 'more than 20000'),
    ('a.dae', (DAE % b'Z_UP').replace(b'stride="3"', b'stride="99999999"'), 'it counts more'),
    ('a.dae', (DAE % b'Z_UP').replace(b'triangles', b'polylist').replace(
        b'<p>', b'<vcount>999999999</vcount><p>'), 'it counts more')])
def test_bad_mesh_is_a_box_with_the_reason(
    name: str, data: bytes | None, reason: str, page: Page, tmp_path: Path,
) -> None:
    if data is not None:
        (tmp_path / name).write_bytes(data)
    (tmp_path / 'robot.urdf').write_text(MESH.format(name))
    show(page, tmp_path / 'robot.urdf')
    found = page.wait_for(
        'robotView.page.views[0].links[0].shapes[0].children[0]?.userData.reason')
    assert found.startswith(f'{name}: ') and reason in found
    assert 'example.org' not in ''.join(page.complaints())
    page.wait_for('document.querySelectorAll("#numbers .reason").length')


def test_names_with_markup_run_no_script(browser: Browser, tmp_path: Path) -> None:
    name = '</script><img src=x onerror="window.ran = 1"><script>window.ran = 1</script>__proto__'
    text = escape(name, {'"': '&quot;'})
    (tmp_path / 'robot.urdf').write_text(
        f'<robot name="{text}"><link name="__proto__"/><link name="{text}"/>'
        f'<joint name="constructor" type="continuous"><parent link="__proto__"/>'
        f'<child link="{text}"/></joint></robot>')
    page = open_robot(browser, tmp_path, tmp_path / 'robot.urdf')
    assert page.evaluate("document.querySelectorAll('#tree button')[1].firstChild.data") == name
    page.evaluate('robotView.choose(1), robotView.stage.draw()')
    assert page.evaluate('window.ran') is None
    assert page.evaluate('document.title') == name
    assert page.evaluate('document.querySelectorAll("img").length') == 0
    assert page.complaints() == []


def test_robot_of_10000_links(browser: Browser, tmp_path: Path) -> None:
    links = 10_000
    with (tmp_path / 'large.stl').open('wb') as file:
        file.truncate(1_000_000_000)
    (tmp_path / 'model' / 'urdf').mkdir(parents=True)
    sizes = '<sphere radius="1"/>', '<mesh filename="../../large.stl"/>'
    shapes = ''.join(f'<visual><geometry>{size}</geometry></visual>' for size in sizes)
    page = open_robot(browser, tmp_path, chain(tmp_path / 'model' / 'urdf', links, shapes))
    assert (tmp_path / 'robot.html').stat().st_size < 30_000_000
    page.wait_for('!!robotView.page')
    page.press('n')
    page.evaluate('robotView.move(0, 0, 1)')
    tip = page.evaluate('robotView.page.views[0].motion.links.at(-1).elements.slice(12, 15)')
    length = 0.1 * (links - 2)
    assert tip == pytest.approx([length * math.sin(1), 0, 0.1 + length * math.cos(1)])
    assert page.evaluate('robotView.page.views[0].frames.link.length') == 1000
    assert page.evaluate("!document.getElementById('limits').hidden")
    assert page.evaluate("document.getElementById('tree').innerText").endswith('7000 more links')
    assert page.evaluate("document.getElementById('names').childElementCount") <= 200
    # All spheres are one, and all boxes of wire.
    assert page.evaluate('robotView.stage.draw(), robotView.stage.renderer.info.memory.geometries'
                         ) < 2100
    # The page answers while it builds the links.
    assert page.evaluate("""(async () => {
      let answers = 0;
      const timer = setInterval(() => { answers += 1; });
      await robotView.show(robotView.page.document);
      clearInterval(timer);
      return answers;
    })()""") > 0
    page.evaluate('robotView.choose(50)')
    assert 'outside of the folder' in page.evaluate(
        "document.getElementById('numbers').innerText")


@pytest.mark.parametrize(('name', 'low', 'high'), [
    ('ellipsoid', [-0.1, -0.2, -0.3], [0.1, 0.2, 0.3]),
    ('cone', [-0.1, -0.1, -0.15], [0.1, 0.1, 0.15]),
    ('plane', [-5, -5, -0.1], [5, 5, -0.1]), ('capsule', [-0.1, -0.1, -0.35], [0.1, 0.1, 0.35]),
    ('sideways', [-0.1, -5, -5], [-0.1, 5, 5])])
def test_size_of_shapes(
    name: str, low: list[float], high: list[float], page: Page, tmp_path: Path,
) -> None:
    known = {'capsule': ('cone', 'cone', 'capsule'), 'sideways': (
        'plane', '<normal>0 0 1</normal>', '<normal>2 0 0</normal>')}
    fixture, old, new = known.get(name, (name, name, name))
    text = (ROOT / f'test/data/robots/sdf/warning_{fixture}.sdf').read_text().replace(old, new)
    if name == 'capsule':
        text = text.replace('0.3</length>', '0.5</length>')
    if name == 'sideways':
        text = text.replace('<pose>0 0 -0.1', '<pose>-0.1 0 0')
    (tmp_path / 'robot.sdf').write_text(text)
    show(page, tmp_path / 'robot.sdf')
    assert page.evaluate(_BOX) == pytest.approx([*low, *high], abs=TOLERANCE)
    if name == 'cone':  # its tip is above
        assert page.evaluate("""(() => {
          const { array } = robotView.page.views[0].links[0].shapes[0].children[0]
            .geometry.attributes.position;
          return array.filter((_, index) => index % 3 < 2 && array[index - index % 3 + 2] > 0.4);
        })()""") == pytest.approx({str(index): 0 for index in range(66)}, abs=TOLERANCE)


def test_numbers_of_frames(page: Page) -> None:
    show(page, ROOT / 'test/data/robots/sdf/ok_frames.sdf')
    page.evaluate("[...document.querySelectorAll('#tree button')].find((one) => "
                  "one.innerText.includes('frame start')).click()")
    page.evaluate('robotView.move(0, 0, Math.PI / 2)')
    cells = page.evaluate("""['frame', 'sdf-frame', 'frame-in-link', 'frame-now'].map((name) => (
      [...document.querySelectorAll(`[data-name=${name}]`)].map(
        (cell) => cell.firstChild.data)))""")
    assert [*zip(*cells)] == [
        ('tool, attached to link arm', '0.5  0  0  0  0  0\nin link arm', '0.5  0  0  0  0  0',
         '1  0.5  0  0  0  1.5708'),
        ('tip, attached to frame tool', '0  0  0.25  0  0  0\nin frame tool',
         '0.5  0  0.25  0  0  0', '1  0.5  0.25  0  0  1.5708'),
        ('start, attached to link arm', '0  0  2  0  0  0\nin link base', '-1  0  2  0  0  0',
         '1  -1  2  0  0  1.5708')]


@pytest.mark.parametrize(('width', 'height'), [(1280, 800), (390, 844)])
@pytest.mark.parametrize('scheme', ['light', 'dark'])
def test_layout(scheme: str, width: int, height: int, browser: Browser, tmp_path: Path) -> None:
    page = open_robot(browser, tmp_path, SHIPPED[0], width=width, height=height)
    page.prefer(scheme)
    page.press('3')
    assert page.evaluate('document.documentElement.scrollWidth') <= width
    assert page.evaluate('document.documentElement.scrollHeight') <= height
    assert page.evaluate("""[...document.querySelectorAll('aside, aside *')].filter((one) => (
        one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).display !== 'inline'
        && !one.closest('pre, input'))).map((one) => one.outerHTML.slice(0, 200))""") == []
    check_contrast(page)
    background = page.evaluate('robotView.stage.draw(), robotView.stage.scene.background.getHex()')
    assert (background > 0x808080) == (scheme == 'light')


def test_picture_to_save(page: Page) -> None:
    show(page, SHIPPED[0])
    page.evaluate("""HTMLAnchorElement.prototype.click = function () {
      window.saved = [this.download, this.href];
    }, document.getElementById('save').click()""")
    name, _ = page.wait_for('window.saved')
    assert name == 'my_arm.png'
    colors = page.evaluate("""(async () => {
      const picture = await createImageBitmap(await (await fetch(window.saved[1])).blob());
      const canvas = new OffscreenCanvas(picture.width, picture.height).getContext('2d');
      canvas.drawImage(picture, 0, 0);
      return new Set(new Uint32Array(canvas.getImageData(
        0, 0, picture.width, picture.height).data.buffer)).size;
    })()""")
    assert colors > 100


def test_file_without_network(browser: Browser, tmp_path: Path) -> None:
    page = open_robot(browser, tmp_path, painted(tmp_path, 'a.obj'))
    page.wait_for(f'{_BOX} !== null')
    assert page.evaluate('location.protocol') == 'file:'
    assert page.evaluate("""performance.getEntriesByType('resource').map((one) => one.name)
        .filter((name) => !/^(data|blob):/.test(name))""") == []
    page.wait_for(f'{_BLUE} > 1000')
    assert page.complaints() == []


def test_page_of_the_server_after_a_change(browser: Browser, tmp_path: Path) -> None:
    robot = tmp_path / 'robot.urdf'
    robot.write_text(SHIPPED[0].read_text())
    process = subprocess.Popen(
        [sys.executable, '-m', 'opencv_tools.robot.cli', 'robot_view', str(robot), '--port', '0'],
        stderr=subprocess.PIPE, text=True)
    try:
        url = re.search(r'http://\S+', process.stderr.readline())[0]
        page = browser.new_page(url)
        page.wait_for('window.robotView?.page && robotView.stage.draws > 0')
        page.evaluate('robotView.move(1, 0, 0.5)')
        robot.write_text(robot.read_text().replace('upper_arm', 'upper'))
        page.wait_for('robotView.page.document.robots[0].links[1].name === "upper"')
        assert page.evaluate('robotView.page.views[0].motion.positions[1][0]') == 0.5
        robot.write_text('<robot')
        page.wait_for('!document.getElementById("notice").hidden')
        assert 'robot.urdf' in page.evaluate('document.getElementById("notice").textContent')
        assert page.evaluate('robotView.page.views[0].group.parent !== null')
        painted(tmp_path, 'a.obj')
        page.wait_for('document.getElementById("notice").hidden')
        page.wait_for(f'{_BOX} !== null')
        page.wait_for(f'{_BLUE} > 1000')
        assert page.complaints() == []
    finally:
        process.send_signal(signal.SIGINT)
        communicate(process)
