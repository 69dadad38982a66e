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

"""The nodes and the topics of the graph, as text and for a page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import time
from typing import Any

from opencv_tools.base.text import printable
from opencv_tools.viewer.control import node_names
import rclpy
from rclpy.node import Node

#: Maximum number of topics, and of nodes of a topic, that are listed.
MAX_LISTED = 1000
# Time until the graph is read, time between two readings, and the maximum of readings: nodes of a
# busy machine are discovered over several seconds.
_DISCOVERY_SECONDS = 2.0
_INTERVAL_SECONDS = 1.0
_MAX_READINGS = 9


def read_graph(node: Node) -> dict[str, Any]:
    """
    Return all nodes, and the topics with types, publishers and subscribers, by name.

    As with ``ros2 node list``, nodes whose names begin with ``_`` are hidden.
    """
    topics = sorted(node.get_topic_names_and_types())
    return {
        'nodes': _shown(node_names(node)),
        'topics': [{
            'name': printable(name), 'types': [*map(printable, types)],
            'publishers': _nodes(node.get_publishers_info_by_topic(name)),
            'subscribers': _nodes(node.get_subscriptions_info_by_topic(name))}
            for name, types in topics[:MAX_LISTED]],
        'more': max(0, len(topics) - MAX_LISTED)}


def _nodes(endpoints: Any) -> list[str]:
    return _shown(f'{one.node_namespace.rstrip("/")}/{one.node_name}' for one in endpoints)


def _shown(names: Iterable[str]) -> list[str]:
    return sorted({printable(name) for name in names if '/_' not in name})[:MAX_LISTED]


def describe_graph(graph: dict[str, Any]) -> str:
    """Return the graph as text, a topic in a line with its nodes below."""
    lines = ['Nodes:', *(f'  {name}' for name in graph['nodes']), 'Topics:']
    for topic in graph['topics']:
        lines.append(f'  {topic["name"]} [{", ".join(topic["types"])}]')
        lines += [f'    {kind}: {", ".join(topic[kind]) or "none"}'
                  for kind in ('publishers', 'subscribers')]
    if graph['more']:
        lines.append(f'  and {graph["more"]} more topics')
    return '\n'.join(lines)


def read_settled_graph(node: Node) -> dict[str, Any]:
    """Return the graph once two readings in a row are the same, after 11 s at the latest."""
    graph: dict[str, Any] = {}
    time.sleep(_DISCOVERY_SECONDS)
    for _ in range(_MAX_READINGS):
        before, graph = graph, read_graph(node)
        if graph == before:
            break
        time.sleep(_INTERVAL_SECONDS)
    return graph


def list_graph(args: Sequence[str]) -> int:
    """Print the nodes and the topics; return 0."""
    rclpy.init(args=[word for word in args if word != '--list'])
    try:
        node = rclpy.create_node('_image_viewer_list', start_parameter_services=False)
        print(describe_graph(read_settled_graph(node)), flush=True)
    finally:
        rclpy.shutdown()
    return 0
