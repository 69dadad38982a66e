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

"""What ``--check`` says about a data set."""

from __future__ import annotations

from pathlib import Path

from opencv_tools.datasets.check import row_problems
from opencv_tools.datasets.check_videos import has_fingerprints, video_problems
from opencv_tools.datasets.errors import DatasetError
from opencv_tools.datasets.set_reader import SetReader
from opencv_tools.image.text import enumerated, MAX_PATH, printable
from opencv_tools.logs import Log

_MOST_PROBLEMS = 20


def check_set(folder: Path, log: Log) -> bool:
    """Log what is wrong with a data set, or what it has; return whether it is right."""
    problems: list[str] = []
    try:
        reader = SetReader(folder)
        episodes = reader.episodes()
        problems += row_problems(reader, episodes)
        problems += video_problems(reader, episodes)
    except DatasetError as err:
        problems.append(str(err))
    for problem in problems[:_MOST_PROBLEMS]:
        log.error(problem)
    if problems:
        log.error(f'{printable(folder, MAX_PATH)} has {len(problems)} errors')
        return False
    videos = enumerated([printable(key) for key in reader.video_keys]) or 'no videos'
    compared = 'compared with the bags' if has_fingerprints(reader) else (
        'not compared with their origin, which is unknown')
    pictures = f'; the pictures are {compared}' if reader.video_keys else ''
    log.info(f'{printable(folder, MAX_PATH)} is complete: {len(episodes)} episodes, '
             f'{episodes[-1]["dataset_to_index"]} rows, {videos}{pictures}')
    return True
