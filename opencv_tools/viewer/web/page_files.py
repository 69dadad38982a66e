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

"""Files of the page, read into memory at the start."""

from __future__ import annotations

from dataclasses import dataclass
import hashlib
from importlib.resources import files

#: Page of the viewer, page of a calibration, and the page that asks for the token.
INDEX, CALIBRATE, TOKEN_FORM = 'index.html', 'calibrate.html', 'token.html'
#: Page of the nodes and topics.
GRAPH = 'graph.html'

_TYPES = {'.css': 'text/css', '.html': 'text/html', '.js': 'text/javascript',
          '.svg': 'image/svg+xml'}


@dataclass(frozen=True)
class PageFile:
    """
    A file of the page.

    :param content_type: value of the header ``Content-Type``.
    :param tag: value of the header ``ETag``.
    """

    content: bytes
    content_type: str
    tag: str


def read_page() -> dict[str, PageFile]:
    """Return the files of the page by name; no other file is ever served."""
    page = {}
    for file in files('opencv_tools.viewer').joinpath('page').iterdir():
        suffix = file.name[file.name.rfind('.'):]
        if suffix in _TYPES:
            content = file.read_bytes()
            page[file.name] = PageFile(content, f'{_TYPES[suffix]}; charset=utf-8',
                                       f'"{hashlib.sha256(content).hexdigest()[:16]}"')
    return page
