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
Repairs of the errors of XML that public robot descriptions have. Every element keeps its line.

===================================  =========================================================
error                                repair
===================================  =========================================================
text before the XML declaration      is removed
XML declaration of another version   has version 1.0
XML declaration without a version    has version 1.0
comment with ``--``                  is blanked
prefix without a declaration         is declared on the root element
===================================  =========================================================
"""

from __future__ import annotations

import re

# Replacements at the beginning of the document.
_DECLARATIONS = (
    (re.compile(rb'\A(<\?xml\s+version\s*=\s*["\'])[\d.]*'), rb'\g<1>1.0'),
    (re.compile(rb'\A<\?xml\s+(?!version)'), b'<?xml version="1.0" '),
)
_START = re.compile(rb'<\?xml[\s?]|<(sdf|robot)[\s>]')
_ROOT = re.compile(rb'<(sdf|robot)(?=[\s>])')
_DECLARED_PREFIX = re.compile(rb'xmlns:([\w.-]+)\s*=')
_USED_PREFIXES = (re.compile(rb'</?([A-Za-z_][\w.-]*):[\w.-]+'),
                  re.compile(rb'\s([A-Za-z_][\w.-]*):[\w.-]+\s*=\s*["\']'))
# A blank for each byte but line feeds.
_BLANKS = bytes(byte if byte == ord('\n') else ord(' ') for byte in range(256))


def repaired(data: bytes) -> bytes | None:
    """Return a document with the errors of the table repaired, or None if it has none of them."""
    start = _START.search(data)
    if start is None:
        return None
    document = data[start.start():]
    for pattern, replacement in _DECLARATIONS:
        document = pattern.sub(replacement, document, count=1)
    document = _without_dashes(document)
    used = {prefix for pattern in _USED_PREFIXES for prefix in pattern.findall(document)}
    prefixes = sorted(used - {*_DECLARED_PREFIX.findall(document), b'xmlns', b'xml'})
    if b'xacro' in prefixes:  # without the namespace of xacro, xacro does not expand the file
        return None
    # The lines of the text that is removed move into the tag of the root element.
    lines = b'\n' * data.count(b'\n', 0, start.start())
    namespaces = b''.join(b' xmlns:%b="urn:undeclared:%b"' % (prefix, prefix)
                          for prefix in prefixes)
    document = _ROOT.sub(lambda tag: tag[0] + lines + namespaces, document, count=1)
    return document if document != data else None


def _without_dashes(document: bytes) -> bytes:
    """Blank the comments that contain ``--``."""
    blanked = bytearray(document)
    start = document.find(b'<!--')
    while start >= 0:
        end = document.find(b'-->', start + 4)
        if end < 0:
            break
        if document.find(b'--', start + 4, end + 1) >= 0:
            blanked[start + 4:end] = document[start + 4:end].translate(_BLANKS)
        start = document.find(b'<!--', end + 3)
    return bytes(blanked)
