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

"""Frames that become links on fixed joints, and root links that are fixed to one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from opencv_tools.robot.cli import robot_compare, sdf_to_urdf, urdf_to_sdf
from opencv_tools.robot.kinematics import Kinematics
from opencv_tools.robot.load import read_robot
from opencv_tools.robot.model import FrameId
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.trees import with_frame_links
from opencv_tools.robot.xml.document import parse
from opencv_tools.robot.xml.report import Report
import pytest

FRAMES = """<sdf version="1.9"><model name="m"><link name="base"/>
<link name="arm"><pose>1 0 0 0 0 0.5</pose></link>
<joint name="hinge" type="revolute"><parent>base</parent><child>arm</child>
<axis><xyz>0 0 1</xyz></axis></joint>
<frame name="optical" attached_to="arm"><pose>0.1 0 0 -1.5708 0 -1.5708</pose></frame>
<frame name="tip" attached_to="optical"><pose relative_to="base">0 3 0 0 0 0</pose></frame>
<frame name="axle" attached_to="hinge"/><frame name="floor"><pose>0 0 -1 0 0 0</pose></frame>
</model></sdf>
"""


@pytest.mark.parametrize('position', [0.0, 0.7])
def test_frames_as_links(tmp_path: Path, position: float) -> None:
    paths = [tmp_path / name for name in ('a.sdf', 'b.urdf', 'c.sdf')]
    paths[0].write_text(FRAMES)
    assert sdf_to_urdf([str(paths[0]), '-o', str(paths[1]), '--frames', 'links']) == 0
    assert urdf_to_sdf([str(paths[1]), '-o', str(paths[2]), '--fixed', 'lump']) == 0
    poses = [Kinematics(read_robot(str(path), Report())[0]).forward({'hinge': [position]})
             for path in paths]
    for name in ('optical', 'tip', 'axle', 'floor'):
        original, link, frame = (
            np.hstack([one[FrameId(kind, name)].rotation, one[FrameId(kind, name)].translation])
            for one, kind in zip(poses, ('frame', 'link', 'frame')))
        np.testing.assert_allclose(link, original, atol=1e-12)
        np.testing.assert_allclose(frame, original, atol=1e-12)
    assert robot_compare([str(paths[0]), str(paths[2])]) == 0
    tree = read_robot(str(paths[1]), Report())[0]
    assert {joint.child: joint.parent for joint in tree.joints} == {
        'arm': 'base', 'optical': 'arm', 'tip': 'arm', 'axle': 'arm', 'floor': 'base'}


def test_names_of_links_for_frames() -> None:
    robot = read_sdf(parse(FRAMES.replace('"tip"', '"optical_joint"').encode(), '', Report()),
                     Report())
    result = with_frame_links(robot, Report())
    names = [*(link.name for link in result.links), *(joint.name for joint in result.joints)]
    assert len(set(names)) == len(names) == 11
    assert {'optical', 'optical_joint', 'axle', 'floor'} < {link.name for link in result.links}
    assert result.frames == ()


ROOTS = """<sdf version="1.9"><model name="m"><link name="a"><pose>1 0 0 0 0 0</pose></link>
<link name="b"><pose>0 2 0 0 0 1</pose></link><link name="c"><pose>0 2 3 0 0 1</pose></link>
<joint name="b_joint" type="revolute"><parent>b</parent><child>c</child>
<axis><xyz>0 0 1</xyz></axis></joint></model></sdf>
"""


@pytest.mark.parametrize(('name', 'origin'), [
    ('world', (0, 0, 0)), ('my base', (0, 0, 0)), ('a', (1, 0, 0)), ('b', (0, 2, 0))])
def test_root_links_fixed_to_one(name: str, origin: tuple[float, ...], tmp_path: Path,
                                 capsys: pytest.CaptureFixture[str]) -> None:
    paths = tmp_path / 'a.sdf', tmp_path / 'b.urdf'
    paths[0].write_text(ROOTS)
    command = [str(paths[0]), '-o', str(paths[1]), '--strict', '--inertial', 'zero']
    assert sdf_to_urdf(command) == 2
    assert "--root: 'a', 'b', or fix all to one with sdf_to_urdf --world-link" in (
        capsys.readouterr().err)
    assert sdf_to_urdf([*command, '--world-link', name]) == 0, capsys.readouterr().err
    robots = [Kinematics(read_robot(str(path), Report())[0]) for path in paths]
    assert robots[1].roots == [name]
    before, after = (one.forward({'b_joint': [0.5]}) for one in robots)
    for link in (FrameId('link', link) for link in 'abc'):
        np.testing.assert_allclose(
            np.subtract(before[link].translation, after[link].translation),
            np.subtract(origin, after[FrameId('link', name)].translation), atol=1e-12)
        np.testing.assert_allclose(after[link].rotation, before[link].rotation, atol=1e-12)


def test_world_link_that_is_below_another(tmp_path: Path,
                                          capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'a.sdf').write_text(ROOTS)
    assert sdf_to_urdf([str(tmp_path / 'a.sdf'), '--world-link', 'c']) == 2
    assert "--world-link 'c' is a link below another one; give the name of a new link, or one " \
        "of 'a', 'b'" in capsys.readouterr().err


@pytest.mark.parametrize(('content', 'block'), [
    ('', '<gravity>0</gravity>'), ('', '<plugin name="p" filename="p.so"/>'),
    ('', '<sensor name="s" type="imu"/>'),
    ('<visual><geometry><box size="1 1 1"/></geometry></visual>', ''),
    ('<collision><geometry><sphere radius="2"/></geometry></collision>', '<mu1>0.3</mu1>')])
@pytest.mark.parametrize('kind', ['fixed', 'continuous'])
def test_robot_at_a_world_with_content_stays_there(
        tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, block: str, kind: str
) -> None:
    path = tmp_path / 'a.urdf'
    path.write_text(f"""<robot name="a"><link name="world">{content}</link><link name="b">
<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
</link><joint name="x" type="{kind}"><parent link="world"/><child link="b"/></joint>
<gazebo reference="world">{block}</gazebo></robot>""")
    assert urdf_to_sdf([str(path)]) == 0
    written, warnings = capsys.readouterr()
    assert '<parent>world</parent>' in written and warnings.count("<link> 'world': ") == 1
    assert urdf_to_sdf(['--strict', str(path)]) == 1
