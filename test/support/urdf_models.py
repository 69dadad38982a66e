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

"""Small robots of URDF, and functions to read and write them."""

from __future__ import annotations

from lxml import etree
from opencv_tools.robot.convert import convert_to_sdf, convert_to_urdf, SdfOptions
from opencv_tools.robot.geometry import Sphere
from opencv_tools.robot.model import (
    Axis, Dynamics, Extension, FrameId, Inertial, Joint, Limit, Link, Mimic, MODEL, Placement,
    Robot, RobotFrame, Shape)
from opencv_tools.robot.pose import Pose
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.urdf.reader import read_urdf
from opencv_tools.robot.urdf.writer import write_urdf
from opencv_tools.robot.xml.document import DescriptionError, Element, parse, to_bytes
from opencv_tools.robot.xml.report import Report
import pytest

SDF = 'xmlns:sdf="urn:opencv_tools:sdf" xmlns:preserved="urn:opencv_tools:preserved"'
LINKS = '<link name="a"/><link name="b"/>'
ENDS = '<parent link="a"/><child link="b"/>'
LIMIT = '<limit effort="1" velocity="2"/>'
BOX = '<geometry><box size="1 2 3"/></geometry>'
BLACK = (0.0, 0.0, 0.0, 1.0)
RED = (1.0, 0.0, 0.0, 1.0)


def read(content: str, report: Report | None = None, root_link: str = '') -> Robot:
    """Read a robot with the given content."""
    version = ' version="1.1"' if 'quat_xyzw' in content else ''
    data = f'<robot name="r"{version} {SDF}>{content}</robot>'.encode()
    report = report or Report()
    return read_urdf(parse(data, 'r.urdf', report), report, root_link=root_link)


def joint(content: str, kind: str = 'revolute', name: str = 'j') -> str:
    """Return the text of two links and a joint between them."""
    return f'{LINKS}<joint name="{name}" type="{kind}">{ENDS}{content}</joint>'


def visual(content: str, tag: str = 'visual') -> str:
    """Return the text of a link with a visual or collision."""
    return f'<link name="a"><{tag}>{content}</{tag}></link>'


def written(model: Robot, report: Report | None = None) -> Element:
    """Write a robot, and parse the file."""
    report = report or Report()
    return parse(to_bytes(write_urdf(model, report)), 'r.urdf', report)


def round_trip(model: Robot) -> Robot:
    """Write a robot and read it."""
    return read_urdf(written(model), Report())


def through_sdf(content: str, report: Report | None = None) -> Element:
    """Convert URDF to SDF and back."""
    root = convert_to_sdf(read(content), Report(), SdfOptions(inertial='zero', version='1.9'))
    robot = read_sdf(parse(to_bytes(root), 'r.sdf', Report()), Report())
    return convert_to_urdf(robot, report or Report())


def check_error(content: str, location: str, message: str) -> None:
    """Check that a robot is refused with one line that begins with a location."""
    with pytest.raises(DescriptionError) as caught:
        read(content)
    assert str(caught.value).startswith(f'r.urdf:{location}: '), str(caught.value)
    assert message in str(caught.value)
    assert '\n' not in str(caught.value)


def robot_of_sdf() -> Robot:
    """Return a robot of SDF, whose joints are away from the frames of their child links."""
    def shape(link: str, extension: Extension = Extension()) -> Shape:  # noqa: B008
        geometry = None if extension.sdf is not None else Sphere(1.0)
        return Shape(name='s',
                     placement=Placement(Pose((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
                                         FrameId('link', link)), geometry=geometry, material=None,
                     extension=extension)

    def extra(text: str) -> Extension:
        return Extension(None, etree.fromstring(text))

    links = (
        Link(name='a', placement=Placement(Pose((1.0, 0.0, 0.0)), MODEL),
             visuals=(shape('a'),)),
        Link(name='b', placement=Placement(Pose((0.0, 2.0, 0.0), (0.3, 0.2, 0.1)), MODEL),
             inertial=Inertial(Placement(Pose((0.0, 0.0, 0.1)), FrameId('link', 'b')), 2.0,
                               (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
             visuals=(shape('b', extra('<visual><geometry><plane/></geometry></visual>')),),
             collisions=(shape('b'),),
             extension=extra('<link><sensor name="s" type="imu"><pose>1 2 3 0 0 0</pose></sensor>'
                             '<sensor name="t" type="imu"/><sensor name="u" type="imu">'
                             '<pose relative_to="f" degrees="true">0 0 0 0 0 90</pose>'
                             '</sensor><odd>1</odd></link>')),
        Link(name='c', placement=Placement(Pose((0.0, 0.0, 3.0)), MODEL),
             visuals=(shape('c'),)),
    )
    joints = (
        Joint(name='j', type='revolute', parent='a', child='b',
              placement=Placement(Pose((0.5, 0.0, 0.0), (0.0, 0.25, 0.0)), FrameId('link', 'b')),
              axes=(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0)),)),
        Joint(name='k', type='universal', parent='b', child='c',
              placement=Placement(Pose(), FrameId('link', 'c')),
              axes=(Axis((0.0, 0.0, 1.0), Limit(-1.0, 1.0)),
                    Axis((1.0, 0.0, 0.0), None, Dynamics(1.0), Mimic('j', 2.0)))),
        Joint(name='l', type='ball', parent='c', child='b',
              placement=Placement(Pose((0.0, 0.0, 0.7)), FrameId('link', 'b')), axes=(),
              is_loop=True),
        Joint(name='m', type='revolute', parent='c', child='a',
              placement=Placement(Pose(), FrameId('link', 'a')),
              axes=(Axis((0.0, 1.0, 0.0), Limit(-1.0, 1.0)),), is_loop=True),
    )
    frames = (RobotFrame(name='f', attached_to=FrameId('link', 'b'),
                         placement=Placement(Pose((0.0, 9.0, 0.0)), FrameId('joint', 'j'))),
              RobotFrame(name='g', attached_to=MODEL, placement=Placement(Pose(), MODEL)))
    return Robot(name='r', links=links, joints=joints, frames=frames, canonical_link='b',
                 extension=extra('<model><static>1</static><odd/></model>'))
