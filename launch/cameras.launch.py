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

"""Start one publisher and, if wanted, one recorder per camera, in a namespace with its name."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from opencv_tools.nodes.command_line import check_params_file


def parse_cameras(text: str) -> dict[str, str]:
    """
    Read a list ``NAME=SOURCE NAME=SOURCE ...``.

    :raises ValueError: the text has another form, or two cameras have the same name.
    """
    pairs = [word.partition('=')[::2] for word in text.split()]
    cameras = dict(pairs)
    if not pairs or len(cameras) < len(pairs) or '' in {*cameras, *cameras.values()}:
        raise ValueError(f'cameras is {text!r}: give each camera a unique name and a source, '
                         "as in cameras:='front=0 rear=/dev/v4l/by-id/usb-rear-video-index0'")
    return cameras


def start_nodes(context: LaunchContext) -> list[Node]:
    """
    Create the nodes of each camera, with the parameters of the files.

    :raises ValueError: ``cameras`` is malformed, or a parameter file does not exist.
    """
    files = given_file(context, 'params_file')
    cameras = parse_cameras(LaunchConfiguration('cameras').perform(context))
    publishers = [
        Node(package='opencv_tools', executable='img_publisher', name='image_publisher',
             namespace=name, output='screen',
             parameters=[{'frame_id': name}, *files,
                         {'source': ParameterValue(source, value_type=str)}])
        for name, source in cameras.items()]
    if LaunchConfiguration('record').perform(context) == 'false':
        return publishers
    files = given_file(context, 'recorder_params_file')
    folder = Path(LaunchConfiguration('output_dir').perform(context))
    return [*publishers, *(
        Node(package='opencv_tools', executable='img_subscriber', name='image_subscriber',
             namespace=name, output='screen',
             parameters=[{'file_name': ParameterValue(f'{name}.mcap', value_type=str)}, *files,
                         {'output_dir': ParameterValue(str(folder / name), value_type=str)}])
        for name in cameras)]


def given_file(context: LaunchContext, argument: str) -> list[str]:
    """
    Return the parameter file of an argument as a list, which is empty without one.

    :raises ValueError: the file does not exist.
    """
    file = LaunchConfiguration(argument).perform(context)
    if file:
        check_params_file(file)
    return [file] if file else []


def generate_launch_description() -> LaunchDescription:
    """Return the launch description: arguments and nodes."""
    return LaunchDescription([
        DeclareLaunchArgument('cameras', description='NAME=SOURCE for each camera, separated by '
                              'spaces; NAME is the namespace, and the frame_id unless the '
                              'parameter file sets it'),
        DeclareLaunchArgument('params_file', default_value='',
                              description='YAML file with parameters of the publishers, for all '
                              '(/**/image_publisher) or for one (/front/image_publisher)'),
        DeclareLaunchArgument('record', default_value='false', choices=['false', 'true'],
                              description='Whether to record each camera to a bag'),
        DeclareLaunchArgument('output_dir', default_value='bags',
                              description='Folder of the recordings; each camera has a folder in '
                              'it with the name of the camera'),
        DeclareLaunchArgument('recorder_params_file', default_value='',
                              description='YAML file with parameters of the recorders, for all '
                              '(/**/image_subscriber) or for one (/front/image_subscriber)'),
        OpaqueFunction(function=start_nodes),
    ])
