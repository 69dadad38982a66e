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

"""Parameters of ``img_viewer``."""

from __future__ import annotations

from dataclasses import dataclass

from opencv_tools.nodes.parameters import parameter, parameter_table, rate_parameter
from opencv_tools.nodes.settings import NodeSettings
from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.topic_discovery import TRANSPORTS
from opencv_tools.viewer.access import AUTOMATIC, check_origins, check_token
from opencv_tools.viewer.certificate import AUTOMATIC_CERTIFICATE


def _check_address(text: str) -> None:
    if not text:
        raise ValueError('set it to an address, 0.0.0.0 for all addresses of this machine')


@dataclass(frozen=True, kw_only=True)
class ViewerSettings(NodeSettings):
    """Values of the parameters of ``img_viewer``, in the order of ``--help``."""

    port: int = parameter(
        8080, 'TCP port of the page; 0 for any free port', bounds=(0, 65535))
    address: str = parameter(
        '127.0.0.1', 'Address to listen on; only programs of this machine reach 127.0.0.1, and '
        '0.0.0.0 stands for all addresses of this machine', check=_check_address)
    token: str = parameter(
        'auto', 'Secret text that a browser needs; auto creates one for other addresses than '
        'those of this machine, and empty lets everybody look', check=check_token, secret=True)
    token_file: str = parameter(
        '', 'File that keeps the token over restarts; it is created if it is missing, and only '
        'its owner may read it')
    width: int = parameter(
        0, 'Maximum width of the pictures in pixels; 0 for no limit', bounds=(0, 65535))
    quality: int = parameter(
        80, 'JPEG quality of the pictures, from 1 (smallest) to 100 (best); a slow link lowers it',
        bounds=(1, 100))
    rate: float = rate_parameter(
        30.0, 'Maximum rate of the pictures of a topic in Hz', 240, or_zero=False)
    topics: str = parameter(
        '', 'Image topics to show, separated by commas, with * for any text; empty for all')
    transport: str = parameter(
        'auto', 'Image transport to subscribe to; auto prefers compressed images',
        choices=tuple(TRANSPORTS))
    video: str = parameter(
        'auto', 'Whether pages get video that their browser decodes; auto passes video topics on, '
        'and always encodes images too', choices=('auto', 'never', 'always'))
    viewers: int = parameter(
        32, 'Maximum number of open pages and streams', bounds=(1, 1000))
    history_bytes: int = parameter(
        2**28, 'Bytes of the messages of the last 10 s that the node keeps of the topics that '
        'pages show alone, for all pages together; 0 keeps none', bounds=(0, 2**40))
    allowed_hosts: str = parameter(
        '', 'Names of this machine in a browser beside its own, separated by commas')
    allowed_origins: str = parameter(
        '', 'Origins of other pages that may show /stream and /snapshot, separated by commas, '
        'such as http://192.168.1.5:3000', check=check_origins)
    certificate: str = parameter(
        '', 'File with the certificate for https, in PEM format; auto creates one, and empty is '
        'for http')
    key: str = parameter(
        '', 'File with the private key of the certificate, in PEM format; empty if the '
        'certificate file has it')
    control: bool = parameter(
        False, 'Whether a page can change the parameters of cameras, pause them and save frames; '
        'a token is always needed')
    record_dir: str = parameter(
        '', 'Folder of the bags that a page with control records, created if it does not exist; '
        'empty for no recordings')
    record_download: bool = parameter(
        True, 'Whether a page can download the bag that it has recorded last')

    def __post_init__(self) -> None:
        """
        Check values that depend on each other.

        :raises ParameterError: the values contradict each other.
        """
        if self.control and not self.token:
            raise ParameterError(
                "control is true and token is '': set token to auto or to a secret text, because "
                'everybody could change the cameras')
        if self.record_dir and not self.control:
            raise ParameterError(
                f'record_dir is {self.record_dir!r}, but control is false: set control to true, '
                'because only pages with control record')
        if self.token_file and self.token != AUTOMATIC:
            raise ParameterError(
                f'token_file is {self.token_file!r}, but token is set as well: set only one')
        if self.key and not self.certificate:
            raise ParameterError(
                f'key is {self.key!r}, but certificate is empty: set certificate as well')
        if self.key and self.certificate == AUTOMATIC_CERTIFICATE:
            raise ParameterError(
                f'key is {self.key!r}, but certificate is auto, which has its own: set only one')

    @property
    def shown_video(self) -> str:
        """Value of ``video`` for the pages; with ``width`` it is never, as video is not scaled."""
        return 'never' if self.width else self.video

    @property
    def patterns(self) -> tuple[str, ...]:
        """Patterns of topic names in ``topics``."""
        names = [name.strip() for name in self.topics.split(',') if name.strip()]
        return tuple(name if name.startswith(('/', '*')) else f'/{name}' for name in names)


#: Parameters of ``img_viewer``.
PARAMETERS = parameter_table(ViewerSettings)
