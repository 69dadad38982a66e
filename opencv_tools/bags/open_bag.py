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

"""Opening of the files of a bag."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from opencv_tools.bags.db3_reader import Db3Reader
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.mcap_reader import McapReader
from opencv_tools.bags.metadata import read_file_names
from opencv_tools.bags.reading import BagReader
from opencv_tools.image.text import MAX_PATH, printable
from opencv_tools.remedies import installation

#: Extensions of bags.
BAG_SUFFIXES = ('.mcap', '.db3')
_METADATA = 'metadata.yaml'
_ROS1_SUFFIX = '.bag'


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag: a file by its extension, or a folder of rosbag2."""
    if path.suffix.lower() in (*BAG_SUFFIXES, _ROS1_SUFFIX):
        return not path.is_dir()
    return (path / _METADATA).is_file()


@dataclass(frozen=True)
class BagFiles:
    """
    The files of a bag.

    :param paths: paths of the files.
    :param are_ordered: whether ``metadata.yaml`` has this order; otherwise the names have it.
    :param warning: why the metadata are not used, or which files they do not name; '' for neither.
    """

    paths: list[Path]
    are_ordered: bool = False
    warning: str = ''


def bag_files(path: Path) -> BagFiles:
    """
    Return the files of a bag.

    :param path: path of a file, or of a folder with ``metadata.yaml``.
    :returns: the file itself, or the bags in the folder.
    :raises BagError: there is no file that can be read.
    :raises OSError: the folder cannot be read.
    """
    shown = printable(path, MAX_PATH)
    if path.suffix.lower() == _ROS1_SUFFIX:
        raise BagError(f"{shown} is a bag of ROS 1; convert it with 'rosbags-convert --src "
                       f"{shown} --dst FOLDER' of rosbags; {installation('rosbags')}")
    if not path.is_dir():
        return BagFiles([path])
    files = [file for file in path.iterdir()
             if file.suffix.lower() in BAG_SUFFIXES and not file.name.startswith('.')]
    if not files:
        packed = next(path.glob('*.zstd'), None)
        raise BagError(
            f"{printable(packed, MAX_PATH)} is compressed; unpack it with 'unzstd'" if packed
            else f'{shown} has no file with the extension {" or ".join(BAG_SUFFIXES)}')
    return _in_order(path / _METADATA, {file.name: file for file in files})


def _in_order(metadata: Path, files: dict[str, Path]) -> BagFiles:
    """Return files by name in the order of the metadata, if these can be used."""
    try:
        names = [name.removesuffix('.zstd') for name in read_file_names(metadata)]
        for name, count in Counter(names).items():
            if name not in files or count > 1:
                raise BagError(f'it names {printable(name)} ' + (
                    f'{count} times' if name in files else 'which is not in the folder'))
        if not names:
            raise BagError('it names no files')
    except (BagError, OSError) as err:
        reason = err.strerror if isinstance(err, OSError) else err
        return BagFiles([*files.values()], warning=(
            f'{printable(metadata, MAX_PATH)} is not used: {reason}; the files are read in the '
            'order of their names'))
    others = sorted(files.keys() - set(names))
    return BagFiles([files[name] for name in names], True, (
        f'{printable(metadata, MAX_PATH)} does not name {len(others)} files of its folder, which '
        f'are not read, such as {printable(others[0])}') if others else '')


def open_bag_file(path: Path) -> BagReader:
    """
    Open a file of a bag.

    :raises BagError: the file cannot be read as a bag.
    :raises OSError: the file cannot be read.
    """
    return Db3Reader(path) if path.suffix.lower() == '.db3' else McapReader(path)
