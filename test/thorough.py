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
Run the thorough groups side by side: python thorough.py GROUP...

A group is a target of the Makefile. The tests of a group that fail run once more, alone, after all
groups have ended. One that passes then is unsteady: it is added to test/unsteady.md and printed
with its output. The status is 1 if a test failed twice, if more than three tests were unsteady, or
if an unsteady one is in test/unsteady.md already.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
import datetime
import os
from pathlib import Path
import re
import subprocess
import sys
import time

ROOT = Path(__file__).parents[1]
PAGE = ROOT / 'test' / 'unsteady.md'
LOGS = ROOT / 'build' / 'thorough'
AT_ONCE = 2  # with three, tests in a browser waited for pictures for minutes
_WORKERS = '4'  # of a group, as others run beside it
MOST_UNSTEADY = 3
_FAILED = re.compile(
    r'^(?:FAILED|ERROR) (test/\S+?\.py(?:::\w+)*(?:\[.*?\])?)(?: - .*)?$', re.MULTILINE)


def run(group: str, only: Sequence[str] = (), is_alone: bool = False) -> tuple[int, str]:
    """
    Run a group.

    :param only: tests to run; all if it is empty.
    :param is_alone: whether this is the second run, with one worker.
    :returns: exit status and output.
    """
    LOGS.mkdir(parents=True, exist_ok=True)
    environment = {'WORKERS': _WORKERS, **os.environ}
    if is_alone:
        environment['WORKERS'] = '1'
    if only:
        names = LOGS / f'{group}.only'
        names.write_text('\n'.join(only))
        environment['OPENCV_TOOLS_ONLY'] = str(names)
    began = time.monotonic()
    path = LOGS / f'{group}{".again" if is_alone else ""}.log'
    with path.open('w') as log:
        status = subprocess.run(
            ['make', '--no-print-directory', group], cwd=ROOT, env=environment,
            stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, check=False).returncode
    print(f'{group}{" again" if is_alone else ""}: status {status} after '
          f'{time.monotonic() - began:.0f} s', flush=True)
    return status, path.read_text(errors='replace')


def failed_tests(output: str) -> list[str]:
    """Return the failed tests by the summary that pytest prints."""
    return list(dict.fromkeys(_FAILED.findall(output)))


def rows(names: Sequence[str], date: str) -> str:
    """Return rows of test/unsteady.md."""
    return ''.join(f'| {date} | `{name}` |\n' for name in names)


def verdict(unsteady: Sequence[str], page: str) -> str:
    """Return why unsteady tests are an error; '' if they are not."""
    known = [name for name in unsteady if f'`{name}`' in page]
    if known:
        return f'unsteady before already, see test/unsteady.md: {", ".join(known)}'
    if len(unsteady) > MOST_UNSTEADY:
        return f'{len(unsteady)} tests were unsteady; at most {MOST_UNSTEADY} may be'
    return ''


def main() -> int:
    """Return 0 if each test passed, at the latest when it ran alone."""
    groups = sys.argv[1:]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        results = dict(zip(groups, pool.map(run, groups), strict=True))
    unsteady: list[str] = []
    failed: list[str] = []
    for group, (status, output) in results.items():
        print(f'\n=== {group}\n{output}' if status else '', end='', flush=True)
        if status:
            names = failed_tests(output)
            again, text = run(group, names, is_alone=True)  # all, if it ended without a summary
            if again:
                print(f'\n=== {group} again\n{text}')
            still = (failed_tests(text) or names or [group]) if again else []
            failed += still
            unsteady += [name for name in names or [group] if name not in still]
    page = PAGE.read_text()
    reason = verdict(unsteady, page)
    date = datetime.datetime.now(datetime.timezone.utc).date().isoformat()
    PAGE.write_text(page + rows(unsteady, date))
    for name in unsteady:
        print(f'UNSTEADY {date} {name}: failed beside other tests, passed alone')
    for name in failed:
        print(f'FAILED twice: {name}')
    if reason:
        print(reason)
    print(f'{len(groups)} groups: {len(failed)} failed, {len(unsteady)} unsteady')
    return 1 if failed or reason else 0


if __name__ == '__main__':
    sys.exit(main())
