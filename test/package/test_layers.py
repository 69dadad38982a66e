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

"""Allowed imports of each package; pure packages work without ROS and OpenCV."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
import subprocess
import sys

import opencv_tools
import pytest
from waiting import LONGEST_SECONDS

ROOT = Path(opencv_tools.__file__).parent
MODULES = sorted(
    '.'.join(path.relative_to(ROOT.parent).with_suffix('').parts).removesuffix('.__init__')
    for path in ROOT.rglob('*.py'))
NAMES = frozenset(MODULES)

ROBOT = 'opencv_tools.robot'
# Modules of a room import only what stands here, beside base, the standard library and numpy.
PURE = ('opencv_tools.bags', 'opencv_tools.image', 'opencv_tools.base',
        'opencv_tools.message_types', 'opencv_tools.nodes.help_text',
        'opencv_tools.recording.naming', 'opencv_tools.robot',
        'opencv_tools.video.bit_stream', 'opencv_tools.video.lossless',
        'opencv_tools.video.packet', 'opencv_tools.video.parameter_sets',
        'opencv_tools.video.settings',
        'opencv_tools.viewer.access', 'opencv_tools.viewer.certificate',
        'opencv_tools.viewer.errors', 'opencv_tools.viewer.web.page_files',
        'opencv_tools.viewer.protocol', 'opencv_tools.viewer.region',
        'opencv_tools.viewer.robot.reader')
ALLOWED = {
    'opencv_tools.bags': {
        'opencv_tools.bags', 'opencv_tools.image', 'opencv_tools.message_types',
        'opencv_tools.video', 'lz4', 'mcap', 'yaml', 'zstandard'},
    'opencv_tools.base': {'tornado', 'tqdm'},
    'opencv_tools.calibration': {'opencv_tools.calibration', 'opencv_tools.image', 'cv2', 'yaml'},
    'opencv_tools.calibration.cli': {'opencv_tools.calibration.command'},
    'opencv_tools.calibration.command': {
        'opencv_tools.calibration', 'opencv_tools.capture.errors'},
    'opencv_tools.calibration.source_images': {
        'opencv_tools.calibration', 'opencv_tools.capture', 'opencv_tools.image'},
    'opencv_tools.calibration.view_search': {'opencv_tools.calibration'},
    'opencv_tools.camera_model': {'opencv_tools.image', 'opencv_tools.opencv'},
    'opencv_tools.capture': {
        'opencv_tools.bags', 'opencv_tools.capture', 'opencv_tools.image',
        'opencv_tools.image_codecs', 'opencv_tools.opencv', 'opencv_tools.rectification',
        'opencv_tools.video'},
    'opencv_tools.commands': set(),
    'opencv_tools.convert': {
        'opencv_tools.bags', 'opencv_tools.capture', 'opencv_tools.convert',
        'opencv_tools.datasets.cli', 'opencv_tools.image', 'opencv_tools.recording',
        'opencv_tools.video'},
    'opencv_tools.cv_bridge': {
        'opencv_tools.image', 'opencv_tools.image_codecs', 'sensor_msgs', 'std_msgs'},
    'opencv_tools.datasets': {
        'opencv_tools.bags', 'opencv_tools.capture', 'opencv_tools.datasets',
        'opencv_tools.image', 'opencv_tools.message_types', 'opencv_tools.recording.errors',
        'opencv_tools.recording.video', 'opencv_tools.video.settings', 'av', 'cv2', 'pyarrow'},
    'opencv_tools.datasets.cli': {'opencv_tools.datasets'},
    'opencv_tools.datasets.on_ray': {'opencv_tools.datasets', 'ray'},
    'opencv_tools.frames': {
        'opencv_tools.cv_bridge', 'opencv_tools.frames', 'opencv_tools.image',
        'opencv_tools.image_codecs', 'opencv_tools.nodes', 'opencv_tools.rectification',
        'opencv_tools.topics', 'opencv_tools.transport', 'opencv_tools.video.encoder',
        'opencv_tools.video.settings',
        'builtin_interfaces', 'rclpy', 'sensor_msgs', 'std_msgs'},
    'opencv_tools.image': {'opencv_tools.image'},
    'opencv_tools.image_codecs': {'opencv_tools.image', 'opencv_tools.opencv', 'simplejpeg'},
    'opencv_tools.message_types': {'opencv_tools.image', 'opencv_tools.message_types'},
    'opencv_tools.nodes': {
        'opencv_tools.bags', 'opencv_tools.calibration.camera_file', 'opencv_tools.capture',
        'opencv_tools.cv_bridge', 'opencv_tools.image', 'opencv_tools.message_types',
        'opencv_tools.nodes', 'opencv_tools.recording', 'opencv_tools.rectification',
        'opencv_tools.topics', 'opencv_tools.transport', 'opencv_tools.video',
        'ament_index_python', 'builtin_interfaces', 'diagnostic_msgs', 'rcl_interfaces',
        'rclpy', 'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs',
        'type_description_interfaces', 'yaml'},
    'opencv_tools.opencv': {'cv2'},
    'opencv_tools.recording': {
        'opencv_tools.bags', 'opencv_tools.image', 'opencv_tools.image_codecs',
        'opencv_tools.recording', 'opencv_tools.video', 'av', 'opencv_tools.opencv'},
    'opencv_tools.recording.naming': set(),
    'opencv_tools.rectification': {
        'opencv_tools.camera_model', 'opencv_tools.image', 'opencv_tools.image_codecs',
        'opencv_tools.opencv'},
    'opencv_tools.robot': {
        'opencv_tools.robot', 'ament_index_python', 'lxml', 'matplotlib', 'xacro'},
    'opencv_tools.robot.view.server': {'opencv_tools.robot', 'tornado'},
    'opencv_tools.robot.xml': {'opencv_tools.robot.xml', 'lxml'},
    'opencv_tools.topic_views': {'opencv_tools.calibration', 'opencv_tools.frames'},
    'opencv_tools.topics': {
        'opencv_tools.image', 'opencv_tools.topics',
        'opencv_tools.transport', 'opencv_tools.video', 'rcl_interfaces', 'rclpy',
        'sensor_msgs', 'std_msgs'},
    'opencv_tools.transport': {
        'opencv_tools.image', 'opencv_tools.message_types', 'opencv_tools.transport',
        'ament_index_python', 'rclpy', 'sensor_msgs', 'std_msgs'},
    'opencv_tools.transport.shared_frames.memory': {
        'opencv_tools.transport.shared_frames', 'iceoryx2'},
    'opencv_tools.video': {
        'opencv_tools.image', 'opencv_tools.image_codecs', 'opencv_tools.message_types',
        'opencv_tools.video', 'av', 'opencv_tools.opencv'},
    'opencv_tools.viewer': {
        'opencv_tools.bags.schemas', 'opencv_tools.calibration', 'opencv_tools.camera_model',
        'opencv_tools.cv_bridge',
        'opencv_tools.image', 'opencv_tools.image_codecs', 'opencv_tools.message_types',
        'opencv_tools.nodes', 'opencv_tools.recording', 'opencv_tools.robot',
        'opencv_tools.topics', 'opencv_tools.transport.message_type', 'opencv_tools.video',
        'opencv_tools.viewer', 'opencv_tools.opencv', 'rcl_interfaces', 'rclpy', 'sensor_msgs',
        'std_msgs', 'std_srvs', 'tornado'},
    'opencv_tools.viewer.access': {
        'opencv_tools.viewer.certificate', 'opencv_tools.viewer.errors'},
    'opencv_tools.viewer.certificate': {'opencv_tools.viewer.errors'},
    'opencv_tools.viewer.errors': set(),
    'opencv_tools.viewer.protocol': {
        'opencv_tools.video.packet', 'opencv_tools.viewer.errors', 'opencv_tools.viewer.region'},
    'opencv_tools.viewer.region': set(),
    'opencv_tools.viewer.web.page_files': set(),
}
PROGRAMS = ('opencv_tools.nodes.publisher', 'opencv_tools.nodes.subscriber')
#: Floors of the rooms of the viewer, from the top down. A room imports only those below its own.
VIEWER = (
    ('server',), ('calibrate', 'robot'), ('web',), ('hub',), ('graph',), ('inspect', 'overlays'),
    ('streams', 'node_table', 'parameters'), ('control', 'robot_topics'),
    ('protocol', 'recording', 'access'), ('executor_calls', 'certificate'),
    ('region', 'errors', 'watched'))
#: What the modules of a package must not import, although ALLOWED names a package around it.
FORBIDDEN = {
    'opencv_tools.frames': PROGRAMS, 'opencv_tools.nodes': PROGRAMS,
    'opencv_tools.nodes.publisher': ('opencv_tools.nodes.subscriber', 'opencv_tools.recording'),
    'opencv_tools.nodes.subscriber': ('opencv_tools.nodes.publisher', 'opencv_tools.capture'),
    'opencv_tools.viewer': PROGRAMS,
}
NODES = ('opencv_tools', 'opencv_tools.basic_image_publisher',
         'opencv_tools.basic_image_subscriber', 'opencv_tools.image_filter',
         'opencv_tools.image_viewer')


@cache
def imported(module: str) -> set[str]:
    """Name what a module's source imports."""
    path = ROOT.parent.joinpath(*module.split('.'))
    source = path / '__init__.py' if path.is_dir() else path.with_suffix('.py')
    names = set()
    for statement in ast.walk(ast.parse(source.read_text())):
        if isinstance(statement, ast.Import):
            names.update(alias.name for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom):
            for alias in statement.names:
                name = f'{statement.module}.{alias.name}'
                names.add(name if name in NAMES else statement.module)
    return names


def test_imports_point_down() -> None:
    free = {*sys.stdlib_module_names, 'numpy'}
    wrong = []
    for module in sorted({*MODULES} - {*NODES}):
        room = max((name for name in ALLOWED if f'{module}.'.startswith(f'{name}.')), key=len)
        allowed = {*ALLOWED[room], 'opencv_tools.base'}
        wrong += [f'{module}: {name}' for name in imported(module)
                  if name.partition('.')[0] not in free
                  and not any(f'{name}.'.startswith(f'{other}.') for other in allowed)]
    assert wrong == []


def test_forbidden_imports() -> None:
    wrong = []
    for module in filter(lambda name: name.startswith(tuple(FORBIDDEN)), MODULES):
        package = max((name for name in FORBIDDEN if f'{module}.'.startswith(f'{name}.')), key=len)
        wrong += [f'{module}: {name}' for name in imported(module)
                  if name.startswith(FORBIDDEN[package])]
    assert wrong == []


def test_rooms_of_the_viewer_import_lower_floors_only() -> None:
    floors = {room: floor for floor, rooms in enumerate(VIEWER) for room in rooms}
    package = 'opencv_tools.viewer.'
    rooms = {module: module.removeprefix(package).partition('.')[0] for module in MODULES
             if module.startswith(package)}
    assert {*rooms.values()} == {*floors}
    assert [f'{module}: {name}' for module, room in rooms.items() for name in imported(module)
            if name in rooms and rooms[name] != room
            and floors[rooms[name]] <= floors[room]] == []


def test_urdf_imports_of_sdf_only_fragments_and_values() -> None:
    package = 'opencv_tools.robot.sdf'
    names = {name for module in MODULES if module.startswith('opencv_tools.robot.urdf.')
             for name in imported(module) if f'{name}.'.startswith(f'{package}.')}
    assert names == {f'{package}.fragments', f'{package}.values'}


def test_readers_and_writers_do_not_import_each_other() -> None:
    wrong = [f'{module}: {name}' for module in MODULES
             for one, other in (('reader', 'writer'), ('writer', 'reader'))
             if module.startswith(('opencv_tools.robot.urdf.', 'opencv_tools.robot.sdf.'))
             and module.endswith(one) for name in imported(module)
             if name.startswith('opencv_tools.robot.') and name.endswith(other)]
    assert wrong == []


def modules_of(room: str) -> list[str]:
    modules = [name for name in MODULES if f'{name}.'.startswith(f'{room}.')]
    assert modules, room
    return modules


@pytest.mark.quick_cases(2)
@pytest.mark.process
@pytest.mark.parametrize(('rooms', 'others'), [
    ([room for room in PURE if room != ROBOT], ['rclpy', 'cv2', 'sensor_msgs']),
    ([ROBOT], ['rclpy', 'cv2', 'sensor_msgs', 'numpy', 'matplotlib'])], ids=['images', 'robots'])
@pytest.mark.parametrize('forgotten', ['no module', 'opencv_tools'])
def test_pure_modules_without_ros_and_opencv(
        forgotten: str, rooms: list[str], others: list[str]) -> None:
    modules = [name for room in rooms for name in modules_of(room)]
    # In the thorough case each comes first once, whatever others have imported. There is no circle
    # of imports, so this finds little more.
    script = ('import importlib, sys\n'
              f'sys.modules.update(dict.fromkeys({others}))\n'
              f'for module in {modules}:\n'
              '    for name in [*sys.modules]:\n'
              f'        if name.startswith("{forgotten}"): del sys.modules[name]\n'
              '    try: importlib.import_module(module)\n'
              '    except Exception as err: print(f"{module}: {err!r}")\n')
    finished = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True,
        timeout=LONGEST_SECONDS, check=False)
    assert (finished.returncode, finished.stdout, finished.stderr) == (0, '', '')


@pytest.mark.process
def test_imports_without_optional_libraries() -> None:
    script = ('import importlib, sys\n'
              'sys.modules.update(dict.fromkeys(("av", "lz4", "mcap", "zstandard")))\n'
              f'for module in {MODULES}: importlib.import_module(module)\n')
    finished = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True,
        timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr


@pytest.mark.process
def test_img_convert_without_ros(tmp_path: Path) -> None:
    script = ('import sys; sys.modules.update(dict.fromkeys(("rclpy", "sensor_msgs", "mcap")))\n'
              'from opencv_tools.convert.cli import main\n'
              'sys.exit(main(["pattern:64x48", sys.argv[1], "--stop", "3"]))')
    finished = subprocess.run([sys.executable, '-c', script, tmp_path / '{seq}.png'],
                              capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    assert len(list(tmp_path.glob('*.png'))) == 3


@pytest.mark.process
def test_conversion_without_optional_modules() -> None:
    slow = ('numpy', 'matplotlib', 'xacro', 'yaml', 'rclpy', 'cv2', 'sensor_msgs')
    blocked = (f'import sys; sys.modules.update(dict.fromkeys({slow})); '
               'from opencv_tools.robot.cli import urdf_to_sdf; '
               'sys.exit(urdf_to_sdf(["-", "--report", "/dev/null"]))')
    finished = subprocess.run(
        [sys.executable, '-c', blocked], input='<robot name="a"><link name="b"/></robot>',
        capture_output=True, text=True, timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr
    assert '<link name="b"' in finished.stdout


@pytest.mark.process
def test_cv_bridge_imports_no_opencv_and_no_rclpy() -> None:
    blocked = ('import sys; sys.modules.update(cv2=None); import opencv_tools.cv_bridge; '
               'assert "rclpy" not in sys.modules')
    finished = subprocess.run(
        [sys.executable, '-c', blocked], capture_output=True, text=True,
        timeout=LONGEST_SECONDS, check=False)
    assert finished.returncode == 0, finished.stderr


@pytest.mark.process
def test_cv_bridge_error_without_opencv() -> None:
    script = ('import sys; sys.modules.update(cv2=None); import numpy as np; '
              'from opencv_tools.cv_bridge import CvBridge, CvBridgeError\n'
              'bridge = CvBridge(); image = np.zeros((2, 2, 3), np.uint8)\n'
              'bridge.imgmsg_to_cv2(bridge.cv2_to_imgmsg(image, "bgr8"), "mono8")\n'
              'try: bridge.cv2_to_compressed_imgmsg(image)\n'
              'except CvBridgeError as err: print(err)')
    finished = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True,
        timeout=LONGEST_SECONDS, check=True)
    assert finished.stdout.startswith('compressed images and colormaps need OpenCV')
