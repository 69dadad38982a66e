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

"""The page as one HTML file that needs no server and no network."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator
import gzip
import hashlib
from html import escape
from importlib.resources import files
import re

from opencv_tools.robot.view.content import Content, to_json
from opencv_tools.robot.view.mesh_files import NoMeshError

#: Modules of the page, each after those that it imports.
MODULES = ('motion.js', 'shapes.js', 'robot.js', 'stage.js', 'panel.js', 'live.js', 'view.js')
INDEX, STYLE, LIBRARY = 'index.html', 'view.css', 'three.js'
_TYPES = {'.css': 'text/css', '.html': 'text/html', '.js': 'text/javascript'}
_IMPORT = re.compile(r"^import \{[^}]*\} from '\./[a-z]+\.js';\n", re.MULTILINE)
_PACKED = ('mesh', 'material')  # roles of files that are not compressed yet
_EXPORT = re.compile(r'^export ', re.MULTILINE)
_LINES = re.compile(r'^<(?:link|script).*?>(?:</script>)?\n', re.MULTILINE)


def read_page() -> dict[str, tuple[bytes, str]]:
    """Return the files of the page by name, each with its type; no other file is ever served."""
    page = {}
    for file in files('opencv_tools.robot.view').joinpath('page').iterdir():
        kind = _TYPES.get(file.name[file.name.rfind('.'):])
        if kind:
            page[file.name] = file.read_bytes(), f'{kind}; charset=utf-8'
    return page


def page_policy(*, own: str = '', scripts: str = '', style: str = '', sockets: str = '',
                forms: str = "'none'") -> str:
    """
    Return the Content-Security-Policy of the page, without ``frame-ancestors``.

    :param own: ``'self'`` if a server has the files of the page, else ''.
    :param scripts: other scripts than own ones.
    :param style: other style than the own one.
    """
    return (f"default-src 'none'; script-src {own}{scripts}; style-src {own}{style}; "
            f'img-src {own} data: blob:; connect-src {own} data: blob:{sockets}; '
            f"base-uri 'none'; form-action {forms}")


def html_page(content: Content) -> Iterator[bytes]:
    """
    Return the page with its scripts, its style, the robots and their meshes, in parts.

    A policy in the page allows only these scripts, by their hashes, and no request. The robots are
    JSON, which a browser never runs.
    """
    page = {name: data.decode() for name, (data, _) in read_page().items()}
    library = _script(page[LIBRARY])
    modules = _script('\n'.join(
        _EXPORT.sub('', _IMPORT.sub('', page[name])) for name in MODULES))
    style = page[STYLE]
    policy = page_policy(scripts=f'{_hash(library)} {_hash(modules)}', style=_hash(style))
    names = ', '.join(robot['name'] for robot in content.document['robots'])
    shell = _LINES.sub('', page[INDEX])
    shell = re.sub('<title>.*?</title>', lambda _: f'<title>{escape(names)}</title>', shell)
    head, end, body = shell.partition('</head>')
    yield (f'{head}<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">\n'
           f'<style>{style}</style>\n<script id="robot" type="application/json">').encode()
    yield from _document(content)
    yield (f'</script>\n<script>{library}</script>\n<script type="module">{modules}</script>\n'
           f'{end}{body}').encode()


def _document(content: Content) -> Iterator[bytes]:
    """Return the document with the content of each mesh, or the reason why it is not shown."""
    rest = {name: value for name, value in content.document.items() if name != 'meshes'}
    yield f'{to_json(rest)[:-1]},"meshes":['.encode()
    for number, mesh in enumerate(content.document['meshes']):
        yield b',' * (number > 0)
        try:
            data = content.meshes.read(number)
        except NoMeshError as err:
            yield to_json({**mesh, 'reason': str(err)}).encode()
            continue
        is_packed = mesh['role'] in _PACKED
        yield f'{to_json({**mesh, "packed": is_packed})[:-1]},"data":"'.encode()
        yield b64encode(gzip.compress(data, mtime=0) if is_packed else data)
        yield b'"}'
    yield b']}'


def _script(text: str) -> str:
    """Return a script that may be inside of an element of HTML."""
    return re.sub('<(?=/script|!--|script)', r'\\x3c', text, flags=re.IGNORECASE)


def _hash(text: str) -> str:
    return f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
