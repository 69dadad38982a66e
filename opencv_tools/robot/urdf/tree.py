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

"""The links and joints of a URDF file: each name once, and all of them one tree or several."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lxml import etree
from opencv_tools.robot.model import WORLD
from opencv_tools.robot.trees import shortened
from opencv_tools.robot.xml.document import DescriptionError, line_of, required_name
from opencv_tools.robot.xml.passthrough import SDF_NAMESPACE
from opencv_tools.robot.xml.report import Report
from opencv_tools.robot.xml.tracked import TrackedElement


@dataclass(frozen=True)
class TreeOfLinks:
    """
    The elements of links and joints by name, in the order of the file.

    :param joints: those that close loops, too.
    :param above: the joint that is above each link, by the link's name.
    """

    links: Mapping[str, TrackedElement]
    joints: Mapping[str, TrackedElement]
    above: Mapping[str, TrackedElement]

    def ends(self, joint: TrackedElement) -> tuple[str, str]:
        """
        Name the parent and the child of a joint.

        :raises DescriptionError: one is not given, or there is no such link.
        """
        return self._end(joint, 'parent'), self._end(joint, 'child')

    def _end(self, joint: TrackedElement, tag: str) -> str:
        end = joint.find(tag)
        if end is None:
            raise DescriptionError(f'joint {required_name(joint)!r} has no <{tag} link=>', joint)
        name = (end.get('link') or '').strip()
        if name not in self.links:
            problem = f'link={name!r} is no link of the robot' if name else 'has no link='
            raise DescriptionError(f'{problem}, in joint {required_name(joint)!r}', end)
        return name


def tree_of(root: TrackedElement, report: Report) -> TreeOfLinks:
    """
    Find the links and joints of a robot, and which hangs on which.

    A link ``world`` that a joint names as its parent need not be there; it is an empty one then.

    :raises DescriptionError: there are none, a name occurs twice, or they are no trees.
    """
    links = _by_name(root.take_all('link'))
    if not links:
        raise DescriptionError('has no <link>', root)
    loops = f'{{{SDF_NAMESPACE}}}joint'
    joints = _by_name(root.take_all('joint', loops))
    if WORLD not in links:
        _add_world(links, joints, report)
    above: dict[str, TrackedElement] = {}
    tree = TreeOfLinks(links, joints, above)
    for name, joint in joints.items():
        parent, child = tree.ends(joint)
        if parent == child:
            raise DescriptionError(f'joint {name!r} has link {parent!r} as parent and as child',
                                   joint)
        if joint.tag == loops:
            continue
        if child in above:
            raise DescriptionError(f'link {child!r} is the child of two joints, '
                                   f'{required_name(above[child])!r} and {name!r}', joint)
        above[child] = joint
    _check_cycles(tree)
    return tree


def _add_world(links: dict[str, TrackedElement], joints: Mapping[str, TrackedElement],
               report: Report) -> None:
    for name, joint in joints.items():
        parent = joint.element.find('parent')
        if parent is not None and parent.get('link', '').strip() == WORLD:
            report.warn('joint', name, line_of(parent),
                        f'there is no link {WORLD!r}; it is taken for an empty one')
            links[WORLD] = TrackedElement(etree.Element('link', name=WORLD))
            return


def _by_name(elements: list[TrackedElement]) -> dict[str, TrackedElement]:
    found: dict[str, TrackedElement] = {}
    for element in elements:
        name = required_name(element)
        if name in found:
            raise DescriptionError(f'name={name!r} is taken by another one in line '
                                   f'{found[name].sourceline}', element)
        found[name] = element
    return found


def _check_cycles(tree: TreeOfLinks) -> None:
    fine: set[str] = set()
    for link in tree.links:
        path: dict[str, None] = {}
        while link in tree.above and link not in fine:
            if link in path:
                circle = list(path)[list(path).index(link):]
                raise DescriptionError(f'links hang on each other in a circle: '
                                       f'{shortened(circle[::-1])}', tree.above[link])
            path[link] = None
            link = tree.ends(tree.above[link])[0]
        fine.update(path)
