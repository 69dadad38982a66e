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
#: Text that stands for a secret.
HIDDEN = '***'
#: Ends of the names whose values are secrets in URLs: ``?access_token=``, ``/user=me_password=``.
SECRET_NAMES = ('password', 'passwd', 'passphrase', 'passcode', 'pass', 'pas', 'pwd', 'psw', 'pw',
                'pin', 'secret', 'token', 'key', 'auth', 'authorization', 'signature', 'sig',
                'credential', 'credentials')
# Each pattern leaves what is hidden already, so that a message may quote a shown URL.
# A value ends where the next name begins, because a password may have any character.
_VALUE = re.compile(
    rf'(?is)((?:{"|".join(SECRET_NAMES)})=)(?!\*\*\*(?:\W|$))(?:(?!&[\w.-]+=).)*')
# Files and packages have no user name.
# A slash may be missing in a misspelt URL.
_BEGIN = re.compile(
    r'(?i)(?<!\bfile)(?<!\bpackage)(?:://|(?<=[a-z]):/(?=[^/@]*:[^/]*@))(?!\*{3}@|@)')
_AT = re.compile(r'(?<!://\*{3})@')
_FIELDS = re.compile(r'://|[?&]')


def printable(text: object, longest: int = _MAX_TEXT) -> str:
    """
    Return a text in which a console cannot interpret control characters.

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

    :param most: largest number of texts that are named.
    :param further: number of others that are not among the texts.
    """
    others = max(0, len(texts) - most) + further
    return ', '.join(texts[:most]) + (f' and {others} more' if others else '')


def hide_passwords(text: str) -> str:
    """
    Return a text without the passwords of its URLs.

    :param text: URL, a sentence with URLs, or any other text.
    :returns: the text, with ``***`` for all that stands between the first ``://`` and the last
        ``@``, because a password may have any character, and for the values of names that end in
        one of ``SECRET_NAMES`` in paths and queries.
    """
    begin = _BEGIN.search(text)
    at = max((found.start() for found in _AT.finditer(text)), default=0)
    if begin and begin.end() < at:
        # The last @ may be in a value after the host, which is hidden to its own end.
        ends = [value.end() for value in _VALUE.finditer(text, begin.end())
                if value.start() <= at < value.end()]
        text = text[:begin.end()] + HIDDEN + text[max(ends, default=at):]
    fields = _FIELDS.search(text)
    begin_of_fields = fields.start() if fields else len(text)
    return text[:begin_of_fields] + _VALUE.sub(rf'\1{HIDDEN}', text[begin_of_fields:])


def without_password(text: str, longest: int = MAX_PATH) -> str:
    """
    Return a text for messages, without the passwords of its URLs.

    :param text: as for ``hide_passwords``.
    :param longest: largest number of characters of the result, as for ``printable``.
    :returns: the printable text.
    """
    return printable(hide_passwords(text), longest)
