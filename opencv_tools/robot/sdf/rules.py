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
Rules of the SDF parser for names, colours and values, applied to a written robot.

Invalid names are changed. The originals are preserved as ``urdf:name`` and restored on the way
back. Colours are clamped. Other invalid values are errors.

The tables follow libsdformat 12 and SDF 1.9. Newer versions accept what they accept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from itertools import islice
import math
from pathlib import Path
import re
from typing import TypeVar

from opencv_tools.robot.model import WORLD
from opencv_tools.robot.names import allowed_name, flat_name, Names
from opencv_tools.robot.xml.defined import read_lines
from opencv_tools.robot.xml.document import DescriptionError, Element, line_of, local_name
from opencv_tools.robot.xml.numbers import c_float, clamped, numbers_text
from opencv_tools.robot.xml.passthrough import URDF_NAME, URDF_TAG
from opencv_tools.robot.xml.report import Report

_Value = TypeVar('_Value')
# By the last tag: the other tags of each end of a path, the last one first, with a value.
_Ends = Mapping[str, list[tuple[list[str], _Value]]]
# Elements whose names must not be reserved names of frames.
_FRAMED = ('light', 'sensor', 'particle_emitter', 'projector')
# Elements with names from `renaming.with_valid_sdf_names`, which are not changed again.
_VALID = ('link', 'joint', 'frame', 'collision', 'visual')
_NUMBER = re.compile(
    r'[+-]?(?:0x[\da-f]+|inf(?:inity)?|nan|(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)',
    re.ASCII | re.IGNORECASE)


@lru_cache(4096)
def _read_number(text: str) -> float | None:
    """Return the number at the start of a text, as C reads it; None if there is no number."""
    found = _NUMBER.match(text)
    if found is None:
        return None
    word = found[0].lower()
    try:
        value = float(int(word, 16)) if 'x' in word else float(word)
    except OverflowError:
        return None
    return None if math.isinf(value) and 'inf' not in word else value


def _numbers(count: int, text: str) -> bool:
    values = [_read_number(word) for word in text.split()]
    return len(values) >= count and all(
        value is not None and math.isfinite(value) for value in values[:count])


def _is_color(text: str) -> bool:
    values = [_read_number(word) for word in text.split()]
    return len(values) in (3, 4) and None not in values


def _ends(table: Mapping[str, _Value]) -> _Ends[_Value]:
    """Return a table of ends of paths by their last tags, the longest ends first."""
    found: dict[str, list[tuple[list[str], _Value]]] = {}
    for end in sorted(table, key=lambda end: end.count('/'), reverse=True):
        tag, *outer = reversed(end.split('/'))
        found.setdefault(tag, []).append((outer, table[end]))
    return found


# Check of a text, and description of a valid text, by type of value.
_KINDS: Mapping[str, tuple[Callable[[str], bool], str]] = {
    'double': (lambda text: _read_number(text) is not None, 'a number'),
    'int': (lambda text: _read_number(text) is not None, 'an integer'),
    'unsigned': (lambda text: _read_number(text) is not None, 'an integer from 0'),
    'bool': (lambda text: text.lower() in ('true', 'false', '1', '0'), 'true or false'),
    'vector3': (lambda text: _numbers(3, text), '3 numbers'),
    'color': (_is_color, '3 or 4 numbers'),
    'pose': (lambda text: _numbers(6, text) and len(text.split()) == 6, '6 finite numbers'),
    'quaternion': (lambda text: _numbers(7, text) and len(text.split()) == 7,
                   '7 finite numbers'),
}
_COUNTS = {'double': 1, 'vector3': 3}
# The texts of integers of which libsdformat ignores nothing but zeros.
_INTEGERS = {'int': r'[+-]?\d+(\.0*)?', 'unsigned': r'\+?\d+(\.0*)?'}
_COLORS = ('ambient', 'diffuse', 'specular', 'emissive', 'color_start', 'color_end')


def _read_rule(kind: str, *limits: str) -> tuple[str, float, float]:
    largest = 2**31 - 1 if kind == 'int' else math.inf
    values = {'min': -largest - 1, 'max': largest, **dict(limit.split('=') for limit in limits)}
    return kind, float(values['min']), float(values['max'])


_ANY = _read_rule('')[1:]
# The end of a path counts more than a tag, because some tags have several meanings.
_RULES = _ends({end: _read_rule(*words or ['']) for end, words in read_lines(
    Path(__file__).with_name('values.txt')).items()})
_REQUIRED = read_lines(Path(__file__).with_name('required.txt'))


def _is_ignored(element: Element) -> bool:
    """Return whether the parser ignores an element: a plugin, or an element with a prefix."""
    return not isinstance(element.tag, str) or element.tag == 'plugin' or '{' in element.tag


def parsed_elements(element: Element) -> Iterator[Element]:
    """Return an element and all elements inside that the parser does not ignore."""
    pending = [element]
    while pending:
        current = pending.pop()
        if not _is_ignored(current):
            yield current
            pending.extend(reversed(current))


def find_flaw(element: Element, *, is_exact: bool = False) -> str:
    """
    Return why the parser rejects an element, without its children; empty if it does not.

    :param is_exact: whether to reject also nan, and text after a number, which the parser ignores.
    """
    tag = str(element.tag)
    for name in _REQUIRED.get(tag, ()):
        if not element.get(name, '').strip():
            return f'has no {name}=, which SDF requires'
    for plugin in element.iterchildren('plugin') if len(element) else ():
        if not (plugin.get('filename', '').strip() and plugin.get('name', '').strip()):
            return 'has a <plugin> without filename= or name=, which SDF requires'
    types = _REQUIRED.get(f'{tag}@type')
    if types and element.get('type') not in types:
        return f'type={element.get("type")!r} is not a type of <{tag}> in SDF'
    text = (element.text or '').strip()
    return _find_wrong_value(element, text, is_exact) if text and not len(element) else ''


def _is_exact(text: str, kind: str) -> bool:
    if kind in _INTEGERS:
        return re.fullmatch(_INTEGERS[kind], text, re.ASCII) is not None
    try:
        values = tuple(map(c_float, text.split()))
    except ValueError:
        return kind not in _COUNTS
    return len(values) == _COUNTS.get(kind, len(values)) and not any(map(math.isnan, values))


def _find_wrong_value(element: Element, text: str, is_exact: bool) -> str:
    for end, rule in _RULES.get(str(element.tag), ()):
        if not end or end == [
                str(above.tag) for above in islice(element.iterancestors(), len(end))]:
            kind, low, high = rule
            break
    else:
        return ''
    if kind == 'pose' and element.get('rotation_format') == 'quat_xyzw':
        kind = 'quaternion'
    if kind in _KINDS and not (_KINDS[kind][0](text) and (not is_exact or _is_exact(text, kind))):
        return f'{text!r} is not {_KINDS[kind][1]}'
    value = _read_number(text) if (low, high) != _ANY else None
    if value is not None and (value < low or value > high):
        return f'{text!r} is outside of {low:g} to {high:g}'
    return ''


def keep_sdf_rules(root: Element, source: str, report: Report) -> None:
    """
    Change what the parser of SDF would reject.

    :param root: the ``<sdf>``; it is changed.
    :param source: the file that the robot comes from.
    :raises DescriptionError: an invalid value cannot be changed.
    """
    former: tuple[Element | None, str] = None, ''
    for element in parsed_elements(root):
        if len(element):
            _rename_children(element, report)
        if element.tag in _COLORS:
            color = element.getparent(), (element.text or '').strip()
            # Ambient and diffuse come from one colour of URDF.
            _clamp_color(element, report if color != former else Report())
            former = color
        flaw = find_flaw(element)
        if flaw:
            raise DescriptionError(flaw, source=source, line=line_of(element),
                                   tag=local_name(element))


def _rename_children(element: Element, report: Report) -> None:
    """Rename the children with reserved or duplicate names, or with ``::`` in their names."""
    named = [child for child in element if isinstance(child.tag, str) and child.tag != 'plugin'
             and child.get('name') is not None]
    renamable = [child for child in named if not _has_valid_name(child)]
    if not renamable:
        return
    taken = Names(child.get('name', '') for child in named if _has_valid_name(child))
    for child in renamable:
        name = new = child.get('name', '')
        if child.tag in _FRAMED:
            new = f'{WORLD}_{child.tag}' if name == WORLD else allowed_name(name)
        elif not _is_ignored(child):
            new = flat_name(name)
        new = taken.kept(new, f'_{local_name(child)}')
        if new != name:
            child.set(URDF_NAME, child.get(URDF_NAME, name))
            child.set('name', new)
            report.warn(local_name(child), name, line_of(child),
                        f'renamed to {new!r}, because SDF requires unique names and reserves some')


def _has_valid_name(child: Element) -> bool:
    return child.tag in _VALID or str(child.tag).startswith(URDF_TAG)


def _clamp_color(element: Element, report: Report) -> None:
    words = (element.text or '').split()
    values = tuple(value for word in words if (value := _read_number(word)) is not None)
    if len(values) == len(words) and clamped(values) != values:
        text = (element.text or '').strip()
        element.text = numbers_text(clamped(values))
        names = (outer.get('name') for outer in element.iterancestors())
        report.warn(local_name(element), next(filter(None, names), ''), line_of(element),
                    f'{text!r} is outside of 0 to 1; clamped to {element.text!r}')
