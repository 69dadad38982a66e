// Copyright 2026 opencv_tools maintainers
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

// The nodes and topics of the graph, in three columns.

import { make, part, showName } from './page.js';

const REFRESH_MS = 2000;
let graph = { topics: [] };
let images = new Set();

/** Return the image topic that a topic belongs to; '' for another topic. */
const imageOf = (name) => [name, name.replace(/\/[^/]*$/, '')].find((one) => images.has(one)) ?? '';

/** Return the box of a node or a topic in a column, and create it at the first time. */
function box(column, boxes, name, types = '') {
  const image = types && imageOf(name);
  const element = make(image ? 'a' : 'div', { className: 'item' });
  showName(element, name);
  element.append(make('small', {}, types));
  if (image) element.href = `/?topic=${encodeURIComponent(image)}`;
  if (!boxes.has(name)) {
    boxes.set(name, element);
    part(column).append(element);
  }
  return boxes.get(name);
}

/** Return the line between two boxes. */
function line(from, to) {
  const { left, top } = part('graph').getBoundingClientRect();
  const [one, other] = [from, to].map((element) => element.getBoundingClientRect());
  const [x, y] = [one.right - left, (one.top + one.bottom) / 2 - top];
  const [end, below] = [other.left - left, (other.top + other.bottom) / 2 - top];
  return `M${x} ${y}C${(x + end) / 2} ${y} ${(x + end) / 2} ${below} ${end} ${below}`;
}

/** Draw the topics that have the text of the search, with their nodes. */
function draw() {
  const text = part('search').value.toLowerCase();
  for (const item of document.querySelectorAll('.item')) item.remove();
  const columns = { publishers: new Map(), topics: new Map(), subscribers: new Map() };
  const pairs = graph.topics.flatMap(({ name, types, publishers, subscribers }) => {
    const words = [name, ...types, ...publishers, ...subscribers].join(' ').toLowerCase();
    if (!words.includes(text)) return [];
    const topic = box('topics', columns.topics, name, types.join(', '));
    return [...publishers.map((node) => [box('publishers', columns.publishers, node), topic]),
      ...subscribers.map((node) => [topic, box('subscribers', columns.subscribers, node)])];
  });
  const path = pairs.map((pair) => line(...pair)).join('');
  part('lines').firstElementChild.setAttribute('d', path);
}

/** Read the graph again; draw it if it has changed. */
async function read() {
  try {
    const answers = await Promise.all(['/graph.json', '/topics'].map((name) => fetch(name)));
    const failed = answers.find((answer) => !answer.ok);
    if (failed) throw new Error(await failed.text());
    const [found, { topics }] = await Promise.all(answers.map((answer) => answer.json()));
    images = new Set(topics.map(({ name }) => name));
    const isNew = JSON.stringify(found) !== JSON.stringify(graph);
    graph = found;
    if (isNew) draw();
    part('notice').hidden = true;
  } catch (err) {
    part('notice').textContent = `The graph is not known: ${String(err)}`;
    part('notice').hidden = false;
  }
  setTimeout(read, REFRESH_MS);
}

part('search').addEventListener('input', draw);
addEventListener('resize', draw);
read();
