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

"""
Settings of ``<gazebo reference>``, which SDF has as elements of collisions, links and joints.

The table is that of libsdformat, which converts them if Gazebo itself reads URDF.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from lxml import etree
from opencv_tools.robot.joint_kinds import URDF_TYPES, WITHOUT_AXIS
from opencv_tools.robot.model import FrameId, Joint, Link, MODEL, Robot, Shape
from opencv_tools.robot.sdf.fragments import fragment_flaw
from opencv_tools.robot.sdf.values import GAZEBO_LINES, SCRIPT
from opencv_tools.robot.xml.document import detached, Element, PARTLY_READ
from opencv_tools.robot.xml.report import Report

_Holder = TypeVar('_Holder', Shape, Link, Joint, Robot)
_OPPOSITE = {'true': 'false', '1': 'false', 'false': 'true', '0': 'true'}


@dataclass(frozen=True)
class Setting:
    """
    A setting of a link, of a joint or of the model.

    :param tag: tag in ``<gazebo reference>``.
    :param owner: element of SDF that has it: ``model``, ``link``, ``joint``, or ``visual`` or
        ``collision`` for all visuals or collisions of the link.
    :param paths: paths in that element, all with the same value.
    :param is_opposite: whether SDF has the opposite value.
    """

    tag: str
    owner: str
    paths: tuple[str, ...]
    is_opposite: bool = False

    def converted(self, text: str) -> str:
        """Return the value in the other format."""
        text = text.strip()
        return _OPPOSITE.get(text.lower(), text) if self.is_opposite else text

    def fits(self, joint_type: str) -> bool:
        """Return whether a joint of this type of URDF or SDF has the setting in both formats."""
        has_axis = joint_type in URDF_TYPES and joint_type not in WITHOUT_AXIS
        return has_axis or not self.paths[0].startswith('axis/')

    def flaw(self, text: str) -> str:
        """Return why a value is not valid; empty if it is."""
        leaf = etree.Element(self.paths[0].rpartition('/')[2])
        leaf.text = text
        return fragment_flaw(leaf, is_exact=True) if text else 'has no value'


# By kind of the reference and by tag.
SETTING_OF = {(kind, tag): Setting(
    tag, words[0], tuple(path.lstrip('!') for path in words[1:]), words[1][0] == '!')
    for key, words in GAZEBO_LINES.items() for kind, slash, tag in [key.partition('/')] if slash}
SETTINGS = tuple(SETTING_OF.values())
SETTING_TAGS = {setting.tag for setting in SETTINGS}
# Elements that ``<gazebo>`` has for all visuals or collisions of a link.
_SHARED = {'visual': ('cast_shadows', 'plugin', 'transparency', 'visibility_flags'),
           'collision': ('surface',)}


def set_value(owner: Element, setting: Setting, text: str) -> bool:
    """Write a value into the SDF of an owner, and return whether it had another value."""
    former = owner.findtext(setting.paths[0], text)
    for path in setting.paths:
        element = owner
        *outer, tag = path.split('/')
        for step in outer:
            child = element.find(step)
            element = etree.SubElement(element, step, {PARTLY_READ: 'true'}) if (
                child is None) else child
        leaf = element.find(tag)
        leaf = etree.SubElement(element, tag) if leaf is None else leaf
        leaf.text = text
        if element.tag == 'script' and element.find('uri') is None:
            etree.SubElement(element, 'uri').text = SCRIPT
    return former != text


def take_settings(robot: Robot, report: Report) -> tuple[Robot, dict[FrameId, list[Element]]]:
    """
    Take the settings out of the SDF of a robot.

    :returns: the robot without them, and the settings as they are in ``<gazebo reference>``.
    """
    taken: dict[FrameId, list[Element]] = {}
    names = {link.name for link in robot.links}

    def link_without(link: Link) -> Link:
        found = taken.setdefault(FrameId('link', link.name), [])
        visuals, collisions = (tuple(_taken(tag, shapes, link, found, report)) for tag, shapes in (
            ('visual', link.visuals), ('collision', link.collisions)))
        link, = _taken('link', [link], link, found, report)
        return replace(link, visuals=visuals, collisions=collisions)

    def joint_without(joint: Joint) -> Joint:
        # A block of the same name belongs to the link, and Gazebo has no joint that closes a loop.
        if joint.name in names or joint.is_loop:
            return joint
        found = taken.setdefault(FrameId('joint', joint.name), [])
        return _taken('joint', [joint], joint, found, report)[0]

    robot, = _taken('model', [robot], robot, taken.setdefault(MODEL, []), report)
    return replace(robot, links=tuple(map(link_without, robot.links)),
                   joints=tuple(map(joint_without, robot.joints))), taken


def _taken(kind: str, holders: Sequence[_Holder], owner: Link | Joint | Robot,
           found: list[Element], report: Report) -> list[_Holder]:
    """Return the holders of settings without those that all of them have with one value."""
    if all(holder.extension.sdf is None for holder in holders):
        return list(holders)
    copies = [None if holder.extension.sdf is None else detached(holder.extension.sdf)
              for holder in holders]
    for setting in SETTINGS:
        if setting.owner != kind or not setting.fits(getattr(owner, 'type', '')):
            continue
        leaves = [_leaves(copy, setting) for copy in copies]
        texts = {leaf.text or '' for each in leaves for leaf in each}
        if not texts:
            continue
        if len(texts) > 1 or not all(leaves):
            is_shape = kind in ('visual', 'collision')
            place = f'all {kind}s of the link' if is_shape else f'the whole {kind}'
            report.warn(setting.tag, owner.name, getattr(owner, 'line', 0), 'is preserved '
                        f'without effect: URDF has one value of <{setting.paths[0]}> for {place}')
            continue
        element = etree.Element(setting.tag)
        element.text = setting.converted(texts.pop())
        found.append(element)
        for leaf in (leaf for each in leaves for leaf in each):
            _remove(leaf)
    whole = [copy for copy in copies if copy is not None]
    if len(whole) == len(copies) and (shared := _shared(whole, _SHARED.get(kind, ()))):
        element = etree.Element(kind)
        element.extend(shared)
        found.append(element)
    return [replace(holder, extension=holder.extension.with_sdf(copy))
            for holder, copy in zip(holders, copies)]


def _shared(owners: Sequence[Element], tags: Sequence[str]) -> list[Element]:
    """Remove the elements with certain tags that all owners have alike, and return them."""
    shared = []
    for child in owners[0].findall('*') if owners else ():
        alike = [twin for owner in owners for twin in owner.findall(str(child.tag))
                 if etree.tostring(twin, method='c14n') == etree.tostring(child, method='c14n')]
        is_one = child.tag == 'plugin' or len(owners[0].findall(str(child.tag))) == 1
        if child.tag in tags and is_one and len(alike) == len(owners) and (
                not fragment_flaw(child, is_exact=True)):
            copy = detached(child)
            etree.strip_attributes(copy, PARTLY_READ)
            shared.append(copy)
            for twin in alike:
                _remove(twin)
    return shared


def _leaves(owner: Element | None, setting: Setting) -> list[Element]:
    """Return the elements that have the one value of a setting; empty if they do not."""
    # Of several elements with one tag, libsdformat reads the first one.
    found = [] if owner is None else [
        owner.find(path.replace('/', '[1]/')) for path in setting.paths]
    leaves = [leaf for leaf in found if leaf is not None and not leaf.attrib and not len(leaf)]
    if setting.owner == 'visual':  # other scripts are in other files
        leaves = [leaf for leaf in leaves if (parent := leaf.getparent()) is not None
                  and parent.findtext('uri') == SCRIPT]
    texts = {(leaf.text or '').strip() for leaf in leaves}
    is_one = len(leaves) == len(setting.paths) and len(texts) == 1 and not setting.flaw(*texts)
    return leaves if is_one else []


def _remove(element: Element) -> None:
    """Remove an element, and the elements around it that are then empty."""
    parent = element.getparent()
    if parent is None:
        return
    parent.remove(element)
    if parent.tag == 'script':
        parent[:] = [child for child in parent if child.text != SCRIPT]
    is_first = next(parent.itersiblings(str(parent.tag)), None) is not None
    if not len(parent) and not set(parent.attrib) - {PARTLY_READ} and not is_first:
        _remove(parent)
