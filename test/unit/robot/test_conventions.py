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

"""Picture of both conventions."""

from __future__ import annotations

from functools import cache
from itertools import combinations
import math
from pathlib import Path
from typing import Any

from lxml import etree
from matplotlib.text import Text
from opencv_tools.robot.cli import robot_frames
from opencv_tools.robot.convert import convert_to_urdf
from opencv_tools.robot.drawing import conventions
from opencv_tools.robot.drawing.conventions import DPI
from opencv_tools.robot.drawing.primitives import pose_text
from opencv_tools.robot.frames.listing import frames
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import Axis, FrameId, Joint, Link, MODEL, Placement, Robot
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.xml.report import Report
import pytest

ROOT = Path(__file__).parents[3]
# Both joints are away from their links.
SHIFTED = """<sdf version="1.9"><model name="shifted"><link name="base"/>
<link name="arm"><pose>0.5 0 0.3 0 0 0</pose></link>
<link name="hand"><pose>0.5 0 0.7 0 0 0</pose></link>
<joint name="hinge" type="revolute"><parent>base</parent><child>arm</child>
<pose>-0.3 0 0 0 0 0</pose><axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper></limit>
</axis></joint>
<joint name="wrist" type="prismatic"><parent>arm</parent><child>hand</child>
<pose>0 0 -0.25 0 0 0</pose><axis><xyz>0 0 1</xyz></axis></joint></model></sdf>
"""
LIMB = (('shoulder_pitch', 0.1, 0.24), ('shoulder_roll', 0.05, -0.01),
        ('shoulder_yaw', 0.01, -0.1), ('elbow_pitch', 0.0, -0.08),
        ('wrist_roll', 0.0, -0.1), ('palm', 0.0, -0.05))


def limb(side: str, body: str, at: float) -> list[tuple[str, str, Vector]]:
    """Return the links of a limb, each with its parent link and position."""
    names = [body, *(f'{side}_{body}_{part}_link' for part, _, _ in LIMB)]
    return [(name, parent, (0.0, at * y, z))
            for name, parent, (_, y, z) in zip(names[1:], names, LIMB)]


def thirty() -> Robot:
    """Create a tall robot of 30 links with long names, similar to a humanoid."""
    parts = [('pelvis', 'base_footprint', (0.0, 0.0, 0.9)), ('torso', 'pelvis', (0.0, 0.0, 0.1)),
             ('head', 'torso', (0.0, 0.0, 0.45)), ('imu', 'torso', (-0.04, 0.0, 0.15)),
             ('camera', 'head', (0.05, 0.0, 0.1))]
    for body in ('torso', 'pelvis'):
        for side, at in (('left', 1.0), ('right', -1.0)):
            parts += limb(side, body, at)
    return Robot(name='thirty',
                 links=(Link(name='base_footprint', placement=Placement(Pose(), MODEL)),
                        *(Link(name=name,
                               placement=Placement(Pose(), FrameId('joint', f'{name}_joint')))
                          for name, _, _ in parts)),
                 joints=tuple(Joint(name=f'{name}_joint', type='revolute', parent=parent,
                                    child=name,
                                    placement=Placement(Pose(xyz), FrameId('link', parent)),
                                    axes=(Axis((0.0, 1.0, 0.0)),)) for name, parent, xyz in parts))


def short() -> Robot:
    """Create a robot with names shorter than the headings of the picture."""
    return Robot(name='r',
                 links=(Link(name='a', placement=Placement(Pose(), MODEL)),
                        Link(name='b', placement=Placement(Pose(), FrameId('joint', 'j')))),
                 joints=(Joint(name='j', type='fixed', parent='a', child='b',
                               placement=Placement(Pose((0.0, 0.0, 1.0)), FrameId('link', 'a'))),))


def read(path: Path) -> Robot:
    return read_robot(str(path), Report())[0]


@pytest.fixture()
def shifted(tmp_path: Path) -> Robot:
    path = tmp_path / 'shifted.sdf'
    path.write_text(SHIFTED)
    return read(path)


ROBOTS = {'my_robot': read(ROOT / 'urdf' / 'my_robot.urdf'),
          'my_arm': read(ROOT / 'urdf' / 'my_arm.urdf'),
          'my_arm.sdf': read(ROOT / 'sdf' / 'my_arm' / 'model.sdf'), 'thirty': thirty(),
          'short': short()}
MOVED = {'my_arm': {'elbow': 0.5, 'slide': 0.1}, 'my_arm.sdf': {'shoulder': 0.5},
         'thirty': {'left_torso_shoulder_pitch_link_joint': -1.2,
                    'right_pelvis_elbow_pitch_link_joint': 1.0}}
PICTURES = pytest.mark.parametrize(('name', 'positions'), [
    *((name, {}) for name in ('my_robot', 'my_arm', 'thirty', 'short')), *MOVED.items()],
    ids=['my_robot', 'my_arm', 'thirty', 'short', *(f'{name} moved' for name in MOVED)])


def drawn_texts(figure: Any, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    """Return all texts that a figure draws, each with its bounding box in pixels."""
    found = []

    def draw(self: Any, renderer: Any) -> None:
        if self.get_visible() and self.get_text().strip():
            found.append((self.get_text(), Text.get_window_extent(self, renderer)))

    with monkeypatch.context() as patch:
        patch.setattr(Text, 'draw', draw)
        figure.canvas.draw()
    return found


@pytest.mark.quick_cases(1)
@PICTURES
def test_all_texts_without_overlaps(
        name: str, positions: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    robot = ROBOTS[name]
    figure = panels(robot, positions)[0].figure
    names = [link.name for link in robot.links] + [joint.name for joint in robot.joints]
    texts = drawn_texts(figure, monkeypatch)
    for (one, box), (other, second) in combinations(texts, 2):
        wide = min(box.x1, second.x1) - max(box.x0, second.x0)
        high = min(box.y1, second.y1) - max(box.y0, second.y0)
        assert min(wide, high) < 3, (one, other)
    for wanted in names:
        assert any(wanted in text for text, _ in texts)


def panels(robot: Robot, positions: dict[str, float] | None = None) -> list[Any]:
    """Return the halves of the picture of both conventions, which tests share."""
    return _panels(robot, tuple((positions or {}).items()))


@cache
def _panels(robot: Robot, positions: tuple[tuple[str, float], ...]) -> list[Any]:
    return list(conventions.draw(robot, frames(robot, dict(positions))).axes)


def entries(axes: Any) -> dict[str, str]:
    """Return the numbers below each title in the columns of a panel."""
    texts = [one for one in axes.texts if (one.arrowprops or {}).get('arrowstyle') != '-|>']
    assert [one.get_fontsize() for one in texts[:2]] == [12, 9]  # the headings
    titles, numbers = texts[2::2], texts[3::2]
    assert all(one.get_fontweight() == 'bold' for one in titles)
    found = {title.get_text(): under.get_text()
             for title, under in zip(titles, numbers, strict=True)}
    assert len(found) == len(titles)
    return found


ORIGINS = {'shoulder (continuous)': 'in base_link\nxyz 0 0 0.1  rpy 0 0 0',
           'elbow (revolute)': 'in upper_arm\nxyz 0 0 0.4  rpy 0 0 0',
           'slide (prismatic)': 'in forearm\nxyz 0 0 0.35  rpy 0 0 0'}
NAMES = dict.fromkeys(['base_link', 'upper_arm', 'forearm', 'tool'], '')


@pytest.mark.parametrize('name', ['my_arm', 'my_arm.sdf'])
def test_origins_in_urdf_and_link_poses_in_sdf(name: str) -> None:
    urdf, sdf = panels(ROBOTS[name])
    assert urdf.texts[0].get_text() == 'URDF places joints'
    assert sdf.texts[0].get_text() == 'SDF places links'
    assert entries(urdf) == NAMES | ORIGINS
    assert entries(sdf) == {
        'frame of the model': '', 'base_link': 'xyz 0 0 0  rpy 0 0 0',
        'upper_arm': 'xyz 0 0 0.1  rpy 0 0 0', 'forearm': 'xyz 0 0 0.5  rpy 0 0 0',
        'tool': 'xyz 0 0 0.85  rpy 0 0 0'}


def test_fixed_origins_and_moved_links() -> None:
    urdf, sdf = panels(ROBOTS['my_arm'], MOVED['my_arm'])
    assert [text.get_text() for text in urdf.figure.texts] == [
        'robot my_arm at elbow=0.5, slide=0.1']
    assert entries(urdf) == NAMES | {
        'shoulder (continuous)': ORIGINS['shoulder (continuous)'],
        'elbow (revolute) at 0.5': ORIGINS['elbow (revolute)'],
        'slide (prismatic) at 0.1': ORIGINS['slide (prismatic)']}
    found = entries(sdf)
    assert found['upper_arm'] == 'xyz 0 0 0.1  rpy 0 0 0'
    assert found['forearm, moved'] == 'xyz 0 0 0.5  rpy 0 0.5 0'
    assert found['tool, moved'] == 'xyz 0.2157 0 0.8949  rpy 0 0.5 0'


def test_joints_away_from_their_links(shifted: Robot) -> None:
    urdf, sdf = panels(shifted)
    found = entries(urdf)
    assert found['hinge (revolute)'] == 'in base\nxyz 0.2 0 0.3  rpy 0 0 0'
    # In URDF, the frame of the arm is the frame of its joint.
    root = convert_to_urdf(shifted, Report())
    origin = root.find('joint[@name="wrist"]/origin')
    assert isinstance(origin, etree._Element)
    xyz = [float(value) for value in origin.get('xyz', '').split()]
    assert xyz == pytest.approx([0.3, 0.0, 0.15])
    assert found['wrist (prismatic)'] == f'in arm\n{pose_text(xyz, (0.0, 0.0, 0.0), "  ")}'
    assert entries(sdf) == {
        'frame of the model': '', 'base': 'xyz 0 0 0  rpy 0 0 0',
        'arm': 'xyz 0.5 0 0.3  rpy 0 0 0', 'hand': 'xyz 0.5 0 0.7  rpy 0 0 0',
        'joint hinge (revolute)': 'in arm\nxyz -0.3 0 0  rpy 0 0 0',
        'joint wrist (prismatic)': 'in hand\nxyz 0 0 -0.25  rpy 0 0 0'}
    assert 'frame of the model' in entries(panels(shifted, {'wrist': 0.1})[1])


def arrows(axes: Any) -> list[tuple[Any, Any]]:
    """Return the starts and ends of the arrows of a panel in metres."""
    return [(one.xyann, one.xy) for one in axes.texts
            if (getattr(one, 'arrowprops', None) or {}).get('arrowstyle') == '-|>']


def seen(*points: Vector) -> list[tuple[float, float]]:
    """Return the projections of points for a viewer 55 degrees to the right and 22 above."""
    right = (math.sin(math.radians(55)), math.cos(math.radians(55)), 0.0)
    low, high = math.sin(math.radians(22)), math.cos(math.radians(22))
    up = (-low * right[1], low * right[0], high)
    return [(math.fsum(a * b for a, b in zip(right, point)),
             math.fsum(a * b for a, b in zip(up, point))) for point in points]


def test_arrows_to_joints_and_to_links(shifted: Robot) -> None:
    urdf, sdf = panels(shifted)
    base, hinge, wrist, arm, hand = seen(
        (0.0, 0.0, 0.0), (0.2, 0.0, 0.3), (0.5, 0.0, 0.45), (0.5, 0.0, 0.3), (0.5, 0.0, 0.7))
    for axes, wanted in ((urdf, [(base, hinge), (hinge, wrist)]),
                         (sdf, [(base, arm), (base, hand)])):
        assert not any(one.get_clip_on() for one in axes.collections)
        found = arrows(axes)
        (x, y), (a, b) = found[0]
        scale = math.dist((x, y), (a, b)) / math.dist(*wanted[0])
        for got, points in zip(found, wanted, strict=True):
            for (one, other), point in zip(got, points, strict=True):
                assert (one - x, other - y) == pytest.approx(
                    (scale * (point[0] - base[0]), scale * (point[1] - base[1])), abs=1e-9)
        joints, = [line for line in axes.lines if line.get_marker() == 'h']
        for got, point in zip(zip(*joints.get_data()), (hinge, wrist), strict=True):
            assert (got[0] - x, got[1] - y) == pytest.approx(
                (scale * point[0], scale * point[1]), abs=1e-9)
    # Both panels have the same scale.
    assert math.dist(*arrows(urdf)[0]) / math.dist(base, hinge) == pytest.approx(
        math.dist(*arrows(sdf)[0]) / math.dist(base, arm))


def test_lines_from_texts_to_points() -> None:
    for axes in panels(ROBOTS['thirty']):
        count = len(entries(axes))
        leaders = [one for one in axes.texts if one.arrowprops
                   and one.arrowprops['arrowstyle'] == '-']
        assert len(leaders) == count
        ends = {tuple(round(value, 6) for value in one.xy) for one in leaders}
        points = [tuple(round(value, 6) for value in end) for _, end in arrows(axes)]
        assert len(points) == 29 and set(points) <= ends


def test_entries_of_a_large_robot() -> None:
    # A hand with 80 patches of skin, whose only joint that moves comes last in the file.
    patches = [Joint(name=f'patch_{index}', type='fixed', parent=parent, child=f'patch_{index}',
                     placement=Placement(Pose((0.1, 0.0, 0.0)), FrameId('link', parent)))
               for index, parent in enumerate(['palm', *(f'patch_{n}' for n in range(79))])]
    thumb = Joint(name='thumb', type='continuous', parent='palm', child='thumb',
                  placement=Placement(Pose((0.0, 0.1, 0.0)), FrameId('link', 'palm')))
    joints = (*patches, thumb)
    robot = Robot(name='hand', joints=joints, links=(
        Link(name='palm', placement=Placement(Pose(), MODEL)),
        *(Link(name=joint.child, placement=Placement(Pose(), FrameId('joint', joint.name)))
          for joint in joints)))
    assert [panel.texts[1].get_text().partition('numbers of ')[2] for panel in panels(robot)] == [
        '60 of 81, the listing has all', '60 of 82, the listing has all']
    for panel, count in zip(panels(robot), (60, 61), strict=True):
        titles = entries(panel)
        assert len(titles) == count
        assert any('thumb' in title for title in titles)
        assert any('patch_79' in title for title in titles)  # the end of the chain
        assert any('patch_0' in title for title in titles)
        assert not any('patch_70' in title for title in titles)


def test_shipped_picture(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from matplotlib.image import imread
    shipped, made = ROOT / 'docs' / 'images' / 'conventions.png', tmp_path / 'conventions.png'
    assert robot_frames([str(ROOT / 'urdf' / 'my_arm.urdf'), '--conventions', str(made)]) == 0
    assert 'joint elbow (revolute)' in capsys.readouterr().out
    assert 10_000 < shipped.stat().st_size < 100_000
    one, other = imread(shipped), imread(made)
    # Text sizes differ slightly between versions of matplotlib.
    assert one.shape[:2] == pytest.approx(other.shape[:2], rel=0.05)
    assert one.shape[1] / DPI > 8
