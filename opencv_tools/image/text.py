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

"""Texts that others wrote, as they may be printed: messages, files, names on the graph, URLs."""

from __future__ import annotations

import re

_MAX_TEXT = 200
#: As long as a path may be.
MAX_PATH = 4096
_MORE = '...'
_PASSWORD = re.compile(r'(://[^/?#@:\s]*):[^/?#\s]*@')
_SECRET = re.compile(r'(?i)([?&](?:pass|passwd|password|pwd|secret|token|key|api_?key)=)[^&#\s]+')
_HIDDEN = '***'


def printable(text: object, longest: int = _MAX_TEXT) -> str:
    """
    Return a text that says on a console what it says, and does nothing else there.

    :param text: what somebody else wrote.
    :param longest: characters of the result; a longer one ends in ``...``.
    :returns: the same where it is printable and not too long. Control characters, line ends,
        characters that turn the direction of writing and lone surrogates stand there as ``repr``
        writes them.
    """
    whole = str(text)
    shown = whole[:longest + 1]
    if not shown.isprintable():
        shown = ''.join(
            letter if letter.isprintable() else repr(letter)[1:-1] for letter in shown)
    return shown if len(shown) <= longest else shown[:max(0, longest - len(_MORE))] + _MORE


def without_password(url: str) -> str:
    """
    Return a URL as it may be printed.

    :param url: a URL, or any other text.
    :returns: the same, printable, with ``***`` for the password before the host and for the
        values of such fields as ``?password=``.
    """
    return printable(_SECRET.sub(rf'\1{_HIDDEN}', _PASSWORD.sub(rf'\1:{_HIDDEN}@', url)), MAX_PATH)
