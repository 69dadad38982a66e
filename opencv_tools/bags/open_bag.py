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

from pathlib import Path

from opencv_tools.bags.db3_reader import Db3Reader
from opencv_tools.bags.errors import BagError
from opencv_tools.bags.mcap_reader import McapReader
from opencv_tools.bags.reading import BagReader
from opencv_tools.image.text import MAX_PATH, printable

#: Extensions of bags.
BAG_SUFFIXES = ('.mcap', '.db3')
_METADATA = 'metadata.yaml'
_ROS1_SUFFIX = '.bag'


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag: a file by its extension, or a folder of rosbag2."""
    if path.suffix.lower() in (*BAG_SUFFIXES, _ROS1_SUFFIX):
        return not path.is_dir()
    return (path / _METADATA).is_file()


def bag_files(path: Path) -> list[Path]:
    """
    Return the files of a bag.

    :param path: path of a file, or of a folder with ``metadata.yaml``.
    :returns: the file itself, or all bags in the folder.
    :raises BagError: there is no file that can be read.
    :raises OSError: the folder cannot be read.
    """
    shown = printable(path, MAX_PATH)
    if path.suffix.lower() == _ROS1_SUFFIX:
        raise BagError(f"{shown} is a bag of ROS 1; convert it with 'rosbags-convert --src "
                       f"{shown} --dst FOLDER', which 'pip install rosbags' installs")
    if not path.is_dir():
        return [path]
    files = [file for file in path.iterdir()
             if file.suffix.lower() in BAG_SUFFIXES and not file.name.startswith('.')]
    if not files:
        packed = next(path.glob('*.zstd'), None)
        raise BagError(
            f"{printable(packed, MAX_PATH)} is compressed; unpack it with 'unzstd'" if packed
            else f'{shown} has no file with the extension {" or ".join(BAG_SUFFIXES)}')
    return files


def open_bag_file(path: Path) -> BagReader:
    """
    Open a file of a bag.

    :param path: path of the file.
    :returns: a reader of its messages.
    :raises BagError: the file cannot be read as a bag.
    :raises OSError: the file cannot be read.
    """
    return Db3Reader(path) if path.suffix.lower() == '.db3' else McapReader(path)
