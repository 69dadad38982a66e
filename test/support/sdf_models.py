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

"""Small SDF models and robots, and functions to read and write them."""

from __future__ import annotations

from dataclasses import replace
import math

from opencv_tools.robot.geometry import Geometry
from opencv_tools.robot.model import Axis, FrameId, Joint, Link, MODEL, Placement, Robot, Shape
from opencv_tools.robot.pose import Pose, Vector
from opencv_tools.robot.sdf.reader import read_sdf
from opencv_tools.robot.sdf.writer import write_sdf
from opencv_tools.robot.xml.document import Element, parse, to_bytes
from opencv_tools.robot.xml.report import Report

TWO = '<link name="a"/><link name="b"/>'
HALF = math.pi / 2
TURNED = Pose((0.1, 0.2, 0.3), (0.0, 0.0, 1.5708))
VERSIONS = [f'1.{minor}' for minor in range(7, 13)]


def read(content: str, version: str = '1.9', report: Report | None = None,
         attributes: str = '') -> Robot:
    """Read an SDF model with the given content."""
    return read_text(f'<sdf version="{version}" xmlns:urdf="urn:opencv_tools:urdf" '
                     f'xmlns:preserved="urn:opencv_tools:preserved">\n'
                     f'<model name="m" {attributes}>{content}</model></sdf>', report)


def read_text(text: str, report: Report | None = None, model: str = '') -> Robot:
    """Read a text of SDF."""
    report = report or Report()
    return read_sdf(parse(text.encode(), 'robot.sdf', report), report, model=model)


def joint(content: str = '', kind: str = 'fixed', name: str = 'j', parent: str = 'a',
          child: str = 'b') -> str:
    """Return the text of a joint."""
    return (f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>'
            f'{content}</joint>')


def near(first: Vector, second: Vector) -> bool:
    """Return whether two vectors are equal except for rounding."""
    return math.dist(first, second) < 1e-12


def urdf_robot(kind: str = 'revolute', **changes: object) -> Robot:
    """Return a chain of three links with the placements of URDF."""
    links = [Link(name='base', placement=Placement(Pose(), MODEL))]
    joints = []
    for name, parent in (('arm', 'base'), ('hand', 'arm')):
        joints.append(Joint(name=f'{name}_joint', type=kind, parent=parent, child=name,
                            placement=Placement(TURNED, FrameId('link', parent)),
                            axes=() if kind == 'fixed' else (Axis((1.0, 0.0, 0.0)),)))
        links.append(Link(name=name,
                          placement=Placement(Pose(), FrameId('joint', f'{name}_joint'))))
    robot = Robot(name='robot', links=tuple(links), joints=tuple(joints))
    return replace(robot, **changes)  # type: ignore[arg-type]


def written(robot: Robot, report: Report | None = None, version: str = '1.11',
            relative: bool = False) -> Element:
    """Write a robot and return its ``<model>``."""
    root = write_sdf(robot, report or Report(), version=version, relative=relative)
    assert root.get('version') == version
    return root[0]


def reread(robot: Robot, version: str = '1.11', relative: bool = False) -> Robot:
    """Write a robot and read the result."""
    root = write_sdf(robot, Report(), version=version, relative=relative)
    return read_sdf(parse(to_bytes(root), '', Report()), Report())


def with_axis(axis: Axis, kind: str = 'revolute') -> Robot:
    """Return a robot whose first joint has an axis."""
    robot = urdf_robot()
    return replace(robot, joints=(replace(robot.joints[0], type=kind, axes=(axis,)),
                                  robot.joints[1]))


def with_shape(shape: Shape) -> Robot:
    """Return a robot with one visual."""
    return Robot(name='robot',
                 links=(Link(name='a', placement=Placement(Pose(), MODEL), visuals=(shape,)),))


def with_geometry(geometry: Geometry | None) -> Robot:
    """Return a robot with one visual of a geometry."""
    return with_shape(Shape(name='v', placement=Placement(Pose(), FrameId('link', 'a')),
                            geometry=geometry))
