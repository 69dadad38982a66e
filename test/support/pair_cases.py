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

"""Cases of frames between two processes: what may differ, and what cannot occur together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pairs import allowed_combinations, covering_array, Part

#: Values of each factor. ``executor`` and ``threaded`` are nodes of `opencv_tools.frames` with
#: the callback there; ``drop`` and ``block`` are img_subscriber with this ``on_overflow``.
FACTORS = {
    'way': ('raw', 'compressed', 'video', 'shared', 'changing'),
    'image': ('array', 'loan'),
    'receiver': ('executor', 'threaded', 'drop', 'block'),
    'frames': ('newest', 'every'),
    'camera_info': ('without', 'with'),
    'callback': ('fast', 'slow', 'raising'),
    'log': ('terminal', 'file'),
    'publisher_end': ('ends', 'killed', 'restarts', 'stopped'),
    'interrupt': ('idle', 'running', 'never'),
    'joins': ('first', 'late'),
}

#: Ways that are transports of their own, and those that change pixels a little.
OWN_TOPICS, LOSSY = ('raw', 'compressed', 'video'), ('compressed', 'video')

#: Pairs that cannot occur, with the reason.
EXCLUDED: dict[Part, str] = {
    **{(('receiver', recorder), value): reason for recorder in ('drop', 'block')
       for value, reason in (
           (('frames', 'newest'), 'img_subscriber records every frame'),
           (('camera_info', 'with'), 'img_subscriber does not wait for a calibration'),
           (('callback', 'raising'), 'img_subscriber has no callback of the user'))},
    (('callback', 'raising'), ('interrupt', 'idle')): 'the exception has ended the node before',
    (('callback', 'fast'), ('interrupt', 'never')): 'only Ctrl-C ends the node',
    (('callback', 'slow'), ('interrupt', 'never')): 'only Ctrl-C ends the node',
}

#: Larger groups of values in which defects were found.
FOUND: tuple[Part, ...] = (
    *((('way', 'shared'), ('receiver', 'executor'), ('callback', 'slow'), ('frames', frames),
       ('camera_info', 'without'), ('publisher_end', 'stopped'), ('interrupt', 'running'))
      for frames in ('newest', 'every')),
    (('way', 'shared'), ('receiver', 'block'), ('callback', 'slow'),
     ('publisher_end', 'stopped'), ('interrupt', 'running')),
    (('way', 'shared'), ('receiver', 'threaded'), ('camera_info', 'with')),
    (('way', 'shared'), ('receiver', 'drop'), ('joins', 'late')),
    (('way', 'changing'), ('receiver', 'drop'), ('log', 'terminal')),
)

ALLOWED = allowed_combinations(FACTORS, EXCLUDED)


@dataclass(frozen=True, kw_only=True)
class Case:
    """
    A publisher, a receiver, and how both end.

    :param way: how frames arrive; ``changing`` goes from shared memory to the image topic and
        back, twice.
    :param image: what is published: an array, or an image that a loan has lent.
    :param receiver: who receives, see ``FACTORS``.
    :param frames: the newest frame, or every frame.
    :param camera_info: whether frames wait for their calibration.
    :param callback: ``slow`` is slower than the camera; a slow recorder encodes large frames.
    :param log: console of the receiver.
    :param publisher_end: what happens to the publisher; ``stopped`` is SIGSTOP for a while.
    :param interrupt: when Ctrl-C is pressed: without frames, or while a callback runs.
    :param joins: whether the receiver gets the first frame, or comes after frames that another one
        has received.
    """

    way: str
    image: str
    receiver: str
    frames: str
    camera_info: str
    callback: str
    log: str
    publisher_end: str
    interrupt: str
    joins: str

    def __str__(self) -> str:
        return '-'.join(vars(self).values())

    @property
    def is_recorder(self) -> bool:
        """Return whether img_subscriber receives."""
        return self.receiver in ('drop', 'block')

    @property
    def transport(self) -> str:
        """Return the value of the option or parameter ``transport``."""
        return self.way if self.way in OWN_TOPICS else 'auto'

    @property
    def status(self) -> int:
        """Return the exit status of the receiver."""
        return int(self.callback == 'raising')

    @property
    def is_shared(self) -> bool:
        """Return whether the last frames of a publisher arrive by shared memory."""
        return self.way in ('shared', 'changing')

    @property
    def may_replace_first(self) -> bool:
        """Return whether frames before the first one of the callback may count as missing."""
        # A late receiver of video may get a packet before its key frame.
        is_late_video = self.way == 'video' and self.joins == 'late'
        return self.receiver == 'threaded' or self.camera_info == 'with' or is_late_video

    def last_counted(self, last: int, published: int, *, is_followed: bool) -> Sequence[int]:
        """
        Return which frame of a publisher may be the last one in the counts of the receiver.

        :param last: number of the last frame of the callback.
        :param published: number of the last published frame.
        :param is_followed: whether the publisher has ended regularly, and another one follows.
        """
        if is_followed and self.is_shared:
            # All frames arrive. Those of the next publisher may replace them in a full queue.
            return (published,)
        is_late = is_followed and (self.receiver, self.callback) == ('threaded', 'slow')
        is_held = self.receiver in ('executor', 'threaded') and self.interrupt != 'idle'
        may_be_replaced = is_late or is_held or self.camera_info == 'with'
        return range(last, published + 1) if may_be_replaced else (last,)


def cases(strength: int, seed: int) -> list[Case]:
    """
    Return cases in which every possible group of values occurs.

    :param strength: number of values of a group.
    :param seed: seed of the choice.
    """
    return [Case(**combination) for combination in covering_array(ALLOWED, strength, seed, FOUND)]
