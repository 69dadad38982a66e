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

"""Tokens, hosts and origins."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
import re
import socket

from opencv_tools.viewer.access import (
    Access, check_origin, check_origins, check_token, is_loopback, is_same_origin, local_names,
    names_of)
from opencv_tools.viewer.errors import RequestError, WrongTokenError
import pytest


@pytest.mark.parametrize(('address', 'expected'), [
    ('127.0.0.1', True), ('127.1.2.3', True), ('::1', True), ('localhost', True),
    ('0.0.0.0', False), ('::', False), ('192.168.0.7', False), ('robot', False)])
def test_loopback_addresses(address: str, expected: bool) -> None:
    assert is_loopback(address) is expected


def test_token_is_created_where_others_can_reach_the_server() -> None:
    assert Access.create('auto', '127.0.0.1', False, '').token == ''
    tokens = {Access.create('auto', address, control, '').token
              for address, control in (('0.0.0.0', False), ('127.0.0.1', True)) * 2}
    assert len(tokens) == 4  # a new one for each start
    for token in tokens:
        check_token(token)
        assert re.fullmatch(r'[\w-]{24}', token)  # 144 bits


def test_own_token_and_no_token() -> None:
    assert Access.create('secret_text', '127.0.0.1', False, '').token == 'secret_text'
    assert Access.create('', '0.0.0.0', False, '').token == ''
    for text in ('', 'auto', 'a' * 8, 'a' * 200, 'AZaz09_.~-'):
        check_token(text)


@pytest.mark.parametrize('text', ['a' * 7, 'with blank', 'a' * 201, 'per%cent', 'läuft_nicht'])
def test_invalid_tokens(text: str) -> None:
    with pytest.raises(ValueError, match=(
            r'^give 8 to 200 letters, digits or - _ \. ~, an empty text or auto$')):
        check_token(text)


def test_rules_that_do_not_change() -> None:
    rules = Access('secret_text', ())
    assert (rules.origins, rules.is_kept) == ((), False)
    with pytest.raises(FrozenInstanceError):
        rules.token = ''  # type: ignore[misc]
    assert not Access.create('auto', '0.0.0.0', True, '').is_kept
    assert Access.create('auto', '0.0.0.0', True, '', is_kept=True).is_kept


def test_names_in_parameters() -> None:
    assert names_of(' Robot.Local,,vm , ') == {'robot.local', 'vm'}
    assert names_of('') == frozenset()


def test_names_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('socket.gethostname', lambda: 'Robot.Example.org')
    assert local_names() == {'localhost', 'robot.example.org', 'robot', 'robot.local'}
    assert Access.create('', '0.0.0.0', False, 'VM').hosts == {*local_names(), 'vm'}


@pytest.mark.parametrize('given', [(None, None, ''), ('', '', '')])
def test_missing_token(given: tuple[str | None, ...]) -> None:
    with pytest.raises(RequestError, match='a token is needed') as caught:
        Access('secret_text', ()).check_token(*given)
    assert caught.value.status == 403
    assert not isinstance(caught.value, WrongTokenError)


@pytest.mark.parametrize('given', [
    ('secret_tex', None, ''), ('secret_text2', None, ''),
    ('SECRET_TEXT', None, ''), ('secret_text\0', None, ''), ('\ud800', None, '')])
def test_wrong_tokens_are_refused(given: tuple[str | None, ...]) -> None:
    with pytest.raises(WrongTokenError, match='the token is wrong') as caught:
        Access('secret_text', ()).check_token(*given)
    assert caught.value.status == 403


def test_one_right_token_is_enough() -> None:
    access = Access('secret_text', ())
    access.check_token(None, 'secret_text', '')
    access.check_token('old_cookie', None, 'secret_text')
    Access('', ()).check_token(None)


@pytest.mark.parametrize('host', [
    'localhost', 'localhost:8080', 'LOCALHOST:8080', 'localhost.:80', '127.0.0.1:8080',
    '192.168.0.7', '[::1]:8080', '[fe80::1]', 'robot.example.org', socket.gethostname(),
    f'{socket.gethostname().partition(".")[0]}.local:8080'])
def test_allowed_hosts(host: str) -> None:
    Access.create('', '0.0.0.0', False, ' Robot.Example.org, other').check_host(host)


@pytest.mark.parametrize('host', [
    '', 'evil.example', 'localhost.evil.example:8080', 'localhost@evil.example',
    'evil.example@localhost', 'localhost:80:80', 'localhost/', 'localhost; x', '[::1',
    '127.0.0.1.evil.example', '1.2.3.4.5', 'a' * 300])
def test_foreign_hosts_are_refused(host: str) -> None:
    with pytest.raises(RequestError, match='not a name of this machine') as caught:
        Access.create('', '127.0.0.1', False, '').check_host(host)
    assert caught.value.status == 403


def test_error_of_a_long_host() -> None:
    with pytest.raises(RequestError) as caught:
        Access('', ()).check_host('A' * 81)
    assert str(caught.value) == (
        f"the host '{'a' * 80}' is not a name of this machine: use its address, or add the name "
        'to the parameter allowed_hosts')


@pytest.mark.parametrize('host', ['vm.lan', 'robot.tailnet.ts.net:8080', 'evil.example'])
def test_any_host_with_a_token(host: str) -> None:
    Access.create('secret_text', '0.0.0.0', False, '').check_host(host)


@pytest.mark.parametrize('host', ['', 'localhost; script-src *', 'a b', '[::1'])
def test_invalid_hosts_with_a_token(host: str) -> None:
    with pytest.raises(RequestError, match='not a name of this machine'):
        Access.create('secret_text', '0.0.0.0', False, '').check_host(host)


@pytest.mark.parametrize(('origin', 'referer', 'expected'), [
    ('http://10.0.0.5:3000', None, 'http://10.0.0.5:3000'),
    (None, 'http://10.0.0.5:3000/page?a=b', 'http://10.0.0.5:3000'),
    (None, 'http://10.0.0.5:3000', 'http://10.0.0.5:3000'),
    ('https://ui.example', None, 'https://ui.example'),
    ('http://evil.example', 'http://10.0.0.5:3000/', ''), ('http://10.0.0.5:3001', None, ''),
    ('http://10.0.0.5:30000', None, ''), (None, 'http://10.0.0.5:3000.evil.example/', ''),
    ('null', None, ''), ('', '', ''), (None, None, '')])
def test_origins_that_may_show_pictures(
        origin: str | None, referer: str | None, expected: str) -> None:
    access = Access.create(
        '', '0.0.0.0', False, '', 'http://10.0.0.5:3000, HTTPS://ui.example')
    assert access.embedding_origin(origin, referer) == expected
    assert Access.create('', '0.0.0.0', False, '').embedding_origin(origin, referer) == ''


@pytest.mark.parametrize('text', ['*', '10.0.0.5:3000', 'http://a/', 'http://a,b', 'http://a b'])
def test_invalid_origins(text: str) -> None:
    with pytest.raises(ValueError, match='is not an origin: give the beginning'):
        check_origins(text)


@pytest.mark.parametrize(('origin', 'host', 'expected'), [
    (None, 'localhost:8080', True), ('http://localhost:8080', 'localhost:8080', True),
    ('https://Robot:1', 'robot:1', True), ('http://localhost:8081', 'localhost:8080', False),
    ('http://evil.example', 'localhost:8080', False), ('null', 'localhost:8080', False),
    ('', 'localhost:8080', False), ('http://[', 'localhost:8080', False)])
def test_origins(origin: str | None, host: str, expected: bool) -> None:
    assert is_same_origin(origin, host) is expected


def test_origins_without_an_address() -> None:
    check_origin('http://localhost:8080')
    check_origin('null')
    for origin in ('http://[', f'http://[{"a" * 80}'):
        with pytest.raises(RequestError) as caught:
            check_origin(origin)
        assert str(caught.value) == (
            f'the origin {origin[:80]!r} is not an address: Invalid IPv6 URL')
        assert caught.value.status == 403
