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

"""Values of SDF: versions, poses, colours and flags, as each version writes them."""

from __future__ import annotations

from collections.abc import Iterator
import math

from lxml import etree
from opencv_tools.robot.geometry import Color
from opencv_tools.robot.pose import Pose, rotation_of_quaternion, Transform
from opencv_tools.robot.xml.document import AnyElement, DescriptionError, Element, line_of
from opencv_tools.robot.xml.numbers import numbers, numbers_text, unclamped
from opencv_tools.robot.xml.passthrough import URDF_NAMESPACE
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.schema import POSED

Version = tuple[int, int]

MODEL_FRAME = '__model__'
SEPARATOR = '::'

OLDEST: Version = (1, 4)  # that is written
OLDEST_READ: Version = (1, 2)  # in which a robot is written as in 1.4
NEWEST: Version = (1, 12)
# From these versions on an SDF has ...
FRAMES: Version = (1, 7)  # frames with attached_to, poses with relative_to, axes expressed_in
JOINT_AXES: Version = (1, 5)  # axes in the joint's frame, and fixed joints
CONTINUOUS: Version = (1, 6)
PBR: Version = (1, 6)
CAPSULE: Version = (1, 8)
MIMIC: Version = (1, 11)

# The attribute that keeps a colour of which SDF took only a part.
CUT = f'{{{URDF_NAMESPACE}}}color'

# The colours of a material, with the field that has each.
MATERIAL_COLORS = {
    'ambient': 'ambient', 'diffuse': 'color', 'specular': 'specular', 'emissive': 'emissive'}

_HOLDERS = POSED | {'model', 'link', 'joint', 'frame', 'camera'}
_FLAGS = {'true': True, '1': True, 'false': False, '0': False}


def version_text(version: Version) -> str:
    """Write a version."""
    return '.'.join(map(str, version))


def version_of(text: str) -> Version | None:
    """Read a version; None when it is none."""
    major, _, minor = text.strip().partition('.')
    if not (major.isascii() and major.isdigit() and minor.isascii() and minor.isdigit()):
        return None
    return int(major), int(minor)


def file_version(root: Element, report: Report) -> Version:
    """
    Give the version by which a file is read.

    :param root: its ``<sdf>``.
    :raises DescriptionError: it has none, or one that is older than this reads.
    """
    text = root.get('version')
    if text is None:
        raise DescriptionError(f'has no version; {_range(OLDEST_READ)} are read', root)
    version = version_of(text)
    if version is None or version < OLDEST_READ:
        raise DescriptionError(f'version={text!r} is not read; {_range(OLDEST_READ)} are', root)
    if version > NEWEST:
        report.warn('sdf', '', line_of(root),
                    f'version {text} is newer than what is known; read as {version_text(NEWEST)}')
    return min(version, NEWEST)


def written_version(text: str) -> Version:
    """
    Read a version that is to be written.

    :raises DescriptionError: it is none of those that can be written.
    """
    version = version_of(text)
    if version is None or not OLDEST <= version <= NEWEST:
        raise DescriptionError(f'SDF {text!r} is not written; {_range(OLDEST)} are')
    return version


def _range(oldest: Version) -> str:
    return f'{version_text(oldest)} to {version_text(NEWEST)}'


def flag(text: str | None, element: AnyElement, what: str = '') -> bool:
    """
    Read a bool; False where there is none.

    :param what: the attribute that has it; empty for the text of the element.
    """
    word = (text or '').strip().lower()
    if word and word not in _FLAGS:
        subject = f'{what}=' if what else ''
        raise DescriptionError(f'{subject}{word!r} is neither true nor false', element)
    return _FLAGS.get(word, False)


def text_element(parent: Element, tag: str, text: str) -> Element:
    """Write a child that has a text."""
    element = etree.SubElement(parent, tag)
    element.text = text
    return element


def text_of(element: AnyElement, tag: str) -> str:
    """Give the text of a child; empty where there is no such child."""
    return (element.findtext(tag) or '').strip()


def pose_of(element: AnyElement | None) -> Pose:
    """
    Read the numbers of a ``<pose>``, of six numbers or of a quaternion.

    :param element: None for one that is not there.
    """
    if element is None or not (element.text or '').strip():
        return Pose()
    layout = element.get('rotation_format', 'euler_rpy')
    degrees = flag(element.get('degrees'), element, 'degrees')
    if layout == 'quat_xyzw':
        return _quaternion_pose(element, degrees)
    if layout != 'euler_rpy':
        raise DescriptionError(
            f'rotation_format={layout!r} is neither euler_rpy nor quat_xyzw', element)
    x, y, z, roll, pitch, yaw = numbers(element.text, 6, element)
    if degrees:
        roll, pitch, yaw = map(math.radians, (roll, pitch, yaw))
    return Pose((x, y, z), (roll, pitch, yaw))


def _quaternion_pose(element: AnyElement, degrees: bool) -> Pose:
    if degrees:
        raise DescriptionError('degrees="true" says nothing about a quaternion', element)
    x, y, z, qx, qy, qz, qw = numbers(element.text, 7, element)
    if not any((qx, qy, qz, qw)):
        raise DescriptionError('the quaternion is 0 0 0 0, which is no rotation', element)
    if not any((qx, qy, qz)):
        return Pose((x, y, z))
    return Transform(rotation_of_quaternion((qw, qx, qy, qz)), (x, y, z)).pose()


def pose_element(parent: Element, pose: Pose, relative_to: str = '') -> None:
    """Write a ``<pose>`` into an element, where there is something to say."""
    if pose.is_identity and not relative_to:
        return
    element = etree.SubElement(parent, 'pose')
    if relative_to:
        element.set('relative_to', relative_to)
    element.text = numbers_text(pose.xyz + pose.rpy)


def poses_in(element: Element) -> Iterator[Element]:
    """Return the poses that SDF itself reads, and none of a plugin or of what others added."""
    for child in element:
        if child.tag == 'pose':
            yield child
        elif child.tag in _HOLDERS:
            yield from poses_in(child)


def color_of(element: AnyElement) -> Color:
    """Read a colour of three or four numbers, or what it was cut from; without alpha, opaque."""
    text = unclamped(element.text or '', element.get(CUT))
    red, green, blue, *rest = numbers(text, 3 if len(text.split()) == 3 else 4, element)
    return red, green, blue, rest[0] if rest else 1.0
