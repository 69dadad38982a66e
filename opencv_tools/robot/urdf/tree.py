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

"""Links and joints of a URDF file: unique names, and one or more trees without cycles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

from lxml import etree
from opencv_tools.robot.kinematics import cycle_text
from opencv_tools.robot.model import WORLD
from opencv_tools.robot.xml.document import (
    DescriptionError, line_of, required_name, TrackedElement)
from opencv_tools.robot.xml.passthrough import SDF_TAG
from opencv_tools.robot.xml.report import Report

_LOOP_JOINT = f'{SDF_TAG}joint'
_Elements = Mapping[str, TrackedElement]


@dataclass(frozen=True)
class LinkTree:
    """
    Elements of links and joints by name, in the order of the file.

    :param joints: all joints, including those that close loops.
    :param parent_joint: the parent joint of each link that has one, by name of the link.
    """

    links: _Elements
    joints: _Elements
    parent_joint: _Elements

    def ends(self, joint: TrackedElement) -> tuple[str, str]:
        """Return the names of the parent link and the child link of a joint."""
        return _end(joint, 'parent', self.links), _end(joint, 'child', self.links)


def build_tree(root: TrackedElement, report: Report) -> LinkTree:
    """
    Return the links and joints of a robot.

    A missing link ``world`` that is the parent of a joint is added as an empty link.

    :raises DescriptionError: there are no links, a name is not unique, or the links of a joint
        are missing or not a tree.
    """
    links = _by_name(root.take_all('link'))
    if not links:
        raise DescriptionError('has no <link>', root)
    joints = _by_name(root.take_all('joint', _LOOP_JOINT))
    if WORLD not in links:
        _add_world(links, joints, report)
    parent_joint: dict[str, TrackedElement] = {}
    tree = LinkTree(links, joints, parent_joint)
    for name, joint in joints.items():
        parent, child = tree.ends(joint)
        if parent == child:
            raise DescriptionError(f'joint {name!r} has link {parent!r} as parent and as child',
                                   joint)
        if joint.tag == _LOOP_JOINT:
            continue
        if child in parent_joint:
            raise DescriptionError(f'link {child!r} is the child of two joints, '
                                   f'{required_name(parent_joint[child])!r} and {name!r}', joint)
        parent_joint[child] = joint
    parents = {link: [tree.ends(joint)[0]] for link, joint in parent_joint.items()}
    try:
        TopologicalSorter(parents).prepare()
    except CycleError as err:
        raise DescriptionError(f'kinematic cycle: {cycle_text(err)}',
                               parent_joint[err.args[1][0]]) from err
    return tree


def _end(joint: TrackedElement, tag: str, links: _Elements) -> str:
    element = joint.find(tag)
    if element is None:
        raise DescriptionError(f'joint {required_name(joint)!r} has no <{tag} link=>', joint)
    name = (element.get('link') or '').strip()
    if name not in links:
        problem = f'link={name!r} does not exist' if name else 'has no link='
        raise DescriptionError(f'{problem}, in joint {required_name(joint)!r}', element)
    return name


def _add_world(links: dict[str, TrackedElement], joints: _Elements, report: Report) -> None:
    for name, joint in joints.items():
        parent = joint.element.find('parent')
        if parent is not None and parent.get('link', '').strip() == WORLD:
            report.warn('joint', name, line_of(parent),
                        f'link {WORLD!r} does not exist; an empty link is added')
            links[WORLD] = TrackedElement(etree.Element('link', name=WORLD))
            return


def _by_name(elements: Iterable[TrackedElement]) -> dict[str, TrackedElement]:
    found: dict[str, TrackedElement] = {}
    for element in elements:
        name = required_name(element)
        if name in found:
            raise DescriptionError(f'name={name!r} is also the name of the element in line '
                                   f'{line_of(found[name])}; give each its own name', element)
        found[name] = element
    return found
