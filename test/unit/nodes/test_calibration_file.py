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

"""Calibration files in the format of camera_calibration_parsers."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from calibrations import ANY_MACHINE, CALIBRATION, camera_infos, NAMES, OPERATION
from hypothesis import given, settings
import numpy as np
from opencv_tools.nodes.publisher.calibration_file import (
    CameraInfoError, check_camera_name, read_camera_info, write_camera_info)
import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest
import yaml


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / 'camera.yaml'
    path.write_text(CALIBRATION)
    return path


def test_file_of_camera_calibration(file: Path) -> None:
    info = read_camera_info(file)
    assert info == CameraInfo(
        width=640, height=480, distortion_model='plumb_bob',
        d=[0.08712, -0.193355, 0.001127, -0.000805, 0.0],
        k=[602.31847, 0.0, 318.90521, 0.0, 603.07712, 243.11608, 0.0, 0.0, 1.0],
        r=[0.99984103, -0.00411876, 0.0173492, 0.00408522, 0.99998972, 0.00196837, -0.01735713,
           -0.00189718, 0.99984756],
        p=[588.41903, 0.0, 309.57274, -70.61028, 0.0, 588.41903, 241.80466, 0.0, 0.0, 0.0, 1.0,
           0.0])


def test_file_of_camera_calibration_parsers(file: Path) -> None:
    file.write_text(CALIBRATION.replace('0.001127', '1e-05') + OPERATION)
    info = read_camera_info(file)
    assert (info.d[2], info.binning_x, info.binning_y) == (1e-5, 2, 1)
    assert info.roi == RegionOfInterest(
        x_offset=10, y_offset=21, width=33, height=100, do_rectify=True)


@pytest.mark.parametrize(('old', 'new', 'reason'), [
    *((f'{key}:', f'x{key}:', f'{key}.* is missing: give ') for key in (
        'image_width', 'image_height', 'camera_matrix', 'projection_matrix',
        'distortion_coefficients', 'rectification_matrix')),
    ('640', '0', "image_width is '0': give a whole number from 1"),
    ('480', '-480', "image_height is '-480'"),
    ('480', '480.5', "image_height is '480.5'"),
    ('480', '4294967296', "image_height is '4294967296'"),
    ('480', '[480]', r"image_height is \['480'\]"),
    ('640', '0x', "image_width is '0x': give a whole number"),
    ('plumb_bob', '{}', 'distortion_model is {}: give a text'),
    ('plumb_bob', '$(touch x)', r"distortion_model is '\$\(touch x\)': give a text"),
    ('plumb_bob', 'x' * 65, "distortion_model is 'xxx"),
    ('cols: 4', 'cols: 3', "projection_matrix.cols is '3': give 4"),
    ('cols: 5', 'cols: 4', 'distortion_coefficients.data is .*: give a list of 4 finite'),
    ('cols: 5\n  data', 'cols: 5\n  date', 'distortion_coefficients.data is missing'),
    ('602.31847, ', '', 'camera_matrix.data is .*: give a list of 9 finite numbers'),
    ('602.31847', '.nan', 'camera_matrix.data is '),
    ('0.0173492', '.inf', 'rectification_matrix.data is '),
    ('0.0173492', '1e999', 'rectification_matrix.data is '),
    ('-70.61028', 'far', 'projection_matrix.data is '),
    ('-70.61028', '[1]', 'projection_matrix.data is '),
    ('binning_x: 2', 'binning_x: two', "binning_x is 'two'"),
    ('x_offset: 10', 'x_offset: 608', "roi.width is '33': give a whole number from 0 to 32"),
    ('y_offset: 21', 'y_offset: 381', "roi.height is '100': give .* from 0 to 99"),
    ('do_rectify: true', 'do_rectify: 2', "roi.do_rectify is '2': give true or false"),
    ('height: 100', 'tall: 100', 'roi.height is missing'),
    ('640', '[640', 'is not YAML in line 2: give the file'),
    ('640', '"\\UFFFFFFFF"', 'is not YAML: give the file'),
    (CALIBRATION + OPERATION, '', 'image_width is missing'),
    (CALIBRATION + OPERATION, '[' * 60_000, 'is not YAML'),
    (CALIBRATION + OPERATION, '[' * 70_000, 'cannot be read: camera.yaml is larger than 65536'),
])
def test_refused_files(file: Path, old: str, new: str, reason: str) -> None:
    file.write_text((CALIBRATION + OPERATION).replace(old, new, 1))
    with pytest.raises(CameraInfoError, match=f'camera.yaml:? {reason}') as caught:
        read_camera_info(file)
    assert len(str(caught.value)) < 400 + len(str(file))


@pytest.mark.parametrize(('name', 'reason'), [
    ('folder', 'Is a directory'), ('none.yaml', 'No such file'),
    ('camera.yaml/x', 'Not a directory'), ('a\0b', 'null byte'), ('x' * 300, 'name too long')])
def test_unreadable_paths(file: Path, name: str, reason: str) -> None:
    (file.parent / 'folder').mkdir()
    with pytest.raises(CameraInfoError, match=f'cannot be read: .*{reason}'):
        read_camera_info(file.parent / name)
    assert {*file.parent.iterdir()} == {file, file.parent / 'folder'}


@pytest.mark.parametrize('name', ['folder', 'camera.yaml/x', 'a\0b', 'x' * 300])
def test_unwritable_paths(file: Path, name: str) -> None:
    (file.parent / 'folder').mkdir()
    with pytest.raises(CameraInfoError, match='cannot be written: '):
        write_camera_info(file.parent / name, read_camera_info(file), 'x')
    assert {*file.parent.iterdir()} == {file, file.parent / 'folder'}


any_calibration = given(info=camera_infos(), name=NAMES)


def check_round_trip_of_a_calibration(
        tmp_path_factory: pytest.TempPathFactory, info: CameraInfo, name: str) -> None:
    home = tmp_path_factory.mktemp('written')
    path = home / 'new' / 'newer' / 'camera.yaml'
    write_camera_info(path, info, name, home)
    assert read_camera_info(path) == info
    assert list(path.parent.iterdir()) == [path]
    plain = yaml.safe_load(path.read_text())  # other programs read types
    assert plain['camera_name'] == name
    assert plain['camera_matrix'] == {'rows': 3, 'cols': 3, 'data': info.k.tolist()}
    assert plain['distortion_coefficients']['cols'] == len(info.d)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [30, 100])
def test_round_trip_of_a_calibration(
        examples: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    check = any_calibration(check_round_trip_of_a_calibration)
    settings(ANY_MACHINE, max_examples=examples)(check)(tmp_path_factory=tmp_path_factory)


def test_unchanged_file_after_a_refusal(file: Path) -> None:
    info = read_camera_info(file)
    info.k[4] = np.nan
    with pytest.raises(CameraInfoError, match='camera_matrix'):
        write_camera_info(file, info, 'x')
    assert file.read_text() == CALIBRATION


def test_replacement_without_change_of_the_old_inode(file: Path) -> None:
    old = file.with_name('old.yaml')
    old.hardlink_to(file)  # the content that a program with the open file sees
    info = read_camera_info(file)
    info.binning_x = 7
    write_camera_info(file, info, 'x')
    assert read_camera_info(file).binning_x == 7
    assert old.read_text() == CALIBRATION


@pytest.mark.parametrize(('kind', 'reason'), [
    ('text', 'the existing file is not a calibration; remove it, or give another path'),
    ('empty', 'the existing file is not a calibration; remove it, or give another path'),
    ('link', 'camera.yaml is a symbolic link, not a regular file; remove it'),
    ('dangling', 'camera.yaml is a symbolic link, not a regular file; remove it'),
    ('fifo', 'camera.yaml is a named pipe, not a regular file; remove it'),
    ('no folder', 'No such file or directory; make its folder, or give another path'),
    ('outside', 'No such file or directory; make its folder, or give another path')])
def test_unreplaceable_files(file: Path, kind: str, reason: str) -> None:
    info = read_camera_info(file)
    other = file.rename(file.with_name('other.yaml'))
    path = file
    if kind in ('text', 'empty'):
        file.write_text('alias ls=ls\n' if kind == 'text' else '')
    elif kind in ('link', 'dangling'):
        file.symlink_to('other.yaml' if kind == 'link' else 'missing.yaml')
    elif kind == 'fifo':
        os.mkfifo(file)
    else:
        path = file.parent.joinpath(
            *(('ros', '..') if kind == 'outside' else ()), 'new', 'camera.yaml')
    before = {entry.name: entry.lstat().st_mtime_ns for entry in file.parent.iterdir()}
    for home in (None, file.parent / 'ros', file.parent / 'other'):
        with pytest.raises(CameraInfoError) as caught:
            write_camera_info(path, info, 'x', home)
        assert str(caught.value).startswith(f'{path} cannot be written: {reason}')
    assert {entry.name: entry.lstat().st_mtime_ns for entry in file.parent.iterdir()} == before
    assert other.read_text() == CALIBRATION


@pytest.mark.parametrize('name', ['', '.', '..', 'a/b', 'a b', 'a\n', '$(x)', 'é', 'x' * 129])
def test_refused_camera_names(file: Path, name: str) -> None:
    with pytest.raises(CameraInfoError, match=r'^the name of the camera is .*: give up to 128'):
        write_camera_info(file, read_camera_info(file), name)
    with pytest.raises(ValueError, match='give up to 128 letters'):
        check_camera_name(name)
    assert file.read_text() == CALIBRATION


@pytest.mark.parametrize(('field', 'value', 'reason'), [
    ('distortion_model', '$(touch /tmp/PWNED)', 'distortion_model is '),
    ('distortion_model', 'a\nb: c', 'distortion_model is '), ('d', [np.inf], 'distortion_coeff'),
    ('width', 0, 'image_width is '), ('d', [0.1] * 30_000, 'has [0-9]+ bytes: give a cal')])
def test_refused_calibrations(
        file: Path, field: str, value: Any, reason: str) -> None:
    info = read_camera_info(file)
    setattr(info, field, value)
    with pytest.raises(CameraInfoError, match=reason):
        write_camera_info(file, info, 'x')
    with pytest.raises(CameraInfoError, match=reason):
        write_camera_info(file.with_name('new.yaml'), info, 'x')
    assert file.read_text() == CALIBRATION
    assert list(file.parent.iterdir()) == [file]


def test_values_as_yaml_cpp_reads_them(file: Path) -> None:
    warnings: list[str] = []
    expected = read_camera_info(file, warnings.append)
    assert not warnings
    text = CALIBRATION.replace('distortion_model: plumb_bob\n', '')
    file.write_text(text.replace('640', '0x280'))
    assert read_camera_info(file, warnings.append) == expected
    assert warnings == [f'{file} has no distortion_model: plumb_bob is assumed']
    for word, truth in (('True', True), ('yes', True), ('ON', True), ('False', False),
                        ('NO', False), ('n', False)):
        file.write_text(CALIBRATION + OPERATION.replace('true', word))
        assert read_camera_info(file).roi.do_rectify is truth


def test_file_of_opencv(file: Path) -> None:
    expected = read_camera_info(file)
    text = CALIBRATION.replace('_matrix:\n', '_matrix: !!opencv-matrix\n').replace(
        'coefficients:\n', 'coefficients: !!opencv-matrix\n')
    assert text.count('opencv-matrix') == 4
    for version in '012':
        file.write_text(f'%YAML:1.{version}\n---\n{text}')
        assert read_camera_info(file) == expected


INI = """# oST version 5.0 parameters

[image]

width
640

height
480

[narrow_stereo]

camera matrix
602.31847 0.000000 318.90521
0.000000 603.07712 243.11608
0.000000 0.000000 1.000000

distortion
{distortion}

rectification
1.0 0.0 0.0
0.0 1.0 0.0
0.0 0.0 1.0

projection
588.41903 0.0 309.57274 -70.61028
0.0 588.41903 241.80466 0.0
0.0 0.0 1.0 0.0
"""


@pytest.mark.parametrize(('distortion', 'model'), [
    ('0.08712 -0.193355 0.001127 -0.000805 0.000000', 'plumb_bob'),
    ('0.1 0.2 0.3 0.4 0.5 0.6 0.7 0.8', 'rational_polynomial')])
def test_file_of_cameracalibrator(file: Path, distortion: str, model: str) -> None:
    file.write_text(INI.format(distortion=distortion))
    info = read_camera_info(file)
    assert (info.width, info.height, info.distortion_model) == (640, 480, model)
    assert info.d.tolist() == [float(number) for number in distortion.split()]
    assert info.k.tolist() == [602.31847, 0, 318.90521, 0, 603.07712, 243.11608, 0, 0, 1]
    assert info.p[3] == -70.61028 and info.r.tolist() == np.eye(3).ravel().tolist()


@pytest.mark.parametrize(('old', 'new', 'reason'), [
    ('640', 'wide', 'image_width is missing: give a whole number'),
    ('640', '0', 'image_width is .0.: give'), ('height\n480', '', 'image_height is missing'),
    ('588.41903 0.0 309', '309', 'projection_matrix.data is'), ('0.08712', 'x', 'distortion_coef'),
    ('camera matrix', 'camera', 'camera_matrix.data is')])
def test_refused_files_of_cameracalibrator(file: Path, old: str, new: str, reason: str) -> None:
    file.write_text(INI.format(distortion='0.08712 0 0 0 0').replace(old, new, 1))
    with pytest.raises(CameraInfoError, match=reason):
        read_camera_info(file)


@pytest.mark.parametrize(('model', 'distortion'), [
    ('fisheye', 'equidistant'), ('equidistant', 'equidistant'), ('pinhole', 'plumb_bob')])
def test_camera_model_without_a_distortion_model(
        file: Path, model: str, distortion: str) -> None:
    file.write_text(CALIBRATION.replace(
        'distortion_model: plumb_bob\n', f'camera_model: {model}\n'))
    warnings: list[str] = []
    assert read_camera_info(file, warnings.append).distortion_model == distortion
    assert warnings == [f'{file} has no distortion_model: {distortion} is assumed']


def test_unknown_camera_model(file: Path) -> None:
    file.write_text(CALIBRATION.replace(
        'distortion_model: plumb_bob\n', 'camera_model: mirror_ball\n'))
    with pytest.raises(CameraInfoError, match="camera_model is 'mirror_ball': give dist"):
        read_camera_info(file)
    file.write_text(CALIBRATION + 'camera_model: mirror_ball\n')
    assert read_camera_info(file).distortion_model == 'plumb_bob'
