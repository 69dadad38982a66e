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

"""Command lines: the version of the package, errors, and numbers in arguments."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
import math
import sys
from typing import Any, NoReturn

from opencv_tools.base.standard_streams import discard_broken_streams, open_standard_streams
from opencv_tools.base.text import without_password


def package_version() -> str:
    """Return the version of the installed package; ``unknown`` if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version  # slow
    try:
        return version('opencv_tools')
    except PackageNotFoundError:  # used from its source
        return 'unknown'


class CommandParser(argparse.ArgumentParser):
    """A command line with the option ``--version``, whose errors quote no password."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.add_argument('--version', action=_PrintVersion, nargs=0, dest=argparse.SUPPRESS,
                          help='show the version and exit')

    def error(self, message: str) -> NoReturn:
        """Print the usage and an error, and exit with status 2."""
        super().error(without_password(message))


class _PrintVersion(argparse.Action):
    """Look up the version only if it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        print(f'{parser.prog} {package_version()}')
        parser.exit()


INTERRUPTED = 1
_USAGE_ERROR = 2


def run_command(
    name: str, run: Callable[[], int], interrupted: str = '',
    invalid: type[Exception] = ValueError,
) -> int:
    """
    Run a command whose arguments are parsed, and return its exit status.

    :param run: returns the status, unless an argument is invalid.
    :param interrupted: text after the name of the command on standard error when a second signal
        ends the command, so that pending work is not finished; '' for none.
    :param invalid: exception of ``run`` for an invalid argument, which is printed before status 2.
    """
    open_standard_streams()
    try:
        return run()
    except invalid as err:
        print(f'{name}: error: {without_password(str(err))}', file=sys.stderr)
        return _USAGE_ERROR
    except KeyboardInterrupt:
        if interrupted:
            print(f'{name}: {interrupted}', file=sys.stderr)
        return INTERRUPTED
    finally:
        discard_broken_streams()


def integer(text: str, least: int = 0, most: int | None = None) -> int:
    """
    Return an argument as an integer, for `argparse`.

    :param most: None for any number of at most 9 digits.
    :raises argparse.ArgumentTypeError: it is none from ``least`` to ``most``.
    """
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) >= least) or (
            most is not None and int(text) > most):
        wanted = f'of {least} or more' if most is None else f'from {least} to {most}'
        raise argparse.ArgumentTypeError(f'{text!r} is not an integer {wanted}')
    return int(text)


positive = partial(integer, least=1)


def with_range(words: Sequence[str], option: str) -> list[str]:
    """Return arguments in which a range may begin with -, which argparse takes for an option."""
    joined = [*words]
    if option in joined[:-1]:
        at = joined.index(option)
        joined[at:at + 2] = ['='.join(joined[at:at + 2])]
    return joined


def number_range(text: str) -> tuple[float, float]:
    """
    Return an argument ``LOW:HIGH`` as two numbers, for `argparse`.

    :raises argparse.ArgumentTypeError: it has another form, or the first number is not smaller.
    """
    try:
        low, high = map(float, text.split(':'))
        check_range(low, high, 'LOW', 'HIGH')
    except ValueError as err:
        raise argparse.ArgumentTypeError(
            f'{text!r} is not LOW:HIGH, two numbers with the smaller one first') from err
    return low, high


def check_range(low: float, high: float, name: str, other: str) -> None:
    """
    Check the limits of numbers.

    :raises ValueError: they are not finite, or the first one is not smaller.
    """
    if not -math.inf < low < high < math.inf:
        raise ValueError(f'{name} is {low:g}, which is not below {other} {high:g}: give a smaller '
                         f'{name}')


#: Colours of numbers such as depth: gray, or a colormap of OpenCV.
COLORS = ('gray', 'turbo', 'jet', 'viridis', 'cividis', 'magma', 'inferno', 'plasma')


def real(text: str) -> float:
    """Return an argument as a number; not a number, which no comparison accepts, for a text."""
    try:
        return float(text)
    except ValueError:
        return math.nan
