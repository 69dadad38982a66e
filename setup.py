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

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

package_name = 'opencv_tools'
extras = ('images', 'video', 'bags', 'datasets', 'viewer', 'robots', 'memory')


def requirements(name):
    """Return what requirements/NAME.txt and the files that it includes name."""
    found = []
    for line in Path('requirements', f'{name}.txt').read_text().splitlines():
        word = line.partition('#')[0].strip()
        if word.startswith('-r '):
            found += requirements(word[3:].removesuffix('.txt'))
        elif word:
            found.append(word)
    return found


setup(
    name=package_name,
    version='0.3.0',
    packages=find_packages(exclude=['test']),
    package_data={package_name: ['py.typed', 'message_types/msg/*/*', 'nodes/help/*.txt',
                                 'robot/*/*.txt', 'robot/view/page/*',
                                 'viewer/page/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/launch', glob('launch/*.launch.py')),
        (f'share/{package_name}/config', glob('config/*.yaml')),
        (f'share/{package_name}/urdf', glob('urdf/*')),
        (f'share/{package_name}/sdf/my_arm', glob('sdf/my_arm/*')),
        (f'share/{package_name}/sdf/my_robot', glob('sdf/my_robot/*')),
        (f'share/{package_name}/meshes/my_robot', glob('meshes/my_robot/*')),
    ],
    python_requires='>=3.10',
    install_requires=requirements('core'),
    extras_require={
        **{name: requirements(name) for name in extras},
        'all': sorted({word for name in extras for word in requirements(name)}),
        # colcon runs pytest, because it stands here.
        'test': ['av', 'hypothesis', 'matplotlib', 'mcap', 'mcap-ros2-support', 'pyarrow',
                 'pytest', 'rosbags', 'tornado>=6.2', 'yourdfpy']},
    zip_safe=True,
    maintainer='opencv_tools maintainers',
    maintainer_email='opencv-tools@example.org',
    description='Publish cameras, videos and images, record image topics, and convert robots '
                'between URDF and SDF',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    keywords=['ROS', 'ROS 2', 'camera', 'images', 'video', 'bag', 'mcap', 'calibration', 'URDF',
              'SDF'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Environment :: Console',
        'Intended Audience :: Developers',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 15)),
        'Topic :: Multimedia :: Video',
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    entry_points={
        'console_scripts': [
            'img_calibrate = opencv_tools.commands:img_calibrate',
            'img_convert = opencv_tools.commands:img_convert',
            'img_filter = opencv_tools.commands:img_filter',
            'img_publisher = opencv_tools.commands:img_publisher',
            'img_subscriber = opencv_tools.commands:img_subscriber',
            'img_viewer = opencv_tools.commands:img_viewer',
            'opencv_tools_info = opencv_tools.commands:opencv_tools_info',
            'robot_compare = opencv_tools.commands:robot_compare',
            'robot_frames = opencv_tools.commands:robot_frames',
            'robot_view = opencv_tools.commands:robot_view',
            'sdf_to_urdf = opencv_tools.commands:sdf_to_urdf',
            'urdf_to_sdf = opencv_tools.commands:urdf_to_sdf',
        ],
    },
)
