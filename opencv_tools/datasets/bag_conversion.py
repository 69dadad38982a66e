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
Conversion of one bag to a part of a data set.

``convert_bag`` depends only on its arguments, so bags can be converted in any order on any
machine. ``merge`` joins the parts.
"""

from __future__ import annotations

from dataclasses import asdict
import json
import os
from pathlib import Path
import shutil
from typing import Any

from opencv_tools.datasets.episodes import episodes_of
from opencv_tools.datasets.lerobot_rows import write_rows
from opencv_tools.datasets.part import bag_state, is_done, PART
from opencv_tools.datasets.plan import LEROBOT, Plan
from opencv_tools.datasets.rows import match
from opencv_tools.datasets.sample_files import write_samples
from opencv_tools.datasets.tracks import open_bag, read_recording


def convert_bag(path: str, plan: Plan, folder: str, name: str, threads: int = 1) -> None:
    """
    Convert a bag to a part.

    :param path: path of the bag.
    :param plan: plan with the names of all numbers.
    :param folder: folder of the part, which does not exist; it is complete when it appears.
    :param name: name of the bag in the data set.
    :param threads: threads for decoding and encoding.
    :raises DatasetError: the bag cannot be converted by the plan.
    :raises OSError: a file cannot be read or written.
    """
    target, state = Path(folder), bag_state(Path(path))
    if is_done(target, plan, state):
        return
    recording = read_recording(open_bag(Path(path)), plan)
    episodes = episodes_of(recording, plan, name)
    target.parent.mkdir(parents=True, exist_ok=True)
    work = target.with_name(f'.{target.name}.{os.urandom(6).hex()}')
    work.mkdir()
    try:
        described, kept = (
            write_rows(plan, recording, episodes, work, threads) if plan.format == LEROBOT else
            write_samples(plan, recording, episodes, work, name))
        text = json.dumps({
            'bag': name, 'state': state, 'plan': plan.digest, 'fps': plan.fps,
            'robot_type': plan.robot_type, 'format': plan.format, 'warnings': recording.warnings,
            'topics': {key: asdict(match(track.times, kept, key))
                       for key, track in recording.tracks.items()}, **described})
        (work / PART).write_text(text)
        _publish(work, target, plan, state)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _publish(work: Path, target: Path, plan: Plan, state: list[list[Any]]) -> None:
    """Rename a complete part; another process may have written the same one meanwhile."""
    try:
        if target.is_dir() and not is_done(target, plan, state):
            shutil.rmtree(target)  # of another plan, or of a bag that has changed
        work.rename(target)
    except OSError:
        if not is_done(target, plan, state):
            raise
