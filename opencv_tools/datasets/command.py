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

"""What img_convert does for data sets: convert, check and merge."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from opencv_tools.datasets.checking import check_set
from opencv_tools.datasets.conversion import Conversion
from opencv_tools.datasets.errors import DatasetError, os_reason
from opencv_tools.datasets.options import plan_of
from opencv_tools.datasets.set_writing import merge_shards
from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.logs import ConsoleWriter, Log
from opencv_tools.regular_files import user_path

_EXIT_OK, _EXIT_FAILURE = 0, 1


def run(options: Namespace) -> int:
    """
    Do what the options say.

    :returns: the exit status.
    :raises DatasetError: an option is invalid.
    """
    log = Log(ConsoleWriter('img_convert'))
    paths = [user_path(path).absolute() for path in options.paths]
    if paths and paths[-1].name in ('', '..'):
        raise DatasetError(f'{printable(paths[-1], MAX_PATH)} has no name; give a folder by its '
                           'name')
    try:
        if options.check:
            _check_count(paths, 1, 1, 'img_convert --check SET')
            return _EXIT_OK if check_set(paths[0], log) else _EXIT_FAILURE
        if options.merge:
            _check_count(paths, 2, 1 << 30, 'img_convert --merge SHARD [SHARD ...] SET')
            is_written = merge_shards(paths[:-1], paths[-1], overwrite=options.overwrite,
                                      skip_failed=options.skip_failed, log=log)
            return _EXIT_OK if is_written else _EXIT_FAILURE
        _check_count(paths, 2, 2, 'img_convert SOURCE TARGET --format FORMAT')
        return Conversion(options, plan_of(options), paths[1], log).run()
    except OSError as err:
        log.error(os_reason(err))
        return _EXIT_FAILURE


def _check_count(paths: Sequence[Path], least: int, most: int, usage: str) -> None:
    if not least <= len(paths) <= most:
        raise DatasetError(f'{len(paths)} paths are given; the usage is: {usage}')
