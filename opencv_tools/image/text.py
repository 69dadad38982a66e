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

"""Safe printing of texts from messages, files, the ROS graph and URLs."""

from __future__ import annotations

from collections.abc import Sequence
import re

_MAX_TEXT = 200
#: Longest path of Linux in bytes (PATH_MAX).
MAX_PATH = 4096
_MORE = '...'
# A password may have any character, also an unencoded / or #, so all up to the last @ is secret.
# Without an @, what stands where a number of a port belongs may be a part of a password.
_USER = re.compile(
    r'://(?:.*@|[^/?#\s\[:\'"]*:(?!\d+(?:[/?#\s\'":;,.)]|$))\S*)', re.DOTALL)
_SECRET = re.compile(
    r'(?i)((?<![a-z0-9])(?:pass(?:word|wd|phrase)?|pwd?|secret|token|auth|credentials?|'
    r'sig(?:nature)?|(?:api|access|auth|private)?[-_]?key)=)[^&;\s]+')
#: Text that stands for a secret.
HIDDEN = '***'


def printable(text: object, longest: int = _MAX_TEXT) -> str:
    """
    Return a text in which a console cannot interpret control characters.

    :param text: text of unknown origin.
    :param longest: largest number of characters of the result; a longer text ends in ``...``.
    :returns: the text, with line ends, control characters, characters that change the writing
        direction and lone surrogates escaped as by ``repr``.
    """
    whole = str(text)
    shown = whole[:longest + 1]
    if not shown.isprintable():
        shown = ''.join(
            letter if letter.isprintable() else repr(letter)[1:-1] for letter in shown)
    return shown if len(shown) <= longest else shown[:max(0, longest - len(_MORE))] + _MORE


def enumerated(texts: Sequence[str], most: int = 5, further: int = 0) -> str:
    """
    Return a list of the first few texts, and the number of the others.

    :param texts: printable texts.
    :param most: largest number of texts that are named.
    :param further: number of others that are not among the texts.
    """
    others = max(0, len(texts) - most) + further
    return ', '.join(texts[:most]) + (f' and {others} more' if others else '')


def _hide(user: re.Match[str]) -> str:
    return f'://{HIDDEN}{"@" * user[0].endswith("@")}'


def without_secrets(text: str) -> str:
    """
    Return a text without the secrets of a URL in it.

    :param text: URL, or a text that has one.
    :returns: the text, with ``***`` for all between ``://`` and the last ``@``, and for the values
        of keys such as ``password=`` in a path or query.
    """
    return _SECRET.sub(rf'\1{HIDDEN}', _USER.sub(_hide, text))


def without_password(url: str) -> str:
    """Return a printable text without the secrets of a URL in it, for messages."""
    return printable(without_secrets(url), MAX_PATH)
