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

"""Random errors in the XML of a robot, such as typing errors leave."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from random import Random
import xml.etree.ElementTree as ElementTree

Element = ElementTree.Element
Change = Callable[[Random, Element], None]
_TEXTS = ('', ' ', '0', '-1', '1', '0 0 0', '1 2', '1 2 3', '0 0 0 0 0 0', '1 2 3 4 5 6',
          'nan', 'inf', '-inf', '1e400', '1e-400', '1,5', 'a::b', '__model__', 'world', 'link_0',
          '../link_0', 'base', '\u00e9', '0x10', '1e16', '1_0')


def mutated(random: Random, root: Element) -> Element:
    """Return a copy of a robot with one to three changes."""
    root = deepcopy(root)
    for _ in range(1 + random.randrange(3)):
        random.choice(CHANGES)(random, root)
    return root


def _pair(random: Random, root: Element) -> tuple[Element, Element] | None:
    """Return a random parent and one of its children."""
    pairs = [(parent, child) for parent in root.iter() for child in parent]
    return random.choice(pairs) if pairs else None


def _any(random: Random, root: Element) -> Element:
    return random.choice([*root.iter()])


def _attribute(random: Random, root: Element) -> tuple[Element, str] | None:
    found = [(element, name) for element in root.iter() for name in element.attrib]
    return random.choice(found) if found else None


def _drop(random: Random, root: Element) -> None:
    if pair := _pair(random, root):
        pair[0].remove(pair[1])


def _double(random: Random, root: Element) -> None:
    if pair := _pair(random, root):
        pair[0].insert(random.randrange(len(pair[0]) + 1), deepcopy(pair[1]))


def _double_with_other_text(random: Random, root: Element) -> None:
    if pair := _pair(random, root):
        copy = deepcopy(pair[1])
        inner = _any(random, copy)
        inner.text = random.choice(_TEXTS)
        pair[0].append(copy)


def _rename(random: Random, root: Element) -> None:
    if pair := _pair(random, root):
        pair[1].tag = random.choice((_any(random, root).tag, 'element', 'frame', 'mimic', 'odd'))


def _empty(random: Random, root: Element) -> None:
    if pair := _pair(random, root):
        text = pair[1].text
        pair[1].clear()
        pair[1].text = random.choice((None, text))


def _empty_of_children(random: Random, root: Element) -> None:
    if pair := _pair(random, root):
        del pair[1][:]


def _shuffle(random: Random, root: Element) -> None:
    element = _any(random, root)
    children = list(element)
    random.shuffle(children)
    element[:] = children


def _move(random: Random, root: Element) -> None:
    if pair := _pair(random, root):
        pair[0].remove(pair[1])
        # No parser accepts an element next to a text.
        random.choice([element for element in root.iter() if not (element.text or '').strip()]
                      ).append(pair[1])


def _odd_text(random: Random, root: Element) -> None:
    texts = [element for element in root.iter() if (element.text or '').strip()]
    if texts:
        random.choice(texts).text = random.choice(_TEXTS)


def _odd_attribute(random: Random, root: Element) -> None:
    if found := _attribute(random, root):
        found[0].set(found[1], random.choice(_TEXTS))


def _drop_attribute(random: Random, root: Element) -> None:
    if found := _attribute(random, root):
        del found[0].attrib[found[1]]


def _copy_attribute(random: Random, root: Element) -> None:
    """Copy a random attribute to another element."""
    if found := _attribute(random, root):
        _any(random, root).set(found[1], found[0].get(found[1], ''))


def _swap_attributes(random: Random, root: Element) -> None:
    first, second = _attribute(random, root), _attribute(random, root)
    if first and second:
        values = first[0].get(first[1], ''), second[0].get(second[1], '')
        first[0].set(first[1], values[1])
        second[0].set(second[1], values[0])


def _number_of_words(random: Random, root: Element) -> None:
    if found := _attribute(random, root):
        words = found[0].get(found[1], '').split()
        found[0].set(found[1], ' '.join(random.choice((words[:1], words[:-1], words * 2))))


CHANGES: tuple[Change, ...] = (
    _drop, _double, _double_with_other_text, _rename, _empty, _empty_of_children, _shuffle, _move,
    _odd_text, _odd_attribute, _drop_attribute, _copy_attribute, _swap_attributes,
    _number_of_words)
