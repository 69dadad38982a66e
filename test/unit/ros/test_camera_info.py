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

"""A camera's calibration: files, URLs, sizes, and what a node publishes."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Event, Thread
import time
from typing import Any

from ament_index_python.packages import get_package_share_directory
from conftest import DEADLINE
from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
from opencv_tools.ros.publisher.calibration_file import (
    CameraInfoError, check_camera_name, read_camera_info, write_camera_info)
from opencv_tools.ros.publisher.camera_info import Calibration, resolve_url, scale_camera_info
import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest
from std_msgs.msg import Header
import yaml

# A right camera, as cameracalibrator of camera_calibration writes it.
CALIBRATION = """image_width: 640
image_height: 480
camera_name: 0123e4
camera_matrix:
  rows: 3
  cols: 3
  data: [602.31847,   0.     , 318.90521,
           0.     , 603.07712, 243.11608,
           0.     ,   0.     ,   1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.087120, -0.193355, 0.001127, -0.000805, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [ 0.99984103, -0.00411876,  0.0173492 ,
          0.00408522,  0.99998972,  0.00196837,
         -0.01735713, -0.00189718,  0.99984756]
projection_matrix:
  rows: 3
  cols: 4
  data: [588.41903,   0.     , 309.57274, -70.61028,
           0.     , 588.41903, 241.80466,   0.     ,
           0.     ,   0.     ,   1.     ,   0.     ]
"""
# What yaml-cpp adds in camera_calibration_parsers.
OPERATION = """binning_x: 2
binning_y: 1
roi:
  x_offset: 10
  y_offset: 21
  height: 100
  width: 33
  do_rectify: true
"""
SIZES = st.integers(1, 2**32 - 1)
# However long it takes.
ANY_MACHINE = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
MODELS = st.from_regex(r'[A-Za-z0-9_]{0,64}', fullmatch=True)
NAMES = st.from_regex(r'[A-Za-z0-9_.-]{0,127}[A-Za-z0-9]', fullmatch=True)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / 'camera.yaml'
    path.write_text(CALIBRATION)
    return path


@st.composite
def infos(draw: st.DrawFn, numbers: st.SearchStrategy[float] = NUMBERS) -> CameraInfo:
    width, height = draw(SIZES), draw(SIZES)
    left, top = draw(st.integers(0, width)), draw(st.integers(0, height))
    roi = RegionOfInterest(
        x_offset=left, y_offset=top, width=draw(st.integers(0, width - left)),
        height=draw(st.integers(0, height - top)), do_rectify=draw(st.booleans()))
    k, r, p = (draw(st.lists(numbers, min_size=n, max_size=n)) for n in (9, 9, 12))
    return CameraInfo(
        width=width, height=height, distortion_model=draw(MODELS), d=draw(st.lists(numbers)),
        k=k, r=r, p=p, binning_x=draw(SIZES), binning_y=draw(SIZES), roi=roi)


def test_reads_what_camera_calibration_writes(file: Path) -> None:
    info = read_camera_info(file)
    assert info == CameraInfo(
        width=640, height=480, distortion_model='plumb_bob',
        d=[0.08712, -0.193355, 0.001127, -0.000805, 0.0],
        k=[602.31847, 0.0, 318.90521, 0.0, 603.07712, 243.11608, 0.0, 0.0, 1.0],
        r=[0.99984103, -0.00411876, 0.0173492, 0.00408522, 0.99998972, 0.00196837, -0.01735713,
           -0.00189718, 0.99984756],
        p=[588.41903, 0.0, 309.57274, -70.61028, 0.0, 588.41903, 241.80466, 0.0, 0.0, 0.0, 1.0,
           0.0])


def test_reads_what_camera_calibration_parsers_writes(file: Path) -> None:
    file.write_text(CALIBRATION.replace('0.001127', '1e-05') + OPERATION)
    info = read_camera_info(file)
    assert (info.d[2], info.binning_x, info.binning_y) == (1e-5, 2, 1)
    assert info.roi == RegionOfInterest(
        x_offset=10, y_offset=21, width=33, height=100, do_rectify=True)


@pytest.mark.parametrize(('old', 'new', 'complaint'), [
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
def test_files_that_are_refused(file: Path, old: str, new: str, complaint: str) -> None:
    file.write_text((CALIBRATION + OPERATION).replace(old, new, 1))
    with pytest.raises(CameraInfoError, match=f'camera.yaml:? {complaint}') as caught:
        read_camera_info(file)
    assert len(str(caught.value)) < 400 + len(str(file))


@pytest.mark.parametrize(('name', 'complaint'), [
    ('folder', 'Is a directory'), ('none.yaml', 'No such file'),
    ('camera.yaml/x', 'Not a directory'), ('a\0b', 'null byte'), ('x' * 300, 'name too long')])
def test_paths_that_cannot_be_read_or_written(file: Path, name: str, complaint: str) -> None:
    (file.parent / 'folder').mkdir()
    path = file.parent / name
    with pytest.raises(CameraInfoError, match=f'cannot be read: .*{complaint}'):
        read_camera_info(path)
    if name != 'none.yaml':
        with pytest.raises(CameraInfoError, match='cannot be written: '):
            write_camera_info(path, read_camera_info(file), 'x')
    assert {*file.parent.iterdir()} == {file, file.parent / 'folder'}


@ANY_MACHINE
@given(info=infos(), name=NAMES)
def test_what_is_written_is_read_again(
        tmp_path_factory: pytest.TempPathFactory, info: CameraInfo, name: str) -> None:
    home = tmp_path_factory.mktemp('written')
    path = home / 'new' / 'newer' / 'camera.yaml'
    write_camera_info(path, info, name, home)
    assert read_camera_info(path) == info
    assert list(path.parent.iterdir()) == [path]
    plain = yaml.safe_load(path.read_text())  # as other programs have it, with types of its own
    assert plain['camera_name'] == name
    assert plain['camera_matrix'] == {'rows': 3, 'cols': 3, 'data': info.k.tolist()}
    assert plain['distortion_coefficients']['cols'] == len(info.d)


def test_a_refused_calibration_leaves_the_file_as_it_was(file: Path) -> None:
    info = read_camera_info(file)
    info.k[4] = np.nan
    with pytest.raises(CameraInfoError, match='camera_matrix'):
        write_camera_info(file, info, 'x')
    assert file.read_text() == CALIBRATION


def test_a_calibration_is_replaced_and_the_old_file_whole(file: Path) -> None:
    old = file.with_name('old.yaml')
    old.hardlink_to(file)  # what a program that has it open sees
    info = read_camera_info(file)
    info.binning_x = 7
    write_camera_info(file, info, 'x')
    assert read_camera_info(file).binning_x == 7
    assert old.read_text() == CALIBRATION


@pytest.mark.parametrize(('kind', 'reason'), [
    ('text', 'the existing file is not a calibration; remove it, or give another URL'),
    ('empty', 'the existing file is not a calibration; remove it, or give another URL'),
    ('link', 'camera.yaml is a symbolic link, not a regular file; remove it'),
    ('dangling', 'camera.yaml is a symbolic link, not a regular file; remove it'),
    ('fifo', 'camera.yaml is a named pipe, not a regular file; remove it'),
    ('no folder', 'No such file or directory; make its folder, or give another URL'),
    ('outside', 'No such file or directory; make its folder, or give another URL')])
def test_what_is_no_calibration_is_not_replaced(file: Path, kind: str, reason: str) -> None:
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
def test_names_that_no_camera_has(file: Path, name: str) -> None:
    with pytest.raises(CameraInfoError, match=r'^the name of the camera is .*: give up to 128'):
        write_camera_info(file, read_camera_info(file), name)
    with pytest.raises(ValueError, match='give up to 128 letters'):
        check_camera_name(name)
    assert file.read_text() == CALIBRATION


@pytest.mark.parametrize(('field', 'value', 'complaint'), [
    ('distortion_model', '$(touch /tmp/PWNED)', 'distortion_model is '),
    ('distortion_model', 'a\nb: c', 'distortion_model is '), ('d', [np.inf], 'distortion_coeff'),
    ('width', 0, 'image_width is '), ('d', [0.1] * 30_000, 'has [0-9]+ bytes: give a cal')])
def test_calibrations_that_are_not_written(
        file: Path, field: str, value: Any, complaint: str) -> None:
    info = read_camera_info(file)
    setattr(info, field, value)
    with pytest.raises(CameraInfoError, match=complaint):
        write_camera_info(file, info, 'x')
    with pytest.raises(CameraInfoError, match=complaint):
        write_camera_info(file.with_name('new.yaml'), info, 'x')
    assert file.read_text() == CALIBRATION
    assert list(file.parent.iterdir()) == [file]


def test_what_yaml_cpp_takes_is_read(file: Path) -> None:
    remarks: list[str] = []
    expected = read_camera_info(file, remarks.append)
    assert not remarks
    text = CALIBRATION.replace('distortion_model: plumb_bob\n', '')
    file.write_text(text.replace('640', '0x280'))
    assert read_camera_info(file, remarks.append) == expected
    assert remarks == [f'{file} has no distortion_model: plumb_bob is assumed']
    Calibration(str(file), 'left', remarks.append)
    assert remarks[1:] == remarks[:1]
    for word, truth in (('True', True), ('yes', True), ('ON', True), ('False', False),
                        ('NO', False), ('n', False)):
        file.write_text(CALIBRATION + OPERATION.replace('true', word))
        assert read_camera_info(file).roi.do_rectify is truth


def test_urls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('HOME', '/home/me')
    monkeypatch.delenv('ROS_HOME', raising=False)
    share = get_package_share_directory('sensor_msgs')
    for url, path in {
        'file:///a/${NAME}.yaml': '/a/left.yaml', 'FILE:///$NAME': '/$NAME', 'a b%20': 'a b%20',
        'file://${ROS_HOME}/x': '/home/me/.ros/x', '~/${NAME}${NAME}': '/home/me/leftleft',
        'package://sensor_msgs/msg/${NAME}.yaml': f'{share}/msg/left.yaml',
    }.items():
        assert resolve_url(url, 'left') == Path(path)
    monkeypatch.setenv('ROS_HOME', '/ros')
    assert resolve_url('file://${ROS_HOME}/x', 'left') == Path('/ros/x')


@pytest.mark.parametrize(('url', 'complaint'), [
    ('file://a/b', 'give file:///PATH'), ('flash:///a', 'give file:///PATH'),
    ('http://a/b', 'give file:///PATH'), ('package://sensor_msgs', 'give file:///PATH'),
    ('package:///a', 'give file:///PATH'), ('package://sensor_msgs//etc/x', 'outside the package'),
    ('package://sensor_msgs/../x', 'outside the package'),
    ('package://sensor_msgs/a/../../x', 'outside the package'),
    ('package://sensor_msgs/a/', 'outside the package'),
    ('package://sensor_msgs/./a', 'outside the package'),
    ('package://sensor_msgs/', 'outside the package'),
    ('package://no_such_package/a', 'unknown package'),
    ('package://a b/c', 'unknown package'), ('/${HOME}/a', r'unknown variable \$\{HOME\}'),
    ('/${NAME', r'unknown variable \$\{NAME: '), ('~no such user/a', 'needs a home directory')])
def test_urls_that_are_refused(url: str, complaint: str) -> None:
    with pytest.raises(CameraInfoError, match=complaint):
        resolve_url(url, 'left')


def project(matrix: np.ndarray, point: list[float]) -> np.ndarray:
    u, v, w = matrix.reshape(3, -1) @ point
    return np.array([u / w, v / w])


@ANY_MACHINE
@given(unit=st.integers(1, 2000), x=st.floats(-5, 5), y=st.floats(-5, 5), z=st.floats(0.1, 50))
def test_pixels_move_by_the_ratio_of_the_sizes(unit: int, x: float, y: float, z: float) -> None:
    k, p = [600, 2, 310, 0, 610, 250, 0, 0, 1], [590, 0, 305, -70, 0, 595, 245, 9, 0, 0, 1, 0]
    info = CameraInfo(width=640, height=480, k=np.array(k, float), p=np.array(p, float))
    scaled = scale_camera_info(info, 4 * unit, 3 * unit)
    for old, new, point in ((info.k, scaled.k, [x, y, z]), (info.p, scaled.p, [x, y, z, 1])):
        np.testing.assert_allclose(
            project(new, point), project(old, point) * unit / 160, rtol=1e-9, atol=1e-9)


@ANY_MACHINE
@given(info=infos(st.floats(-1e9, 1e9)), factor=st.integers(1, 9))
def test_scaled_there_and_back(info: CameraInfo, factor: int) -> None:
    info.width, info.height = info.width // 9 + 1, info.height // 9 + 1
    info.roi.x_offset = info.roi.y_offset = 0
    info.roi.width, info.roi.height = info.width // 2, info.height // 3
    there = scale_camera_info(info, info.width * factor, info.height * factor)
    assert there.roi.width == info.roi.width * factor
    assert (there.r == info.r).all()
    back = scale_camera_info(there, info.width, info.height)
    np.testing.assert_allclose(back.k, info.k, rtol=1e-12)
    np.testing.assert_allclose(back.p, info.p, rtol=1e-12)
    back.k, back.p = info.k, info.p
    assert back == info


def test_a_region_keeps_all_its_pixels_and_none_stays_none(file: Path) -> None:
    info = read_camera_info(file)
    assert scale_camera_info(info, 320, 240).roi == RegionOfInterest()
    info.roi = RegionOfInterest(x_offset=11, y_offset=20, width=2, height=460, do_rectify=True)
    assert scale_camera_info(info, 320, 240).roi == RegionOfInterest(
        x_offset=5, y_offset=10, width=2, height=230, do_rectify=True)


@pytest.mark.parametrize(('width', 'height'), [(640, 360), (649, 480), (0, 0), (480, 640)])
def test_other_aspects_are_refused(file: Path, width: int, height: int) -> None:
    info = read_camera_info(file)
    with pytest.raises(CameraInfoError, match=f'640x480 .*{width}x{height}: calibrate'):
        scale_camera_info(info, width, height)
    assert scale_camera_info(info, 645, 480).height == 480


def test_no_calibration_at_the_default_url_is_no_fault(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    warnings: list[str] = []
    calibration = Calibration('', 'left', warnings.append)
    header = Header(frame_id='lens')
    assert calibration.message(header, 4, 3) == CameraInfo(header=header, width=4, height=3)
    assert not warnings
    (tmp_path / 'camera_info').mkdir()
    (tmp_path / 'camera_info' / 'left.yaml').write_text(CALIBRATION.replace('640', '0'))
    Calibration('', 'left', warnings.append)
    assert len(warnings) == 1
    assert 'image_width' in warnings[0]


@pytest.mark.parametrize('url', ['none.yaml', 'package://no_such_package/a', '.'])
def test_a_given_url_that_cannot_be_loaded_is_warned_about_once(url: str) -> None:
    warnings: list[str] = []
    calibration = Calibration(url, 'left', warnings.append)
    assert [calibration.message(Header(), 4, 3).k[0] for _ in range(3)] == [0, 0, 0]
    assert len(warnings) == 1
    assert warnings[0].endswith('; camera_info is published uncalibrated')


def test_messages_are_scaled_and_apart(file: Path) -> None:
    warnings: list[str] = []
    calibration = Calibration(f'file://{file}', 'left', warnings.append)
    first = calibration.message(Header(frame_id='a'), 1280, 960)
    first.k[0] = first.d[0] = first.roi.width = 5
    second = calibration.message(Header(frame_id='b'), 1280, 960)
    assert (second.k[0], second.d[0], second.roi.width) == (2 * 602.31847, 0.08712, 0)
    assert (first.header.frame_id, second.header.frame_id) == ('a', 'b')
    for width in (640, 641, 800, 800, 900, 800):
        message = calibration.message(Header(), width, 480)
        assert (message.width, message.k[0] > 0) == (width, width < 650)
    assert ['800x480' in line for line in warnings] == [True, False]


def test_saving_to_a_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, file: Path) -> None:
    index = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages'
    index.mkdir(parents=True)
    (index / 'my_robot').touch()
    (tmp_path / 'share' / 'my_robot' / 'a').mkdir(parents=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    calibration = Calibration('package://my_robot/a/${NAME}.yaml', 'left', lambda _: None)
    info = read_camera_info(file)
    path = calibration.save(info)
    assert path == str(tmp_path / 'share' / 'my_robot' / 'a' / 'left.yaml')
    assert read_camera_info(Path(path)) == info
    info.k[0] = 1.0  # the sender's own
    assert calibration.message(Header(), 640, 480) == read_camera_info(file)
    with pytest.raises(CameraInfoError, match='image_width'):
        calibration.save(CameraInfo())
    assert calibration.message(Header(), 640, 480) == read_camera_info(Path(path))
    assert read_camera_info(Path(path)).k[0] == 602.31847


def test_the_file_is_that_of_the_start(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, file: Path) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'ros'))
    calibration = Calibration('', 'left', lambda _: None)
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'other'))
    path = calibration.save(read_camera_info(file))
    assert path == str(tmp_path / 'ros' / 'camera_info' / 'left.yaml')
    assert not (tmp_path / 'other').exists()
    refused = Calibration('flash:///x', 'left', lambda _: None)
    with pytest.raises(CameraInfoError, match='give file:///PATH'):
        refused.save(read_camera_info(file))


def test_saving_beside_messages_never_mixes(tmp_path: Path) -> None:
    calibration = Calibration(str(tmp_path / 'a.yaml'), 'left', lambda _: None)
    is_enough = Event()

    def _save() -> None:
        number = 0.0
        while not is_enough.is_set():
            number += 1.0
            calibration.save(CameraInfo(width=4, height=3, d=[number] * 5,
                                        k=np.full(9, number), p=np.full(12, number)))

    saving = Thread(target=_save)
    saving.start()
    try:
        last, changes, deadline = 0.0, 0, time.monotonic() + DEADLINE
        while changes < 20:
            assert time.monotonic() < deadline
            message = calibration.message(Header(), 4, 3)
            (number,) = {*message.k, *message.p, *message.d}
            assert number >= last
            changes += number > last
            last = number
    finally:
        is_enough.set()
        saving.join()
