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

"""Values of SDF in every version: versions, flags, numbers, poses and colours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
import math
from pathlib import Path
import re
from typing import NamedTuple, TypeVar

from lxml import etree
from opencv_tools.robot.geometry import BLACK, Color, Material
from opencv_tools.robot.model import Shape
from opencv_tools.robot.pose import Pose, rotation_of_quaternion, Tensor, Transform
from opencv_tools.robot.xml.defined import read_lines
from opencv_tools.robot.xml.document import AnyElement, DescriptionError, Element, line_of
from opencv_tools.robot.xml.numbers import (
    number, number_text, numbers, numbers_text, quoted)
from opencv_tools.robot.xml.report import Report

Default = TypeVar('Default', float, None)


class Version(NamedTuple):
    """A version of SDF."""

    major: int
    minor: int

    def __str__(self) -> str:
        return f'{self.major}.{self.minor}'


MODEL_FRAME = '__model__'
SEPARATOR = '::'

OLDEST_READ = Version(1, 2)  # robots are written in it as in 1.4
OLDEST_WRITTEN = Version(1, 7)
NEWEST = Version(1, 12)
# The first version with a feature:
JOINT_AXES = Version(1, 5)  # axes in the joint frame, and fixed joints
FRAMES = Version(1, 7)  # <frame attached_to>, <pose relative_to>, <xyz expressed_in>
CAPSULE = Version(1, 8)
MIMIC = Version(1, 11)
AUTO_INERTIA = Version(1, 11)

# Mass and moments of inertia in kg and kg m2, where a file has none.
DEFAULT_INERTIAL: tuple[float, Tensor] = (1.0, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))

# The colours of a material, with the field of each.
MATERIAL_COLORS = {
    'ambient': 'ambient', 'diffuse': 'color', 'specular': 'specular', 'emissive': 'emissive'}

# The colours of the materials that Gazebo has by name: diffuse, and ambient if it differs.
SCRIPT = 'file://media/materials/scripts/gazebo.material'
_GAZEBO_COLORS = {f'Gazebo/{name}': words for name, words in read_lines(
    Path(__file__).with_name('colors.txt')).items()}

# What Gazebo makes of the children of <gazebo> and <gazebo reference>. The first are elements of
# SDF in the model, link or joint, and the converter moves them between these places.
GAZEBO_LINES = read_lines(Path(__file__).with_name('gazebo.txt'))
GAZEBO: Mapping[str, frozenset[str]] = {
    owner: frozenset(GAZEBO_LINES[owner]) for owner in ('model', 'link', 'joint')}
# Parts of the model that Gazebo copies from <gazebo> too; they are read as those of the robot.
MODEL_PARTS = ('frame', 'joint', 'link')
# Tags in <gazebo reference="joint"> that preserve a fixed joint.
PRESERVING_TAGS = ('preserveFixedJoint', 'disableFixedJointLumping')
# Elements of a link that have a pose, by default in the frame of the link.
POSED = frozenset({'audio_source', 'light', 'particle_emitter', 'projector', 'sensor'})
_POSE_HOLDERS = POSED | {'model', 'link', 'joint', 'frame', 'camera'}
_FLAGS = {'true': True, '1': True, 'false': False, '0': False}


def version_of(text: str) -> Version | None:
    """Read a version; return None if the text is not a version."""
    match = re.fullmatch(r'([0-9]{1,9})\.([0-9]{1,9})', text.strip())
    return Version(int(match[1]), int(match[2])) if match else None


def file_version(root: Element, report: Report) -> Version:
    """
    Return the version that a file is read as.

    :param root: the ``<sdf>``.
    :raises DescriptionError: the version is missing, invalid or too old.
    """
    text = root.get('version')
    version = version_of(text or '')
    if version is None or version < OLDEST_READ:
        flaw = 'has no version' if text is None else f'version={quoted(text)} is not supported'
        raise DescriptionError(f'{flaw}; use {OLDEST_READ} to {NEWEST}', root)
    if version > NEWEST:
        report.warn('sdf', '', line_of(root),
                    f'version {text} is newer than {NEWEST}; read as {NEWEST}')
    return min(version, NEWEST)


def written_version(text: str) -> Version:
    """
    Read a version for output.

    :raises DescriptionError: the version cannot be written.
    """
    version = version_of(text)
    if version is None or not OLDEST_WRITTEN <= version <= NEWEST:
        raise DescriptionError(
            f'SDF version {quoted(text)} cannot be written; use {OLDEST_WRITTEN} to {NEWEST}')
    return version


def flag(text: str | None, element: AnyElement, attribute: str = '') -> bool:
    """
    Read a bool; return False for an empty text.

    :param attribute: attribute with the text; empty for the text of the element.
    """
    word = (text or '').strip().lower()
    if word and word not in _FLAGS:
        subject = f'{attribute}=' if attribute else ''
        raise DescriptionError(f'{subject}{word!r} is not a bool; use true or false', element)
    return _FLAGS.get(word, False)


def text_element(parent: Element, tag: str, text: str) -> Element:
    """Write a child element with a text."""
    element = etree.SubElement(parent, tag)
    element.text = text
    return element


def number_element(parent: Element, tag: str, value: float) -> None:
    """Write a child element with a number."""
    text_element(parent, tag, number_text(value))


def text_of(element: AnyElement, tag: str) -> str:
    """Return the text of a child; empty if there is no such child."""
    return (element.findtext(tag) or '').strip()


def number_of(element: AnyElement, tag: str, default: Default) -> float | Default:
    """Return the number in a child, or a default if there is no such child."""
    child = element.find(tag)
    return default if child is None else number(child.text, child)


def pose_of(element: AnyElement | None) -> Pose:
    """
    Read a ``<pose>`` of six numbers or with a quaternion.

    :param element: None for a missing pose, which is zero.
    """
    if element is None or not (element.text or '').strip():
        return Pose()
    rotation_format = element.get('rotation_format', 'euler_rpy')
    degrees = flag(element.get('degrees'), element, 'degrees')
    if rotation_format == 'quat_xyzw':
        if degrees:
            raise DescriptionError('degrees="true" does not apply to a quaternion; remove it',
                                   element)
        x, y, z, qx, qy, qz, qw = numbers(element.text, 7, element)
        if not any((qx, qy, qz, qw)):
            raise DescriptionError('the quaternion is 0 0 0 0; give a non-zero quaternion',
                                   element)
        return Transform(rotation_of_quaternion((qw, qx, qy, qz)), (x, y, z)).pose()
    if rotation_format != 'euler_rpy':
        raise DescriptionError(f'rotation_format={rotation_format!r} is not supported; use '
                               'euler_rpy or quat_xyzw', element)
    x, y, z, roll, pitch, yaw = numbers(element.text, 6, element)
    if degrees:
        roll, pitch, yaw = map(math.radians, (roll, pitch, yaw))
    return Pose((x, y, z), (roll, pitch, yaw))


def pose_element(parent: Element, pose: Pose, relative_to: str = '') -> None:
    """Write a ``<pose>`` into an element; omit a zero pose without ``relative_to``."""
    if pose.is_identity and not relative_to:
        return
    element = text_element(parent, 'pose', numbers_text(pose.xyz + pose.rpy))
    if relative_to:
        element.set('relative_to', relative_to)


def poses_in(element: Element) -> Iterator[Element]:
    """Return the poses that SDF defines; not those of plugins and unknown elements."""
    for child in element:
        if child.tag == 'pose':
            yield child
        elif child.tag in _POSE_HOLDERS:
            yield from poses_in(child)


def color_of(element: AnyElement) -> Color:
    """Read a colour; the default of alpha is 1."""
    text = element.text or ''
    red, green, blue, *alpha = numbers(text, 3 if len(text.split()) == 3 else 4, element)
    return red, green, blue, alpha[0] if alpha else 1.0


def colors_of(material: AnyElement) -> dict[str, Color]:
    """Read the colours of a ``<material>``, by the field of each."""
    return {field: color_of(child) for tag, field in MATERIAL_COLORS.items()
            if (child := material.find(tag)) is not None}


def with_gazebo_color(shape: Shape) -> Shape:
    """Return a visual with the colours of its material of Gazebo, if it has none of its own."""
    sdf, material = shape.extension.sdf, shape.material or Material()
    words = [] if sdf is None else _GAZEBO_COLORS.get(
        (sdf.findtext('material/script/name') or '').strip(), [])
    if not words or material.color or material.texture:
        return shape
    red, green, blue, alpha, *ambient = map(float, words)
    color = red, green, blue, alpha
    return replace(shape, material=replace(
        material, color=color, ambient=material.ambient or (
            (ambient[0], ambient[1], ambient[2], ambient[3]) if ambient else color),
        specular=material.specular or BLACK, emissive=material.emissive or BLACK))
