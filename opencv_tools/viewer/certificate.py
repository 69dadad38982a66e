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

"""The certificate of the server, which may be created once."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
import datetime
import hashlib
from importlib import import_module
import ipaddress
import os
from pathlib import Path
import re
import shutil
import ssl
import stat
import subprocess
import tempfile
import time

from opencv_tools.viewer.errors import ViewerError

#: Value of ``certificate`` for a certificate that the node creates.
AUTOMATIC_CERTIFICATE = 'auto'
_FILE = 'img_viewer_certificate.pem'
# Browsers refuse certificates for longer times. A new one follows before the end.
_DAYS, _USED_DAYS = 820, 800
_DAY = 24 * 3600
_OTHERS = 0o077  # permissions of other users
_MAX_BYTES = 100_000
_OPENSSL_SECONDS = 60
_CERTIFICATE = re.compile('-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----', re.DOTALL)
_HOST = re.compile(r'[A-Za-z0-9_.-]{1,63}')


@dataclass(frozen=True)
class Tls:
    """
    Encryption of the server.

    :param context: context with the certificate.
    :param fingerprint: SHA-256 of a created certificate, as browsers show it; '' for another one.
    """

    context: ssl.SSLContext
    fingerprint: str = ''


def load_tls(certificate: str, key: str, hosts: list[str]) -> Tls | None:
    """
    Load the certificate.

    :param certificate: file in PEM format, ``auto`` to create one, or '' for no encryption.
    :param key: file with the private key; '' if the certificate file has it.
    :param hosts: names and addresses of this machine, for a created certificate.
    :raises ViewerError: the files cannot be used, or no certificate can be created.
    """
    if not certificate:
        return None
    if certificate != AUTOMATIC_CERTIFICATE:
        return Tls(_context(certificate, key))
    path = Path(os.environ.get('ROS_HOME') or Path('~/.ros').expanduser()) / _FILE
    try:
        text = _kept(path) or _create(path, hosts)
        found = _CERTIFICATE.search(text)
        if not found:
            raise ValueError('it has no certificate; remove it for a new one')
        digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(found[0])).hexdigest().upper()
    except (OSError, ValueError, RuntimeError) as err:
        reason = err.strerror if isinstance(err, OSError) else err
        raise ViewerError(f'certificate {str(path)!r} cannot be used: {reason}; or set '
                          'certificate to a file with your own') from err
    pairs = (digest[place:place + 2] for place in range(0, len(digest), 2))
    return Tls(_context(str(path), ''), ':'.join(pairs))


def _kept(path: Path) -> str:
    """Return the content of the file of an earlier start; '' if it is missing or too old."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return ''
    with os.fdopen(descriptor, 'rb') as file:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode) or state.st_uid != os.geteuid():
            raise ValueError('it is not a regular file of this user; remove it for a new one')
        if stat.S_IMODE(state.st_mode) & _OTHERS:
            raise ValueError(f'others can read it (mode {stat.S_IMODE(state.st_mode):o}); remove '
                             'it for a new one')
        if time.time() - state.st_mtime > _USED_DAYS * _DAY:
            return ''
        return file.read(_MAX_BYTES).decode(errors='replace')


def _create(path: Path, hosts: list[str]) -> str:
    """Create the file, which only its owner can read, and return its content."""
    names = [name for name in dict.fromkeys(['localhost', *hosts]) if _HOST.fullmatch(name)
             and not is_address(name)]
    addresses = [*filter(is_address, dict.fromkeys(['127.0.0.1', '::1', *hosts]))]
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        content = _create_with_library(names, addresses)
    except ImportError:
        content = _create_with_openssl(names, addresses)
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f'{_FILE}.')  # of mode 600
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, 'w') as file:
            file.write(content)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    return content


def _create_with_library(names: list[str], addresses: list[str]) -> str:
    # The library is optional.
    x509, ec, hashes, serialization = (import_module(f'cryptography.{name}') for name in (
        'x509', 'hazmat.primitives.asymmetric.ec', 'hazmat.primitives.hashes',
        'hazmat.primitives.serialization'))
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, 'img_viewer')])
    now = datetime.datetime.now(datetime.timezone.utc)
    days = datetime.timedelta(days=1)
    certificate = x509.CertificateBuilder(
        subject, subject, key.public_key(), x509.random_serial_number(), now - days,
        now + _DAYS * days,
    ).add_extension(x509.SubjectAlternativeName([
        *map(x509.DNSName, names),
        *(x509.IPAddress(ipaddress.ip_address(address)) for address in addresses)]), False,
    ).add_extension(x509.BasicConstraints(False, None), True).sign(key, hashes.SHA256())
    pem = serialization.Encoding.PEM
    content: bytes = certificate.public_bytes(pem) + key.private_bytes(
        pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return content.decode()


def _create_with_openssl(names: list[str], addresses: list[str]) -> str:
    program = shutil.which('openssl')
    if program is None:
        raise RuntimeError('it needs the library cryptography or the program openssl: install '
                           'python3-cryptography or openssl')
    others = ','.join([*(f'DNS:{name}' for name in names),
                       *(f'IP:{address}' for address in addresses)])
    try:
        created = subprocess.run(
            [program, 'req', '-x509', '-nodes', '-subj', '/CN=img_viewer', '-days', str(_DAYS),
             '-newkey', 'ec', '-pkeyopt', 'ec_paramgen_curve:prime256v1', '-addext',
             f'subjectAltName={others}', '-addext', 'basicConstraints=critical,CA:FALSE',
             '-keyout', '-', '-out', '-'],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_OPENSSL_SECONDS,
            check=True)
    except subprocess.SubprocessError as err:
        raise RuntimeError(f'{program} has failed: {err}') from err
    return created.stdout


def is_address(name: str) -> bool:
    """Return whether a name is an address of IPv4 or IPv6; one with a zone is none."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return '%' not in name


def _context(certificate: str, key: str) -> ssl.SSLContext:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key or None, lambda: '')
    except (OSError, ValueError) as err:
        reason = _missing_pem(certificate, key) or err
        raise ViewerError(f'certificate {certificate} and key {key or certificate} cannot be '
                          f'used: {reason}') from err
    return context


def _missing_pem(certificate: str, key: str) -> str:
    """Return which part of the certificate its files lack, and the remedy; '' if none."""
    for name, path, part in (('certificate', certificate, 'certificate'),
                             ('key', key or certificate, 'private key')):
        with suppress(OSError):
            file = Path(path)  # a pipe was emptied by the first reader
            if file.is_file() and f'{part.upper()}-----'.encode() not in file.read_bytes():
                return f'{path} has no {part} in PEM format; set {name} to a file that has one'
    return ''
