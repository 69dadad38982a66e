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

"""The certificate that the viewer creates."""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import ssl
import sys
import time

from opencv_tools.viewer import certificate as certificate_module
from opencv_tools.viewer.certificate import load_tls
from opencv_tools.viewer.errors import ViewerError
import pytest

HOSTS = ['robot', 'robot', '10.1.2.3', 'bad name', 'a,DNS:evil', '-subj', 'fe80::1%eth0']
needs_openssl = pytest.mark.skipif(not shutil.which('openssl'), reason='openssl is not installed')


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the path of the file in an empty home of ROS."""
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'ros'))
    return tmp_path / 'ros' / 'img_viewer_certificate.pem'


def valid_names(path: Path) -> list[tuple[str, str]]:
    """Return the names for which a certificate is valid."""
    found = ssl._ssl._test_decode_cert(str(path))['subjectAltName']  # type: ignore[attr-defined]
    return [*found]


@needs_openssl
@pytest.mark.parametrize('has_library', [False, True])
def test_certificate_is_created_once(
        has_library: bool, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if has_library:
        pytest.importorskip('cryptography')  # an installed ROS may have none
    else:
        monkeypatch.setitem(sys.modules, 'cryptography.x509', None)
    first, second = (load_tls('auto', '', HOSTS) for _ in range(2))
    assert first
    assert second
    assert first.fingerprint == second.fingerprint
    assert len(first.fingerprint.split(':')) == 32
    assert file.stat().st_mode & 0o777 == 0o600
    assert [*file.parent.iterdir()] == [file]
    assert valid_names(file) == [
        ('DNS', 'localhost'), ('DNS', 'robot'), ('DNS', '-subj'), ('IP Address', '127.0.0.1'),
        ('IP Address', '0:0:0:0:0:0:0:1'), ('IP Address', '10.1.2.3')]


@needs_openssl
def test_old_certificate_is_replaced(file: Path) -> None:
    first = load_tls('auto', '', [])
    old = time.time() - 801 * 24 * 3600
    os.utime(file, (old, old))
    second = load_tls('auto', '', [])
    assert first
    assert second
    assert first.fingerprint != second.fingerprint


@needs_openssl
def test_certificate_that_others_can_read(file: Path) -> None:
    load_tls('auto', '', [])
    file.chmod(0o640)
    with pytest.raises(ViewerError, match=r'others can read it \(mode 640\)'):
        load_tls('auto', '', [])


def test_file_that_is_no_certificate(file: Path) -> None:
    file.parent.mkdir()
    file.touch(0o600)
    file.write_text('-----BEGIN CERTIFICATE-----\n!\n-----END CERTIFICATE-----\n')
    with pytest.raises(ViewerError, match='img_viewer_certificate'):
        load_tls('auto', '', [])


def test_folder_in_place_of_the_certificate(file: Path) -> None:
    file.mkdir(parents=True)
    with pytest.raises(ViewerError, match='Is a directory'):
        load_tls('auto', '', [])


def test_certificate_without_library_and_program(
        file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'cryptography.x509', None)
    monkeypatch.setattr(certificate_module.shutil, 'which', lambda _: None)
    with pytest.raises(ViewerError, match='library cryptography or the program openssl'):
        load_tls('auto', '', [])
    assert not file.exists()
