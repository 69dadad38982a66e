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

"""Calibrations of URLs, scaled to the size of the images and saved by a service."""

from __future__ import annotations

from pathlib import Path
from threading import Event, Thread

from ament_index_python.packages import get_package_share_directory
from calibrations import ANY_MACHINE, CALIBRATION, camera_infos
from hypothesis import given, settings, strategies as st
import numpy as np
from opencv_tools.nodes.publisher.calibration_file import CameraInfoError, read_camera_info
from opencv_tools.nodes.publisher.camera_info import (
    PublishedCalibration, resolve_url, scale_camera_info)
import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest
from std_msgs.msg import Header
from waiting import Watch


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / 'camera.yaml'
    path.write_text(CALIBRATION)
    return path


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


@pytest.mark.parametrize(('url', 'reason'), [
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
def test_refused_urls(url: str, reason: str) -> None:
    with pytest.raises(CameraInfoError, match=reason):
        resolve_url(url, 'left')


def project(matrix: np.ndarray, point: list[float]) -> np.ndarray:
    u, v, w = matrix.reshape(3, -1) @ point
    return np.array([u / w, v / w])


@ANY_MACHINE
@given(unit=st.integers(1, 2000), x=st.floats(-5, 5), y=st.floats(-5, 5), z=st.floats(0.1, 50))
def test_pixels_of_a_scaled_calibration(unit: int, x: float, y: float, z: float) -> None:
    k, p = [600, 2, 310, 0, 610, 250, 0, 0, 1], [590, 0, 305, -70, 0, 595, 245, 9, 0, 0, 1, 0]
    info = CameraInfo(width=640, height=480, k=np.array(k, float), p=np.array(p, float))
    scaled = scale_camera_info(info, 4 * unit, 3 * unit)
    for old, new, point in ((info.k, scaled.k, [x, y, z]), (info.p, scaled.p, [x, y, z, 1])):
        np.testing.assert_allclose(
            project(new, point), project(old, point) * unit / 160, rtol=1e-9, atol=1e-9)


any_scaling = given(info=camera_infos(st.floats(-1e9, 1e9)), factor=st.integers(1, 9))


def check_round_trip_of_scaling(info: CameraInfo, factor: int) -> None:
    info.width, info.height = info.width // 9 + 1, info.height // 9 + 1
    info.roi.x_offset = info.roi.y_offset = 0
    info.roi.width, info.roi.height = info.width // 2, info.height // 3
    scaled = scale_camera_info(info, info.width * factor, info.height * factor)
    assert scaled.roi.width == info.roi.width * factor
    assert (scaled.r == info.r).all()
    back = scale_camera_info(scaled, info.width, info.height)
    np.testing.assert_allclose(back.k, info.k, rtol=1e-12)
    np.testing.assert_allclose(back.p, info.p, rtol=1e-12)
    back.k, back.p = info.k, info.p
    assert back == info


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize('examples', [30, 100])
def test_round_trip_of_scaling(examples: int) -> None:
    settings(ANY_MACHINE, max_examples=examples)(any_scaling(check_round_trip_of_scaling))()


def test_scaled_region_of_interest(file: Path) -> None:
    info = read_camera_info(file)
    assert scale_camera_info(info, 320, 240).roi == RegionOfInterest()
    info.roi = RegionOfInterest(x_offset=11, y_offset=20, width=2, height=460, do_rectify=True)
    assert scale_camera_info(info, 320, 240).roi == RegionOfInterest(
        x_offset=5, y_offset=10, width=2, height=230, do_rectify=True)


@pytest.mark.parametrize(('width', 'height'), [(640, 360), (649, 480), (0, 0), (480, 640)])
def test_refused_aspect_ratios(file: Path, width: int, height: int) -> None:
    info = read_camera_info(file)
    with pytest.raises(CameraInfoError, match=f'640x480 .*{width}x{height}: calibrate'):
        scale_camera_info(info, width, height)
    assert scale_camera_info(info, 645, 480).height == 480


def test_default_url_without_a_file(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    warnings: list[str] = []
    calibration = PublishedCalibration('', 'left', warnings.append)
    header = Header(frame_id='lens')
    assert calibration.message(header, 4, 3) == CameraInfo(header=header, width=4, height=3)
    assert not warnings
    (tmp_path / 'camera_info').mkdir()
    (tmp_path / 'camera_info' / 'left.yaml').write_text(CALIBRATION.replace('640', '0'))
    PublishedCalibration('', 'left', warnings.append)
    assert len(warnings) == 1
    assert 'image_width' in warnings[0]


@pytest.mark.parametrize('url', ['none.yaml', 'package://no_such_package/a', '.'])
def test_one_warning_about_an_unusable_url(url: str) -> None:
    warnings: list[str] = []
    calibration = PublishedCalibration(url, 'left', warnings.append)
    assert [calibration.message(Header(), 4, 3).k[0] for _ in range(3)] == [0, 0, 0]
    assert len(warnings) == 1
    assert warnings[0].endswith('; camera_info is published uncalibrated')


def test_independent_scaled_messages(file: Path) -> None:
    warnings: list[str] = []
    calibration = PublishedCalibration(f'file://{file}', 'left', warnings.append)
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
    calibration = PublishedCalibration('package://my_robot/a/${NAME}.yaml', 'left', lambda _: None)
    info = read_camera_info(file)
    path = calibration.save(info)
    assert path == str(tmp_path / 'share' / 'my_robot' / 'a' / 'left.yaml')
    assert read_camera_info(Path(path)) == info
    info.k[0] = 1.0  # the message of the client
    assert calibration.message(Header(), 640, 480) == read_camera_info(file)
    with pytest.raises(CameraInfoError, match='image_width'):
        calibration.save(CameraInfo(k=info.k, r=info.r, p=info.p))
    assert calibration.message(Header(), 640, 480) == read_camera_info(Path(path))
    assert read_camera_info(Path(path)).k[0] == 602.31847


@pytest.mark.parametrize(('field', 'value', 'reason'), [
    ('k', [0.0] * 9, 'the camera_info has no calibration, because its K is zero'),
    ('k', [-9.0, 0.0, 4.0, 0.0, 9.0, 4.0, 0.0, 0.0, 1.0], 'has the focal lengths -9 and 9'),
    ('k', [float('nan'), *[0.0] * 8], 'K of the camera_info has the value nan'),
    ('p', [0.0] * 12, 'P of the camera_info has the focal lengths 0 and 0'),
    ('p', [float('-inf'), *[0.0] * 11], 'P of the camera_info has the value -inf'),
    ('r', [0.0] * 8 + [1.0], 'P and R of the camera_info cannot be inverted'),
    ('d', [0.1, float('nan'), 0.0, 0.0, 0.0], 'D of the camera_info has the value nan'),
    ('d', [0.1, float('inf'), 0.0, 0.0, 0.0], 'D of the camera_info has the value inf'),
    ('d', [0.1] * 3, 'D of the camera_info has 3 coefficients'),
    ('d', [0.0] * 3, 'D of the camera_info has 3 coefficients'),
    ('d', [0.0] * 10_000, 'D of the camera_info has 10000 coefficients'),
    ('distortion_model', 'fisheye9', "the distortion model 'fisheye9' of the camera_info is"),
    ('distortion_model', '', "the distortion model '' of the camera_info is unknown")])
@pytest.mark.parametrize('rotate', [0, 90])
def test_unusable_calibrations_are_not_saved(
        file: Path, field: str, value: str | list[float], reason: str, rotate: int) -> None:
    calibration = PublishedCalibration(str(file), 'left', lambda _: None)
    info = read_camera_info(file)
    setattr(info, field, value)
    with pytest.raises(CameraInfoError) as caught:
        calibration.save(info, rotate=rotate)
    assert reason in str(caught.value) and '\n' not in str(caught.value)
    assert file.read_text() == CALIBRATION
    assert calibration.message(Header(), 640, 480) == read_camera_info(file)


@pytest.mark.parametrize(('model', 'coefficients'), [
    ('', []), ('plumb_bob', []), ('plumb_bob', [0.0] * 5), ('equidistant', [0.1] * 4),
    ('rational_polynomial', [0.1] * 8), ('rational_polynomial', [0.0] * 14)])
def test_saved_distortion_models(file: Path, model: str, coefficients: list[float]) -> None:
    calibration = PublishedCalibration(str(file), 'left', lambda _: None)
    info = read_camera_info(file)
    info.distortion_model, info.d = model, coefficients
    info.roi = RegionOfInterest(x_offset=10, y_offset=10, width=50, height=60)
    info.binning_x = info.binning_y = 2
    calibration.save(info)
    assert read_camera_info(file) == info


def test_file_after_a_change_of_ros_home(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path, file: Path) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'ros'))
    calibration = PublishedCalibration('', 'left', lambda _: None)
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'other'))
    path = calibration.save(read_camera_info(file))
    assert path == str(tmp_path / 'ros' / 'camera_info' / 'left.yaml')
    assert not (tmp_path / 'other').exists()
    refused = PublishedCalibration('flash:///x', 'left', lambda _: None)
    with pytest.raises(CameraInfoError, match='give file:///PATH'):
        refused.save(read_camera_info(file))


def test_one_warning_about_a_missing_distortion_model(file: Path) -> None:
    file.write_text(CALIBRATION.replace('distortion_model: plumb_bob\n', ''))
    warnings: list[str] = []
    PublishedCalibration(str(file), 'left', warnings.append)
    assert warnings == [f'{file} has no distortion_model: plumb_bob is assumed']


def test_consistent_messages_during_saving(tmp_path: Path) -> None:
    calibration = PublishedCalibration(str(tmp_path / 'a.yaml'), 'left', lambda _: None)
    is_done = Event()

    def _save() -> None:
        number = 0.0
        while not is_done.is_set():
            number += 1.0
            calibration.save(CameraInfo(
                width=4, height=3, distortion_model='plumb_bob', d=[number] * 5,
                r=np.eye(3).ravel(), k=number * np.eye(3).ravel(),
                p=number * np.eye(3, 4).ravel()))

    saving = Thread(target=_save)
    saving.start()
    try:
        last, changes, watch = 0.0, 0, Watch('5 changes', {'changes': lambda: changes})
        while changes < 5:
            watch.check()
            message = calibration.message(Header(), 4, 3)
            (number,) = {*message.k[::4], *message.p[::5], *message.d}
            assert number >= last
            changes += number > last
            last = number
    finally:
        is_done.set()
        saving.join()
