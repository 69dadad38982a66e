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

"""Many rows of one rule in one test: a test of its own for each row costs more than its check."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
import inspect
import traceback

import pytest


def failures(check: Callable[..., object], rows: Iterable[tuple[object, ...]]) -> list[str]:
    """
    Check each row, and return the rows that fail, each with its line and its reason.

    :param check: a function with assertions, which takes a row as its arguments.
    """
    failed = []
    rows = list(rows)
    assert rows
    for row in rows:
        try:
            check(*row)
        except (Exception, pytest.fail.Exception) as err:
            line = traceback.extract_tb(err.__traceback__)[-1].lineno
            failed.append(f'{row}: line {line}: {type(err).__name__}: {err}')
    return failed


def each_row(names: str | tuple[str, ...], rows: Iterable[object]
             ) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """
    Return a decorator like ``pytest.mark.parametrize``, but of one test that checks all rows.

    The rows share the fixtures of the test, so none of them may leave anything behind in these.
    """
    def decorated(check: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(check)
        columns = (names,) if isinstance(names, str) else names
        kept = [(row,) if isinstance(names, str) else row for row in rows]

        def test(**fixtures: object) -> None:
            by_name = partial(_by_name, partial(check, **fixtures), columns)
            assert failures(by_name, kept) == []

        test.__name__, test.__doc__, test.__module__ = (
            check.__name__, check.__doc__, check.__module__)
        test.__signature__ = signature.replace(parameters=[  # type: ignore[attr-defined]
            one for name, one in signature.parameters.items() if name not in columns])
        return test

    return decorated


def _by_name(check: Callable[..., None], columns: tuple[str, ...], *row: object) -> None:
    check(**dict(zip(columns, row, strict=True)))
