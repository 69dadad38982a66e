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
Write opencv_tools/robot/sdf/elements.txt: what SDF defines, by the tag around it.

Run it with a checkout of https://github.com/gazebosim/sdformat: ``python write_sdf_elements.py
SDFORMAT``. All versions count together, because files of old versions are read too.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
import sys

from lxml import etree

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


if __name__ == '__main__':
    main(Path(sys.argv[1]))
