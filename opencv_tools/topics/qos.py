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

"""Quality of service of an image topic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from opencv_tools.topics.errors import ParameterError
from opencv_tools.topics.events import destroyable
from rcl_interfaces.msg import SetParametersResult
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy, HistoryPolicy, qos_check_compatible, QoSCompatibility, QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

#: Number of frames that a publisher keeps for slow subscribers.
FRAME_DEPTH = 10
_MAX_DEPTH = 10_000


def following_qos(offers: Sequence[QoSProfile], depth: int | None) -> QoSProfile:
    """
    Return the profile that requests as much as all publishers offer.

    :param offers: profiles of the publishers; without any, the result is reliable and volatile.
    :param depth: number of newest frames to keep; None to keep every frame, of which Fast DDS
        keeps at most 5000. Fast DDS never frees memory that kept frames have used.
    :returns: profile of the subscription.
    """
    reliable = all(offer.reliability != ReliabilityPolicy.BEST_EFFORT for offer in offers)
    # Older messages are sent again only to subscriptions that are transient local.
    latched = bool(offers) and reliable and all(
        offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if depth is None else HistoryPolicy.KEEP_LAST,
        depth=FRAME_DEPTH if depth is None else depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)


def qos_mismatch(offer: QoSProfile, request: QoSProfile) -> str:
    """
    Return why a subscription receives nothing from a publisher.

    :returns: names of the incompatible policies, '' if all are compatible.
    """
    compatibility, reason = qos_check_compatible(offer, request)
    if compatibility != QoSCompatibility.ERROR:
        return ''
    return str(reason).replace('ERROR: ', '').rstrip(';').lower()


def describe_qos(qos: QoSProfile) -> str:
    """Return the policies of a subscription that depend on its publishers, in a few words."""
    is_latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return (('best effort' if qos.reliability == ReliabilityPolicy.BEST_EFFORT else 'reliable')
            + (', transient local' if is_latched else ''))


def create_frame_publisher(
    node: Node, message_type: Any, topic: str, *, depth: int = FRAME_DEPTH,
    events: PublisherEventCallbacks | None = None,
) -> Publisher:
    """
    Create a reliable publisher; parameters may override history, depth and reliability.

    :param depth: number of messages that slow subscribers may receive later.
    :param events: callbacks for events of subscribers.
    :returns: the publisher.
    :raises ParameterError: the ``qos_overrides`` parameters of the topic cannot be used.
    """
    qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)
    options = QoSOverridingOptions.with_default_policies(callback=_check_depth)
    try:
        return destroyable(node.create_publisher(
            message_type, topic, qos, event_callbacks=events, qos_overriding_options=options))
    except (InvalidQosOverridesError, RuntimeError) as err:
        raise ParameterError(f'{topic} cannot be published: {err}') from err


def _check_depth(qos: QoSProfile) -> SetParametersResult:
    if 0 <= qos.depth <= _MAX_DEPTH:
        return SetParametersResult(successful=True)
    return SetParametersResult(
        reason=f'depth is {qos.depth}: give a number from 0 to {_MAX_DEPTH}')
