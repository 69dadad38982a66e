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
Write opencv_tools/robot/sdf/elements.txt, what SDF defines by the tag around it, and values.txt.

Run it with a checkout of https://github.com/gazebosim/sdformat: ``python write_sdf_elements.py
SDFORMAT``. All versions count together, because files of old versions are read too. The values are
those of SDF 1.9, which libsdformat 12 reads; newer versions accept what it accepts.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
import sys

from lxml import etree

KINDS = ('bool', 'color', 'double', 'int', 'pose', 'unsigned', 'vector3')
PAGE = Path(__file__).parents[1] / 'opencv_tools' / 'robot' / 'sdf' / 'elements.txt'


def collect(root: etree._Element, files: dict[str, etree._Element], table: dict[str, set[str]],
            seen: set[etree._Element]) -> None:
    """Add the children and attributes of an element and of all elements in it."""
    if root in seen:
        return
    seen.add(root)
    names = table[root.get('name', '')]
    names.update(f'@{one.get("name")}' for one in root.iterchildren('attribute'))
    for child in root.iterchildren('element', 'include'):
        if child.get('copy_data'):
            names.add('*')
        included = files.get(child.get('filename', ''))
        found = included if included is not None else child
        if name := found.get('name') or found.get('ref', '').partition('.')[0]:
            names.add(name)
        if found.get('name'):
            collect(found, files, table, seen)


def write_values(folder: Path) -> None:
    """Write the types and ranges of values, by tag, and by ends of paths with others."""
    files = {path.name: etree.parse(path).getroot() for path in folder.glob('*.sdf')}
    found: dict[tuple[str, ...], str] = {}

    def walk(element: etree._Element, outer: tuple[str, ...], stack: tuple[str, ...]) -> None:
        path = (element.get('name', ''), *outer)
        limits = ' '.join(f'{key}={element.get(key)}' for key in ('min', 'max') if (
            element.get(key) and element.get('type') == 'double'))
        kind = element.get('type', '').removesuffix(' int')  # of 'unsigned int'
        found[path] = f'{kind} {limits}'.strip()
        for child in element.iterchildren('element', 'include'):
            name = child.get('filename', '')
            if child.tag == 'include' and name not in stack and name in files:
                walk(files[name], path, (*stack, name))
            elif child.get('name'):
                walk(child, path, stack)

    for name in ('link.sdf', 'joint.sdf', 'gripper.sdf'):
        walk(files[name], (), (name,))
    for child in files['model.sdf'].iterchildren('element'):
        if child.get('name'):
            walk(child, ('model',), ())
    ends: dict[str, str] = {}
    for tag in {path[0] for path in found}:
        counts = Counter(value for path, value in found.items() if path[0] == tag)
        ends[tag] = max(counts, key=lambda value: (counts[value], value))
    for path, value in found.items():
        for length in range(2, len(path) + 1) if value != ends[path[0]] else ():
            if len({other for one, other in found.items() if one[:length] == path[:length]}) == 1:
                ends['/'.join(reversed(path[:length]))] = value
                break
    page = PAGE.with_name('values.txt')
    head = [line for line in page.read_text(encoding='utf-8').splitlines() if line[:1] == '#']
    lines = [f'{end}: {value}'.strip() for end, value in sorted(ends.items())
             if value.partition(' ')[0] in KINDS or ends[end.rpartition('/')[2]] != value]
    page.write_text('\n'.join([*head, *lines, '']), encoding='utf-8')


def main(folder: Path) -> None:
    """Write the table of all versions from 1.2, of the elements that a model may contain."""
    table: dict[str, set[str]] = defaultdict(set)
    for version in sorted((folder / 'sdf').glob('1.*')):
        if version.name != '1.0':
            files = {path.name: etree.parse(path).getroot() for path in version.glob('*.sdf')}
            for root in files.values():
                collect(root, files, table, set())
    pending, kept = ['model'], set[str]()
    while pending:
        name = pending.pop()
        if name in table and name not in kept:
            kept.add(name)
            pending.extend(table[name])
    head = [line for line in PAGE.read_text(encoding='utf-8').splitlines() if line[:1] == '#']
    lines = [' '.join([f'{name}:', *sorted(table[name])]) for name in sorted(kept)]
    PAGE.write_text('\n'.join([*head, *lines, '']), encoding='utf-8')
    write_values(folder / 'sdf' / '1.9')


if __name__ == '__main__':
    main(Path(sys.argv[1]))
