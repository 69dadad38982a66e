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

"""Start one publisher per camera, each in a namespace with the name of the camera."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from opencv_tools.ros.command_line import check_params_file


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
    Create a publisher for each camera, with its source and the parameters of the file.

    :raises ValueError: ``cameras`` is malformed, or the parameter file does not exist.
    """
    params_file = LaunchConfiguration('params_file').perform(context)
    if params_file:
        check_params_file(params_file)
    cameras = parse_cameras(LaunchConfiguration('cameras').perform(context))
    return [
        Node(package='opencv_tools', executable='img_publisher', name='image_publisher',
             namespace=name, output='screen',
             parameters=[{'frame_id': name}, *([params_file] if params_file else []),
                         {'source': ParameterValue(source, value_type=str)}])
        for name, source in cameras.items()]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description: arguments and nodes."""
    return LaunchDescription([
        DeclareLaunchArgument('cameras', description='NAME=SOURCE for each camera, separated by '
                              'spaces; NAME is the namespace, and the frame_id unless the '
                              'parameter file sets it'),
        DeclareLaunchArgument('params_file', default_value='',
                              description='YAML file with parameters of the publishers, for all '
                              '(/**/image_publisher) or for one (/front/image_publisher)'),
        OpaqueFunction(function=start_nodes),
    ])
