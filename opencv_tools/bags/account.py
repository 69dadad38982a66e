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

"""The metadata records of recorded bags: which recording, and what became of its messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
import json

#: Name of the records.
NAME = 'opencv_tools'
RECORDING, REPEATED, ACCOUNT, UNKNOWN = 'recording', 'repeated', 'account', 'unknown'
WRITTEN = 'written'
_KILLED = 'losses: the recorder was killed or the disk was full'
_RECORD_BYTES, _TOPIC_BYTES = 100, 220  # the latter with all counts of a topic

# Name and contents of a record.
Metadata = tuple[str, Mapping[str, str]]
# Number of messages of each topic, by what became of them.
Counts = Mapping[str, Mapping[str, int]]


def begin_record(recording: str, repeated: Mapping[str, int]) -> Metadata:
    """
    Return the record at the begin of a file.

    :param recording: identifier that all files of the recording have.
    :param repeated: number of latched messages of each topic that an earlier file has too.
    """
    return NAME, {RECORDING: recording} | (
        {REPEATED: json.dumps(repeated)} if repeated else {})


def account_record(counts: Counts, is_known: bool = True) -> Metadata:
    """Return the record at the end of a file; zeros are left out, but not those of written."""
    kept = {topic: {name: count for name, count in sorted(of.items()) if count or name == WRITTEN}
            for topic, of in sorted(counts.items()) if any(of.values())}
    return NAME, {ACCOUNT: json.dumps(kept)} | ({} if is_known else {UNKNOWN: _KILLED})


def account_bytes(topics: Sequence[str]) -> int:
    """Return the largest size in bytes of an account of some topics, with its index."""
    return _RECORD_BYTES + sum(_TOPIC_BYTES + len(json.dumps(topic)) for topic in topics)


def recording_of(metadata: Sequence[Metadata]) -> str:
    """Return the identifier of the recording in the records of a file; '' if there is none."""
    return _text(metadata, RECORDING)


def repeated_counts(metadata: Sequence[Metadata]) -> dict[str, int]:
    """Return the number of repeated messages of each topic, of a file of this package."""
    try:
        found = json.loads(_text(metadata, REPEATED))
    except (ValueError, RecursionError):  # no text, or of another program
        return {}
    return {topic: count for topic, count in found.items() if isinstance(count, int)} if (
        isinstance(found, dict)) else {}


def has_account(metadata: Sequence[Metadata]) -> bool:
    """Return whether the records of a file have an account."""
    return any(name == NAME and ACCOUNT in values for name, values in metadata)


class Losses:
    """The messages that no file has, by topic; each file has those since the one before."""

    def __init__(self) -> None:
        #: Returns all counts until now; None for a copy, which has the account of its source.
        self.read: Callable[[], Counts] | None = None
        self._stored: dict[str, Counter[str]] = {}

    def account(self, written: Counter[str], repeated: Counter[str]) -> Counts:
        """Return the account of a file."""
        found = {topic: Counter(of) - self._stored.get(topic, Counter[str]())
                 for topic, of in (self.read() if self.read else {}).items()}
        for topic in written | repeated:
            found.setdefault(topic, Counter()).update(
                {WRITTEN: written[topic], REPEATED: repeated[topic]})
        return found

    @property
    def warning(self) -> str:
        """Sentence about losses that no file has in its account; '' for none."""
        count = sum(sum(of.values()) for of in self.account(Counter(), Counter()).values())
        return '' if count <= 0 else (
            f'the bags do not have the last {count} losses in their accounts, because no bag was '
            'written after them; the summary has all')

    def store(self, account: Counts) -> None:
        """Note that the account of a file is complete in it."""
        for topic, of in account.items():
            self._stored.setdefault(topic, Counter()).update(of)


def _text(metadata: Sequence[Metadata], key: str) -> str:
    """Return the first text with a key in the records of this package; '' if there is none."""
    return next((values[key] for name, values in metadata if name == NAME and key in values), '')
