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

"""The picture of both conventions, and the room that texts have in all pictures of robots."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
import math
from pathlib import Path
from typing import Any

from lxml import etree
from matplotlib.text import Text
from opencv_tools.robot import conventions, plot
from opencv_tools.robot.cli import robot_frames
from opencv_tools.robot.convert import convert_to_urdf
from opencv_tools.robot.drawing import numbers
from opencv_tools.robot.figures import DPI
from opencv_tools.robot.frames import frames
from opencv_tools.robot.model import (Axis, FrameId, Joint, Link, MODEL, Placement, Robot)
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.read import read_robot
from opencv_tools.robot.report import Report
import pytest

ROOT = Path(__file__).parent.parent
# The joints are not where their links are; the second one's parent is such a link.
SHIFTED = """<sdf version="1.9"><model name="shifted"><link name="base"/>
<link name="arm"><pose>0.5 0 0.3 0 0 0</pose></link>
<link name="hand"><pose>0.5 0 0.7 0 0 0</pose></link>
<joint name="hinge" type="revolute"><parent>base</parent><child>arm</child>
<pose>-0.3 0 0 0 0 0</pose><axis><xyz>0 1 0</xyz></axis></joint>
<joint name="wrist" type="prismatic"><parent>arm</parent><child>hand</child>
<pose>0 0 -0.25 0 0 0</pose><axis><xyz>0 0 1</xyz></axis></joint></model></sdf>
"""
LIMB = (('shoulder_pitch', 0.1, 0.24), ('shoulder_roll', 0.05, -0.01), ('shoulder_yaw', 0.01, -0.1),
        ('elbow_pitch', 0.0, -0.08), ('wrist_roll', 0.0, -0.1), ('palm', 0.0, -0.05))


def limb(side: str, body: str, at: float) -> list[tuple[str, str, Vector]]:
    """Return the links of a limb: each with its parent and where it is there."""
    names = [body, *(f'{side}_{body}_{part}_link' for part, _, _ in LIMB)]
    return [(name, parent, (0.0, at * y, z))
            for name, parent, (_, y, z) in zip(names[1:], names, LIMB)]


def thirty() -> Robot:
    """Build a tall robot of 30 links with long names, as humanoids have them."""
    parts = [('pelvis', 'base_footprint', (0.0, 0.0, 0.9)), ('torso', 'pelvis', (0.0, 0.0, 0.1)),
             ('head', 'torso', (0.0, 0.0, 0.45)), ('imu', 'torso', (-0.04, 0.0, 0.15)),
             ('camera', 'head', (0.05, 0.0, 0.1))]
    for body in ('torso', 'pelvis'):
        for side, at in (('left', 1.0), ('right', -1.0)):
            parts += limb(side, body, at)
    return Robot('thirty', (Link('base_footprint', Placement(Pose(), MODEL)), *(
        Link(name, Placement(Pose(), FrameId('joint', f'{name}_joint')))
        for name, _, _ in parts)), tuple(
            Joint(f'{name}_joint', 'revolute', parent, name,
                  Placement(Pose(xyz), FrameId('link', parent)), (Axis((0.0, 1.0, 0.0)),))
            for name, parent, xyz in parts))


def read(path: Path) -> Robot:
    return read_robot(str(path), Report())[0]


@pytest.fixture()
def shifted(tmp_path: Path) -> Robot:
    path = tmp_path / 'shifted.sdf'
    path.write_text(SHIFTED)
    return read(path)


ROBOTS = {'my_robot': read(ROOT / 'urdf' / 'my_robot.urdf'),
          'my_robot.sdf': read(ROOT / 'sdf' / 'my_robot' / 'model.sdf'),
          'my_arm': read(ROOT / 'urdf' / 'my_arm.urdf'),
          'my_arm.sdf': read(ROOT / 'sdf' / 'my_arm' / 'model.sdf'), 'thirty': thirty()}
MOVED = {'my_arm': {'elbow': 0.5, 'slide': 0.1}, 'my_arm.sdf': {'shoulder': 0.5},
         'thirty': {'left_torso_shoulder_pitch_link_joint': -1.2, 'right_pelvis_elbow_pitch_link_joint': 1.0}}
PICTURES = pytest.mark.parametrize(('name', 'positions'), [
    *((name, {}) for name in ROBOTS), *MOVED.items()],
    ids=[*ROBOTS, *(f'{name} moved' for name in MOVED)])


def both(robot: Robot, positions: dict[str, float]) -> list[Any]:
    """Return the figures of both pictures."""
    listing = frames(robot, positions)
    return [plot.draw(robot, listing), conventions.draw(robot, listing, positions)]


def drawn_texts(figure: Any, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    """Return all texts that a figure draws, each with the rectangle of its pixels."""
    found = []

    def draw(self: Any, renderer: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            found.append((self.get_text(), Text.get_window_extent(self, renderer)))
        original(self, renderer)

    original = Text.draw
    with monkeypatch.context() as patch:
        patch.setattr(Text, 'draw', draw)
        figure.canvas.draw()
    return found


@PICTURES
def test_texts_are_in_the_picture_and_apart(
        name: str, positions: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    robot = ROBOTS[name]
    names = [link.name for link in robot.links] + [joint.name for joint in robot.joints]
    for figure in both(robot, positions):
        texts = drawn_texts(figure, monkeypatch)
        for text, box in texts:
            assert 8 < box.x0 and box.x1 < figure.bbox.width - 8, text
            assert 8 < box.y0 and box.y1 < figure.bbox.height - 8, text
        for (one, box), (other, second) in combinations(texts, 2):
            wide = min(box.x1, second.x1) - max(box.x0, second.x0)
            high = min(box.y1, second.y1) - max(box.y0, second.y0)
            assert min(wide, high) < 3, (one, other)
        for wanted in names:
            assert any(wanted in text for text, _ in texts)
