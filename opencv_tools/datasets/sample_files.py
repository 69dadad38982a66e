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
Data sets of single samples: WebDataset (tar) and Parquet, one file a bag.

A picture that is a JPEG in the bag is stored as it is. Depth is a PNG of 16 bits in millimetres.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, ExitStack
import io
import json
from pathlib import Path
import shutil
import tarfile
from typing import Any

import numpy as np
from opencv_tools.base.text import MAX_PATH, printable
from opencv_tools.datasets.depth import codes_of, DepthImages
from opencv_tools.datasets.folders import bag_digest
from opencv_tools.datasets.lerobot import import_pyarrow, plan_features
from opencv_tools.datasets.pictures import depth_png, row_pictures
from opencv_tools.datasets.plan import IMAGES, Plan, WEBDATASET
from opencv_tools.datasets.row_values import row_vectors, shortened, shown_rows
from opencv_tools.datasets.rows import Rows
from opencv_tools.datasets.tracks import Recording

#: Name of the file in a part, by format.
SAMPLES = {'webdataset': 'samples.tar', 'parquet': 'samples.parquet'}
#: What a set has beside the samples: the bags and their reports.
BAGS = 'bags.json'
_PREFIX = 10  # characters of the bag in a key; a name in a tar archive has at most 100
_GROUP_ROWS = 100  # of a row group, because a row has pictures


def write_samples(plan: Plan, recording: Recording, episodes: Sequence[Rows],
                  folder: Path, name: str) -> tuple[dict[str, Any], list[Rows]]:
    """
    Write the samples of a bag.

    :param episodes: all rows; with ``next_action`` the last one of each is left out.
    :param folder: folder of the part.
    :returns: what part.json says of the samples, and the rows with the pictures that they have.
    :raises DatasetError: a picture or a number cannot be used.
    :raises OSError: the file cannot be written.
    """
    path = folder / SAMPLES[plan.format]
    shown: dict[str, list[int]] = {camera: [] for camera, _ in plan.images}
    depth = {camera: DepthImages(camera, codes_of(plan)) for camera in plan.depth}
    samples = _samples(plan, recording, episodes, name, shown, depth)
    write = _write_tar if plan.format == WEBDATASET else _write_parquet
    write(path, samples)
    kept = shown_rows(shortened(plan, episodes), {
        camera: np.array(one) for camera, one in shown.items()}, recording.warnings)
    described = [{'length': len(rows.times), 'task': rows.task or plan.task} for rows in kept]
    recording.warnings.extend(text for one in depth.values() for text in one.warnings)
    return {'features': plan_features(plan, {}), 'episodes': described,
            'depth': {camera: one.account for camera, one in depth.items()}}, kept


def _samples(plan: Plan, recording: Recording, episodes: Sequence[Rows], name: str,
             shown: dict[str, list[int]], depth: dict[str, DepthImages],
             ) -> Iterator[tuple[str, dict[str, Any], dict[str, bytes]]]:
    """
    Yield the key of each sample, its numbers and texts, and the file of each camera by its name.

    The numbers of the samples that cameras show are added to ``shown``, pixels to ``depth``.
    """
    prefix = bag_digest(name)[:_PREFIX]
    vectors = row_vectors(plan, recording, episodes)
    kept = shortened(plan, episodes)
    with ExitStack() as stack:
        cameras = {camera: stack.enter_context(closing(
            row_pictures(plan, recording, camera, kept))) for camera, _ in plan.images}
        for number, rows in enumerate(kept):
            for row in range(len(rows.times)):
                stamps = {one: int(track.times[rows.samples[one][row]])
                          for one, track in recording.tracks.items()}
                files = {}
                for camera, pictures in cameras.items():
                    sample, picture = next(pictures)
                    shown[camera].append(sample)
                    stamps[camera] = int(recording.tracks[camera].times[sample])
                    if camera in depth:
                        files[f'{camera}.png'] = depth_png(depth[camera].read(picture))
                    else:
                        files[f'{camera}.jpg'] = picture.compressed[0].tobytes()
                values = {key: values[number][row].tolist() for key, values in vectors.items()}
                yield f'{prefix}_{number:06d}_{row:06d}', {
                    'bag': printable(name, MAX_PATH), 'episode': number, 'frame': row,
                    'timestamp': row / plan.fps, 'task': rows.task or plan.task,
                    'stamp_ns': stamps, **values}, files


def _write_tar(path: Path, samples: Iterator[tuple[str, dict[str, Any], dict[str, bytes]]],
               ) -> None:
    with tarfile.open(path, 'w', format=tarfile.USTAR_FORMAT) as archive:
        for key, values, files in samples:
            for suffix, data in {**files, 'json': json.dumps(values).encode()}.items():
                member = tarfile.TarInfo(f'{key}.{suffix}')
                member.size = len(data)
                archive.addfile(member, io.BytesIO(data))


def _write_parquet(path: Path, samples: Iterator[tuple[str, dict[str, Any], dict[str, bytes]]],
                   ) -> None:
    pa = import_pyarrow()
    rows: list[dict[str, Any]] = []
    writer: Any = None
    try:
        for _, values, files in samples:
            stamps = {f'stamp_ns.{name}': one for name, one in values.pop('stamp_ns').items()}
            pictures = {IMAGES + Path(file).stem: data for file, data in files.items()}
            rows.append({**values, **stamps, **pictures})
            if len(rows) == _GROUP_ROWS:
                writer = _write_group(pa, path, writer, rows)
        if rows:
            writer = _write_group(pa, path, writer, rows)
    finally:
        if writer:
            writer.close()


def _write_group(pa: Any, path: Path, writer: Any, rows: list[dict[str, Any]]) -> Any:
    table = pa.Table.from_pylist(rows, schema=writer.schema if writer else None)
    writer = writer or pa.parquet.ParquetWriter(path, table.schema)
    writer.write_table(table)
    rows.clear()
    return writer


def gather_samples(parts: Sequence[Path], described: Sequence[dict[str, Any]], folder: Path,
                   ) -> None:
    """
    Write a set of the samples of parts: one file a bag, and what became of the bags.

    :param parts: folders of the parts.
    :param described: what their part.json says.
    :raises OSError: a file cannot be written.
    """
    for part, content in zip(parts, described):
        source = part / SAMPLES[content['format']]
        shutil.copyfile(source, folder / f'{part.name}{source.suffix}')
    (folder / BAGS).write_text(json.dumps([
        {name: value for name, value in part.items() if name != 'features'} for part in described
    ], indent=4))
