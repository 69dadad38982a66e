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

import { Connection } from './connection.js';
import { Recording, Steps } from './frames.js';
import { Layout } from './layout.js';
import { OverlayForm } from './overlay.js';
import { createNotice, part } from './page.js';
import { Controls, explainLimits, RangeForm, readLimits } from './settings.js';
import {
  addressWith, Arrangement, copyText, keep, readAddress, State, topicOfAddress,
} from './state.js';
import { Robot, savePicture, saveVideo, Tiles } from './tiles.js';
import { decodedCodecs } from './video.js';

const REFRESH_MS = 500;
const UNTURNED = { turns: 0, isFlipped: false };
const NOTICE_MS = 8000;
const NOT_SAVED = 'Not saved, because the page has no connection to the node';
const ZOOM = 1.5; // of a press of a button
const FAST = 10; // pixels for each repetition of a key that is held
// The parts of a tile that use messages, by kind.
const RECEIVERS = {
  pixel: 'look', profile: 'look', histogram: 'look', exposed: 'look', boxes: 'overlay', camera: 'overlay',
};

const saves = new Map(); // by topic: whether the file that is awaited is as the page shows it
keep({ token: '' });
const given = readAddress();
const state = new State(await decodedCodecs());
const notify = createNotice(NOTICE_MS);
const layOut = () => layout.update();
const arrangement = new Arrangement(layOut);
const connection = new Connection({
  connected(hello) {
    state.node = hello;
    part('plain-link').hidden = !hello.token;
    if (state.codecs.length) connection.send({ codecs: state.codecs });
    for (const tile of tiles.values()) tile.reset();
    steps.reset();
    controls.enable(hello.control);
    recording.enable(hello.download);
    notify(explainLimits(given.get('range')) || (saves.size ? NOT_SAVED : ''));
    saves.clear();
    layOut();
  },
  disconnected(sentence) {
    const isSaid = part('notice').textContent === NOT_SAVED; // after each attempt to connect
    if (sentence || (saves.size && !isSaid)) notify(sentence || NOT_SAVED, false);
    layout.show();
  },
  received: receive,
  frame: (bytes) => tiles.frame(bytes),
});
connection.lag.onLag = (seconds) => page.robot.rest(seconds);
const { send } = connection;
/**
 * @typedef {{ state: State, connection: Connection, arrangement: Arrangement, range: RangeForm,
 *   overlays: OverlayForm, robot: Robot, controls: Controls, steps: Steps, recording: Recording,
 *   notify: (sentence: string) => void, select: (name: string) => void }} Page what tiles use.
 */
/** @type {Page} */
const page = {
  state, connection, arrangement, notify, select,
  range: new RangeForm(change), overlays: new OverlayForm(layOut), robot: new Robot(layOut),
  controls: new Controls(part('controls'), send, notify), steps: new Steps(send),
  recording: new Recording(send, () => [...tiles.values()].filter((tile) => tile.topic).map(
    ({ topic: { id }, name, element }) => ({ id, name, isShown: !element.hidden })),
    (sentence) => {
      if (sentence) notify(sentence);
      layOut();
    }),
};
const { overlays, robot, controls, steps, recording } = page;
const tiles = new Tiles(page);
const layout = new Layout(page, tiles);

/** Use a message of the node. @param {import('../messages.js').Answer} message */
function receive(message) {
  if (message.topics) {
    tiles.list(message.topics);
    layOut();
  }
  if (message.more !== undefined) {
    part('more').hidden = !message.more;
    part('more').firstElementChild.textContent = message.more;
    layOut();
  }
  if (message.detections) overlays.list(message.detections);
  if (message.robot !== undefined) robot.setPublished(message.robot);
  if (message.status) {
    tiles.receive(message.status);
    layout.show();
  }
  if (message.error) complain(message);
  if (message.refused) leaveVideo(message.refused);
  for (const [kind, receiver] of Object.entries(RECEIVERS)) {
    if (message[kind]) tiles.get(message[kind].topic)?.[receiver].receive(kind, message[kind]);
  }
  if (message.step) steps.receive(message.step);
  if (message.file) {
    const { file } = message;
    savePicture(file, arrangement.turned(file.topic), saves.get(file.topic))
      .then(notify);
    saves.delete(file.topic);
  }
  controls.receive(message);
  recording.receive(message);
}

/** Show an error. @param {import('../messages.js').Answer} message */
function complain({ error, topic }) {
  const tile = tiles.get(topic);
  if (tile) tile.refusal = error;
  else notify(error);
  layout.show();
}

/** Ask for JPEGs of a topic, because its video cannot be shown. */
function leaveVideo({ topic, reason }) {
  const tile = tiles.get(topic);
  if (tile) tile.refusesVideo = true;
  notify(`${topic} comes as JPEG: ${reason}`);
  tiles.ask();
}

/** Show the topic in another way. */
function change(values) {
  Object.assign(tiles.get(state.selected), values);
  keep(tiles.settingsOf(state.selected));
  layOut();
}

/** Show one topic alone, or all topics for ''. */
function select(name, isNew = true) {
  const last = state.selected;
  state.selected = name;
  history[isNew ? 'pushState' : 'replaceState'](null, '', addressWith(tiles.settingsOf(name)));
  steps.reset();
  arrangement.keep();
  keep(overlays.chosen);
  tiles.listAgain();
  layOut();
  scrollTo(0, 0);
  if (!name) tiles.get(last)?.link.focus();
}

/** Show the next topic alone, or that before. */
function step(distance) {
  const names = arrangement.list([...tiles.keys()]);
  const place = names.indexOf(state.selected);
  if (names.length) select(names[(place + distance + names.length) % names.length]);
}

/** Pin or hide a topic, or show it before another one. */
function rearrange(name, topic, before = '') {
  if (!tiles.has(topic) || topic === before) return;
  if (before) arrangement.place(topic, before, [...tiles.keys()]);
  else arrangement.toggle(name, topic);
}

/** Move a pinned topic behind the next one, or before the last one. */
function move(topic, isLater) {
  const pins = arrangement.list([...tiles.keys()]).filter((name) => arrangement.has('pin', name));
  const other = pins[pins.indexOf(topic) + (isLater ? 1 : -1)];
  if (!other) return;
  if (isLater) rearrange('pin', other, topic);
  else rearrange('pin', topic, other);
}

function pause() {
  state.isPaused = !state.isPaused;
  layOut();
}

/** Save the picture that a tile shows; the next one may be drawn meanwhile. */
function save(name, isTurned = false) {
  const tile = tiles.get(name);
  if (!connection.isOpen) notify(NOT_SAVED);
  else if (tile?.canvas.hidden) notify(tile.link.title || `${name} has no picture yet`);
  else if (tile?.isVideo) {
    saveVideo(tile, isTurned ? arrangement.turned(name) : UNTURNED).then(notify);
  } else if (tile) {
    saves.set(name, isTurned);
    send({ file: name, picture: tile.picture });
  }
}

/** Copy the address of the page, with the token, which the address bar does not show. */
function copyLink(hasToken) {
  const url = addressWith({ token: hasToken && state.node.token });
  const done = hasToken ? 'Copied the link with its token' : 'Copied the link';
  notify(copyText(url.href) ? done : `Copy this link: ${url}`);
}

// What each button does to look into a picture.
const LOOKS = {
  in: ({ view }) => view.zoom(view.scale * ZOOM),
  out: ({ view }) => view.zoom(view.scale / ZOOM),
  fit: ({ view }) => view.zoom(0),
  one: ({ view }) => view.zoom(1 / devicePixelRatio),
  profile: (tile) => tile.look.toggle('profile'),
  histogram: (tile) => tile.look.toggle('histogram'),
  exposed: (tile) => tile.look.toggleExposed(),
  copy: (tile) => {
    const text = [tile.name, ...tile.origin.map(([, one]) => one)].filter(Boolean).join(', ');
    notify(copyText(text) ? `Copied ${text}` : `Copy this: ${text}`);
  },
  overlays: () => overlays.toggle(),
  turn: (tile) => arrangement.turn(tile.name),
  flip: (tile) => arrangement.turn(tile.name, true),
};

/** Look into a picture in another way. */
function look(name, tile) {
  if (tile.canvas.hidden) return;
  LOOKS[name](tile);
  layOut();
}

/** Move the focus in the grid. */
function moveFocus(distance) {
  const links = [...part('cameras').querySelectorAll('.tile:not([hidden]) .frame')];
  const place = links.indexOf(document.activeElement);
  links[place < 0 ? 0 : Math.min(links.length - 1, Math.max(0, place + distance))]?.focus();
}

const topicOf = (element) => element?.closest('.tile')?.dataset.topic;
const focused = () => topicOf(document.activeElement);
const ALL_KEYS = {
  ' ': pause,
  s: () => save(focused()),
  ArrowLeft: () => moveFocus(-1),
  ArrowRight: () => moveFocus(1),
  ArrowUp: () => moveFocus(-layout.columns),
  ArrowDown: () => moveFocus(layout.columns),
  p: () => rearrange('pin', focused()),
  h: () => rearrange('hide', focused()),
  c: () => pressOf('c')?.(),
  '?': () => part('help').click(),
};

/** Return the press of the button of a key, for the picture that is shown alone. */
function pressOf(key) {
  const name = CSS.escape({ ' ': 'Space', '+': 'Plus' }[key] ?? key);
  const button = /** @type {HTMLElement} */ (document.querySelector(
    `:is(header, #panel, .tile:not([hidden])) [aria-keyshortcuts="${name}" i]:not([hidden])`));
  return button && (() => button.click());
}

const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** Move the cursor in the picture that is shown alone, or begin a line; return whether it was done. */
function read({ key, shiftKey, repeat, target }) {
  const { look } = tiles.get(tiles.alone) ?? {};
  if (key === 'Enter' && !target.closest('a[href], button, input, summary')) return look?.anchor();
  if (!look || !shiftKey || !STEPS[key] || target.closest('input, select')) return false;
  const [x, y] = STEPS[key];
  look.step(...(repeat ? [FAST * x, FAST * y] : [x, y]));
  return true;
}

let pressed = null; // button that the pointer has pressed, which gets no keys until Tab
document.addEventListener('click', ({ target, detail }) => {
  if (detail) pressed = /** @type {Element} */ (target).closest('button, summary'); // no key
});

// A key acts unless it belongs to the element with the focus.
document.addEventListener('keydown', (event) => {
  if (event.key === 'Tab') pressed = null;
  const isIn = (selector) => /** @type {Element} */ (event.target).closest(selector);
  const isTyping = isIn('input:not([type=checkbox], [type=range])') && event.key !== 'Escape';
  const isPressing = (event.key === ' ' && ![null, pressed].includes(isIn('button, summary')))
    || (/ |Arrow/.test(event.key) && isIn('input, select'))
    || (event.key === 'Escape' && document.querySelector(':popover-open')); // which it closes
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const isShortcut = event.ctrlKey || event.metaKey || event.altKey;
  const isRead = !isShortcut && state.selected && read(event);
  const action = state.selected ? pressOf(key) : ALL_KEYS[key];
  if (!isRead && (!action || isTyping || isPressing || isShortcut)) return;
  event.preventDefault();
  if (!isRead) action();
});

document.addEventListener('visibilitychange', () => tiles.ask());
addEventListener('resize', layOut); // whose words may have room
addEventListener('popstate', () => select(topicOfAddress(), false));
const BUTTONS = {
  back: () => select(''),
  previous: () => step(-1),
  next: () => step(1),
  pause,
  earlier: () => steps.by(-1, tiles.alone, tiles.beside),
  later: () => steps.by(1, tiles.alone, tiles.beside),
  save: () => save(tiles.alone),
  'save-turned': () => save(tiles.alone, true),
  rectified: () => change({ isRectified: !tiles.get(state.selected).isRectified }),
  full: () => (document.fullscreenElement ? document.exitFullscreen()
    : tiles.get(tiles.alone)?.element.requestFullscreen?.()),
  link: () => copyLink(Boolean(state.node.token)),
  'plain-link': () => copyLink(false),
  fold: () => {
    const isFolded = document.body.toggleAttribute('data-folded');
    part('fold').ariaExpanded = String(!isFolded);
    layOut();
  },
  unhide: () => arrangement.set('hide', ''),
};
for (const [id, action] of Object.entries(BUTTONS)) {
  part(id).addEventListener('click', (event) => {
    event.preventDefault(); // of a link
    action();
  });
}
for (const name of ['search', 'size', 'beside']) {
  part(name).addEventListener('input', ({ target }) => arrangement.set(name, target.value));
}
const cameras = part('cameras');
cameras.addEventListener('click', ({ target }) => {
  const { arrange: name, look: way } = target.closest('button')?.dataset ?? {};
  if (name === 'earlier' || name === 'later') move(topicOf(target), name === 'later');
  else if (name) rearrange(name, topicOf(target));
  if (way) look(way, tiles.get(topicOf(target)));
});
cameras.addEventListener('dragstart',
  ({ target, dataTransfer }) => dataTransfer.setData('text/plain', topicOf(target)));
cameras.addEventListener('dragover', (event) => event.preventDefault());
cameras.addEventListener('drop', (event) => {
  event.preventDefault();
  const before = topicOf(event.target);
  if (before) rearrange('pin', event.dataTransfer.getData('text/plain'), before);
});
part('full').hidden = !document.fullscreenEnabled;
setInterval(() => document.hidden || layout.show(), REFRESH_MS);

if (state.selected) {
  Object.assign(tiles.add(state.selected), { range: readLimits(given.get('range')),
    colors: given.get('colors') === 'gray' ? 'gray' : '',
    isRectified: given.get('rectified') === 'true' });
}
layOut();
