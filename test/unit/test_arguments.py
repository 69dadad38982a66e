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

"""Numbers in the arguments of all commands."""

from __future__ import annotations

from argparse import ArgumentTypeError

from opencv_tools.base.arguments import integer, INTERRUPTED, positive, real, run_command
import pytest


def test_integers_between_limits() -> None:
    assert [integer(text) for text in ('0', '007', '999999999')] == [0, 7, 999_999_999]
    assert [integer(text, 2, 4) for text in '234'] == [2, 3, 4]
    assert positive('1') == 1


def test_numbers() -> None:
    assert [real(text) for text in ('1', '-2.5', '1e3')] == [1, -2.5, 1000]
    assert not real('inf') < 1e9
    assert not real('x') <= 0 and not real('') >= 0


@pytest.mark.parametrize(('raised', 'interrupted', 'status', 'error'), [
    (ValueError('--a is rtsp://me:secret@h'), '', 2, 'cmd: error: --a is rtsp://***@h\n'),
    (KeyboardInterrupt(), 'ended', INTERRUPTED, 'cmd: ended\n'),
    (KeyboardInterrupt(), '', INTERRUPTED, '')])
def test_errors_of_commands(
        raised: BaseException, interrupted: str, status: int, error: str,
        capsys: pytest.CaptureFixture[str]) -> None:
    def run() -> int:
        raise raised

    assert run_command('cmd', run, interrupted) == status
    assert capsys.readouterr().err == error
    assert run_command('cmd', lambda: 7) == 7


def test_other_errors_of_commands_are_raised() -> None:
    with pytest.raises(ValueError, match='invalid literal'):
        run_command('cmd', lambda: int('x'), invalid=KeyError)


@pytest.mark.parametrize('text', [
    '', '-1', '+1', ' 1', '1 ', '1.0', '1e3', '1_000', '\u00b2', '\u0663', '9' * 5000])
def test_what_is_no_integer(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match=r'is not an integer of 0 or more$'):
        integer(text)


@pytest.mark.parametrize(('text', 'least', 'most', 'wanted'), [
    ('0', 1, None, 'of 1 or more'), ('1', 2, 4, 'from 2 to 4'), ('5', 2, 4, 'from 2 to 4')])
def test_integers_beyond_limits(text: str, least: int, most: int | None, wanted: str) -> None:
    with pytest.raises(ArgumentTypeError) as refused:
        integer(text, least, most)
    assert str(refused.value) == f"'{text}' is not an integer {wanted}"
