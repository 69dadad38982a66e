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

"""File names in the metadata.yaml of rosbag2."""

from __future__ import annotations

from itertools import islice
import os
from pathlib import Path
import re

from opencv_tools.bags.errors import BagError
from opencv_tools.image.text import printable
from opencv_tools.regular_files import open_regular

_KEY = 'relative_file_paths'
_KEY_DEPTH = 2  # mappings around the key
_MAX_BYTES = 1 << 20
_MAX_DEPTH = 32  # collections around a value; rosbag2 writes six
_MAX_EVENTS = 20_000  # about 1500 topics
# A directive begins a line. PyYAML compares each with all others within one event.
_DIRECTIVE = re.compile('(?:^|[\n\r\x85\u2028\u2029])\ufeff*%')


def read_file_names(path: Path) -> list[str]:
    """
    Read the names of the files of a bag, in their order.

    The file is read as a stream of events. Aliases are not expanded and no objects are created,
    so time and memory are bounded.

    :param path: path of ``metadata.yaml``.
    :returns: names of files, without folders.
    :raises BagError: the file is not YAML, has directives or no names or is too long, or PyYAML
        is missing.
    :raises OSError: the file cannot be read.
    """
    try:
        import yaml
    except ImportError as err:
        raise BagError(f'PyYAML cannot be imported ({err}); install it with pip') from err
    with os.fdopen(open_regular(path), 'rb') as file:
        content = file.read(_MAX_BYTES).decode(errors='replace')
    if _DIRECTIVE.search(content):
        raise BagError('it has directives of YAML, which rosbag2 does not write')
    depth, is_key = 0, False
    names: list[str] | None = None
    try:
        events = yaml.parse(content, getattr(yaml, 'CSafeLoader', yaml.SafeLoader))
        for event in islice(events, _MAX_EVENTS):
            if isinstance(event, yaml.CollectionEndEvent):
                if names is not None:
                    return names
                depth -= 1
            elif isinstance(event, yaml.CollectionStartEvent):
                names = [] if is_key and isinstance(event, yaml.SequenceStartEvent) else names
                depth += 1
                if depth > _MAX_DEPTH:
                    break
            elif names is not None and isinstance(event, yaml.ScalarEvent):
                names.append(Path(event.value).name)
            is_key = (depth == _KEY_DEPTH and isinstance(event, yaml.ScalarEvent)
                      and event.value == _KEY)
    except (yaml.YAMLError, ValueError) as err:
        raise BagError(f'it is not YAML: {printable(err)}') from err
    raise BagError(f'it has no {_KEY} in its first {_MAX_BYTES} bytes')
