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

"""What would become of each topic of a bag, without decoding a picture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from opencv_tools.datasets.episodes import episodes_of
from opencv_tools.datasets.plan import ACTION, IMAGES, Plan
from opencv_tools.datasets.report import topic_lines
from opencv_tools.datasets.row_values import shortened
from opencv_tools.datasets.rows import match
from opencv_tools.datasets.tracks import open_bag, read_recording
from opencv_tools.image.text import printable


def describe_bag(path: Path, name: str, plan: Plan) -> Iterator[str]:
    """
    Yield lines about a bag.

    :param plan: plan with the names of all numbers.
    :raises DatasetError: the bag cannot be converted by the plan.
    """
    bag = open_bag(path)
    recording = read_recording(bag, plan)
    episodes = episodes_of(recording, plan, name)
    uses: dict[str, list[str]] = {}
    for camera, topic in plan.images:
        uses.setdefault(topic, []).append(IMAGES + camera)
    for key, sources in plan.vectors:
        for source in sources:
            names = ', '.join(source.names)
            uses.setdefault(source.topic, []).append(f'{key} ({printable(names)})')
    if plan.episodes:
        uses.setdefault(plan.episodes.topic, []).append('begin and end of episodes')
    kept = shortened(plan, episodes)
    rows = [len(one.times) for one in kept]
    yield f'{printable(name)}: {sum(rows)} rows in {len(rows)} episodes'
    for found, count in sorted(bag.topics.items(), key=lambda pair: pair[0].name):
        use = ' and '.join(uses.get(found.name, ['not used']))
        yield f'  {printable(found.name)} ({printable(found.type_name)}, {count}): {use}'
    if plan.next_action:
        yield f'  {ACTION}: the state of the next row'
    described = {'topics': {key: asdict(match(track.times, kept, key))
                            for key, track in recording.tracks.items()}}
    for line in [*topic_lines([described]), *(f'warning: {one}' for one in recording.warnings)]:
        yield f'  {line}'
