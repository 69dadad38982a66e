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

import { addressWith, copyText, keep, topicOfAddress } from './address.js';
import { Arrangement } from './arrangement.js';
import { Connection } from './connection.js';
import { Controls } from './controls.js';
import { arrange } from './grid.js';
import { listenToKeys } from './keys.js';
import { OverlayForm } from './overlay.js';
import { explainLimits, RangeForm, readLimits } from './range.js';
import { Recording } from './record.js';
import { isRectified, rectifiedOf } from './rectified.js';
import { Robot } from './robot.js';
import { savePicture } from './save.js';
import { Steps } from './step.js';
import { showName } from './text.js';
import { Tile } from './tile.js';
import { decodedCodecs, explainJpeg, readTopic } from './video.js';

const REFRESH_MS = 500;
const NOTICE_MS = 8000;
const SETTLE_MS = 100;
const SAY_MS = 5000;
const ZOOM = 1.5; // of a press of a button
const STALLED_SECONDS = 2; // two pings without an answer
// The parts of a tile that use messages, by kind.
const RECEIVERS = { pixel: 'look', profile: 'look', histogram: 'look', boxes: 'overlay', camera: 'overlay' };

const NO_CHARTS = 'The browser decodes this video, so the node has no pixels of it. Add quality=90 '
  + 'to the address of the page to get images.';

const part = (id) => document.getElementById(id);
const cameras = part('cameras');
keep({ token: '' });
const { searchParams: given } = new URL(location);

const arrangement = new Arrangement(layOut);
const tiles = new Map();
const numbers = new Map(); // of topics, as in the head of a frame
let selected = topicOfAddress();
let node = { host: '', token: '', widths: [], video: 'never', control: false }; // as it says itself
let isExplained = false;
let mood = 'lost';
let isPaused = false;
let noticeTimer = 0;
let said = { isQuiet: false }; // to screen readers

const fixed = Object.fromEntries(['width', 'quality', 'rate']
  .filter((name) => given.has(name)).map((name) => [name, Number(given.get(name)) || 0]));
if ('width' in fixed || 'quality' in fixed) fixed.fixed = true;
const codecs = Object.keys(fixed).length ? [] : await decodedCodecs();

const connection = new Connection({
  connected(hello) {
    node = hello;
    part('plain-link').hidden = !node.token;
    if (codecs.length) connection.send({ codecs });
    mood = 'live';
    for (const tile of tiles.values()) tile.reset();
    steps.reset();
    controls.enable(node.control);
    recording.enable();
    notify(explainLimits(given.get('range')));
    layOut();
  },
  disconnected(sentence) {
    mood = 'lost';
    recording.lose();
    if (sentence) notify(sentence, false);
    show();
  },
  received(message) {
    if (message.topics) listTopics(message.topics);
    if (message.more !== undefined) {
      part('more').hidden = !message.more;
      part('more').firstElementChild.textContent = message.more;
      layOut();
    }
    if (message.detections) overlays.list(message.detections);
    if (message.robot !== undefined) robot.setPublished(message.robot);
    for (const status of message.status ?? []) {
      const tile = tiles.get(status.name);
      if (tile) {
        tile.status = status;
        numbers.set(status.id, tile);
      }
    }
    if (message.status) show();
    if (message.error) complain(message);
    if (message.refused) leaveVideo(message.refused);
    for (const [kind, receiver] of Object.entries(RECEIVERS)) {
      if (message[kind]) tiles.get(message[kind].topic)?.[receiver].receive(kind, message[kind]);
    }
    if (message.step) steps.receive(message.step);
    if (message.file) savePicture(message.file, arrangement.turned(message.file.topic)).then(notify);
    controls.receive(message);
    recording.receive(message);
  },
  frame(bytes) {
    const { id, isVideo } = readTopic(bytes);
    const tile = numbers.get(id);
    if (tile && isVideo) tile.decode(bytes);
    else if (tile) tile.draw(bytes).then(() => isPaused && ask());
    else connection.send({ got: new DataView(bytes).getUint32(4) });
  },
});

const range = new RangeForm(change);
const overlays = new OverlayForm(layOut);
const controls = new Controls(part('controls'), (message) => connection.send(message), notify);
const recording = new Recording((message) => connection.send(message),
  () => shownTiles().map((tile) => tile.topic?.id).filter(Boolean), (sentence) => {
    if (sentence) notify(sentence);
    layOut();
  });
const steps = new Steps((message) => connection.send(message));
const robot = new Robot(cameras, layOut);

const inView = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    const tile = tiles.get(target.dataset.topic);
    if (tile?.element === target) tile.inView = isIntersecting;
  }
  ask();
}, { rootMargin: '100px' });
let settle = 0;
const sizes = new ResizeObserver(askSoon);

/** Ask for other pictures, but not with each step of a movement. */
function askSoon() {
  settle ||= setTimeout(() => {
    settle = 0;
    ask();
  }, SETTLE_MS);
}

/** Show a sentence below the head of the page; '' removes it. */
function notify(sentence, disappears = true) {
  const notice = part('notice');
  notice.textContent = sentence;
  notice.hidden = !sentence;
  clearTimeout(noticeTimer);
  if (sentence && disappears) noticeTimer = setTimeout(() => notify(''), NOTICE_MS);
}

function complain({ error, topic }) {
  const tile = tiles.get(topic);
  if (tile) tile.refusal = error;
  else notify(error);
  show();
}

/** Ask for JPEGs of a topic, because its video cannot be shown. */
function leaveVideo({ topic, reason }) {
  const tile = tiles.get(topic);
  if (tile) tile.refusesVideo = true;
  notify(`${topic} comes as JPEG: ${reason}`);
  ask();
}

/** Return whether to ask for the video of a topic. */
function takesVideo(tile) {
  const isVideo = node.video === 'always'
    || (node.video === 'auto' && (tile.topic?.transports.includes('video') ?? true));
  if (isVideo && !codecs.length && tile.topic && !isExplained && !Object.keys(fixed).length) {
    isExplained = true;
    notify(explainJpeg(node.host));
  }
  return isVideo && codecs.length > 0 && !tile.refusesVideo;
}

function addTile(name) {
  const tile = new Tile(name, connection, askSoon, (place) => {
    for (const other of shownTiles()) if (other !== tile) other.look.follow(place);
  });
  tiles.set(name, tile);
  tile.link.addEventListener('click', (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    if (!selected) select(name);
  });
  inView.observe(tile.element);
  sizes.observe(tile.link);
  return tile;
}

/** Create and remove tiles so that they are those of the topics, in the same order. */
function listTopics(topics) {
  const names = topics.map((topic) => topic.name);
  if (selected && !names.includes(selected)) names.push(selected);
  for (const [name, tile] of tiles) {
    if (!names.includes(name)) {
      inView.unobserve(tile.element);
      sizes.unobserve(tile.link);
      tile.ask(false, {});
      tile.element.remove();
      tiles.delete(name);
    }
  }
  numbers.clear();
  for (const tile of tiles.values()) tile.topic = null;
  for (const topic of topics) {
    const tile = tiles.get(topic.name) ?? addTile(topic.name);
    if (tile.refusal) tile.reset();
    tile.topic = topic;
    numbers.set(topic.id, tile);
  }
  for (const name of names) if (!tiles.has(name)) addTile(name);
  layOut();
}

/** Ask for the pictures that somebody sees. */
function ask() {
  const [alone, other] = [shown(), beside()];
  for (const tile of tiles.values()) {
    const width = node.widths.find((step) => step >= tile.view.width) ?? 0;
    const looks = Boolean(alone) && [alone, other].includes(tile.name);
    const needsImages = tile.needsImages(looks, isPaused)
      || (looks && overlays.hasBoxes); // whose pictures may wait for them, unlike video
    const isVideo = takesVideo(tile) && !needsImages;
    tile.look.offer(isVideo && !tile.hasImages ? NO_CHARTS : '');
    const options = isVideo ? { width, video: true } : { width, ...fixed };
    if (looks) options.looks = true;
    const held = looks && isPaused && tile.isKept; // so that its pixels can still be looked at
    if (held) options.held = true;
    const isSeen = tile.inView && !tile.element.hidden;
    const isLate = needsImages && isPaused && tile.isVideo; // the page was paused with video
    const isWanted = held || (isSeen && !document.hidden && (!isPaused || isLate));
    tile.ask(isWanted, options);
    tile.overlay.show(looks ? overlays.chosen : {}, looks && isWanted ? overlays.request : null);
  }
}

/** Return what the address says of a topic that is shown alone. */
function settingsOf(topic) {
  const { range: limits, colors, isRectified } = tiles.get(topic) ?? {};
  return { topic, range: limits?.join(), colors, rectified: isRectified && 'true' };
}

/** Show the topic in another way. */
function change(values) {
  Object.assign(tiles.get(selected), values);
  keep(settingsOf(selected));
  layOut();
}

/** Show one topic alone, or all topics for ''. */
function select(name, isNew = true) {
  const last = selected;
  selected = name;
  history[isNew ? 'pushState' : 'replaceState'](null, '', addressWith(settingsOf(name)));
  steps.reset();
  // A tile without a topic is there only while it is selected.
  arrangement.keep();
  keep(overlays.chosen);
  listTopics([...tiles.values()].map((tile) => tile.topic).filter(Boolean));
  scrollTo(0, 0);
  if (!name) tiles.get(last)?.link.focus();
}

function step(distance) {
  const names = arrangement.list([...tiles.keys()]);
  const place = names.indexOf(selected);
  if (names.length) select(names[(place + distance + names.length) % names.length]);
}

/** Return the topic that is shown alone, which may be the rectified one; '' for all topics. */
const shown = () => (tiles.get(selected)?.isRectified && rectifiedOf(selected, tiles)) || selected;

/** Return the topic beside that which is shown alone; '' for none. */
function beside() {
  const name = selected && arrangement.get('beside');
  return tiles.has(name) && name !== shown() ? name : '';
}

const shownTiles = () => [...tiles.values()].filter((tile) => !tile.element.hidden);

/** Show the tiles in the order and as somebody has arranged them. */
function arrangeTiles() {
  const names = [...tiles.keys()];
  const listed = arrangement.list(names);
  const alone = shown() ? [shown(), beside()] : null;
  const { activeElement } = document;
  [...new Set([...alone ?? [], ...listed].filter(Boolean))].forEach((name, place) => {
    const { element } = tiles.get(name);
    if (cameras.children[place] !== element) cameras.insertBefore(element, cameras.children[place]);
  });
  if (document.activeElement !== activeElement) activeElement.focus(); // it was in a moved tile
  for (const [name, tile] of tiles) {
    tile.element.hidden = !(alone ?? listed).includes(name);
    tile.view.turn(arrangement.turned(name));
    tile.element.querySelector('[data-arrange=pin]').ariaPressed = arrangement.has('pin', name);
  }
  document.body.toggleAttribute('data-beside', beside() !== '');
  const hidden = names.filter((name) => arrangement.has('hide', name)).length;
  part('unhide').hidden = !hidden;
  part('unhide').textContent = `Show ${hidden} hidden`;
  part('none').hidden = !names.length || listed.length > 0;
  part('search').hidden = part('size').hidden = part('beside').hidden = names.length < 2;
  const others = ['', ...names.sort().filter((name) => name !== shown())]
    .map((name) => new Option(name || 'Beside: none', name));
  const list = (options) => Array.from(options, ({ value }) => value).join();
  if (list(others) !== list(part('beside').options)) part('beside').replaceChildren(...others);
  part('beside').value = beside();
  part('size').value = arrangement.get('size');
  if (part('search') !== document.activeElement) part('search').value = arrangement.get('search');
}

/** Pin or hide a topic, or show it before another one. */
function rearrange(name, topic, before) {
  if (!tiles.has(topic) || topic === before) return;
  if (before) arrangement.place(topic, before, [...tiles.keys()]);
  else arrangement.toggle(name, topic);
}

/** Move a pinned topic behind the next one, or before the last one. */
function move(topic, isLater) {
  const pins = arrangement.list([...tiles.keys()]).filter((name) => arrangement.has('pin', name));
  const other = pins[pins.indexOf(topic) + (isLater ? 1 : -1)];
  if (other) rearrange('pin', ...(isLater ? [other, topic] : [topic, other]));
}

/** Show one topic or all, as somebody has chosen. */
function layOut() {
  document.body.dataset.view = selected ? 'one' : 'all';
  const title = selected || (node.host ? `Cameras of ${node.host}` : 'Cameras');
  showName(part('title'), title);
  document.title = (recording.isOn ? '● ' : '')
    + (selected && node.host ? `${selected} – ${node.host}` : title);
  part('pause').ariaPressed = isPaused;
  part('pause').querySelector('span').textContent = isPaused ? 'Resume' : 'Pause';
  part('previous').hidden = part('next').hidden = tiles.size < 2;
  robot.show(!selected, isPaused);
  steps.show(isPaused);
  part('calibrate').hidden = !node.control || !selected || isRectified(selected);
  part('calibrate').href = `/calibrate?topic=${encodeURIComponent(selected)}`;
  const alone = shown();
  const { range: limits, colors } = tiles.get(selected) ?? {};
  if (alone !== selected) Object.assign(tiles.get(alone), { range: limits, colors });
  part('rectified').hidden = part('rectified-key').hidden = !rectifiedOf(selected, tiles);
  part('rectified').ariaPressed = alone !== selected;
  arrangeTiles();
  for (const [name, tile] of tiles) {
    if (selected) tile.link.removeAttribute('href');
    else tile.link.href = addressWith(settingsOf(name));
  }
  const filling = document.fullscreenElement;
  if (filling && filling !== tiles.get(alone)?.element) document.exitFullscreen();
  show();
}

/** Return the state of the page. */
function state() {
  if (mood === 'live' && connection.silence > STALLED_SECONDS) return 'stalled';
  return mood === 'live' && isPaused ? 'paused' : mood;
}

/** Show what changes by itself: the state of the page and the facts of each tile. */
function show() {
  const present = state();
  const words = { live: 'Live', paused: 'Paused', stalled: 'Stalled',
    lost: node.host ? 'Reconnecting' : 'Connecting' };
  part('state').dataset.state = present;
  if (part('state').textContent !== words[present]) part('state').textContent = words[present];
  part('empty').hidden = tiles.size > 0 || robot.isShown || mood !== 'live';
  for (const tile of tiles.values()) tile.show(present);
  const ratios = shownTiles().map((tile) => tile.view.ratio).filter(Boolean);
  ratios.sort((one, other) => one - other);
  const one = tiles.get(shown());
  range.show(one?.status.range, one?.range, one?.colors, one?.status.unit);
  one?.look.ask();
  overlays.show(Boolean(selected));
  controls.show(tiles.get(selected)?.topic?.nodes ?? []);
  if (present === 'live') announce(one);
  arrange(shownTiles().length + (!selected && robot.isShown),
    one?.view.ratio || (ratios[ratios.length >> 1] ?? 16 / 9), one,
    Number(arrangement.get('size')) || 0);
  ask();
}

/** Tell screen readers that the picture that is shown alone has stopped, or comes again. */
function announce(tile) {
  const isQuiet = Boolean(tile?.element.classList.contains('quiet'));
  if (said.tile === tile && (said.isQuiet === isQuiet || Date.now() < said.at + SAY_MS)) return;
  const sentence = isQuiet ? tile.link.title : 'Pictures arrive again';
  part('said').textContent = said.tile === tile ? sentence : '';
  said = { tile, isQuiet, at: Date.now() };
}

function pause() {
  isPaused = !isPaused;
  layOut();
}

/** Save the picture that a tile shows; the next one may be drawn meanwhile. */
function save(name) {
  const tile = tiles.get(name);
  if (!connection.isOpen) notify('Not saved, because the page has no connection to the node');
  else if (tile?.canvas.hidden) notify(tile.link.title || `${name} has no picture yet`);
  else if (tile) connection.send({ file: name, picture: tile.picture });
}

/** Copy the address of the page, with the token, which the address bar does not show. */
function copyLink(hasToken) {
  const url = addressWith({ token: hasToken && node.token });
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
  const links = [...cameras.querySelectorAll('.tile:not([hidden]) .frame')];
  const place = links.indexOf(document.activeElement);
  links[place < 0 ? 0 : Math.min(links.length - 1, Math.max(0, place + distance))]?.focus();
}

const topicOf = (element) => element?.closest('.tile')?.dataset.topic;
const focused = () => topicOf(document.activeElement);
const across = () => Number(cameras.style.getPropertyValue('--columns'));
const ALL_KEYS = {
  ' ': pause,
  s: () => save(focused()),
  ArrowLeft: () => moveFocus(-1),
  ArrowRight: () => moveFocus(1),
  ArrowUp: () => moveFocus(-across()),
  ArrowDown: () => moveFocus(across()),
  p: () => rearrange('pin', focused()),
  h: () => rearrange('hide', focused()),
  c: () => pressOf('c')?.(),
};

/** Return the press of the button of a key, for the picture that is shown alone. */
function pressOf(key) {
  const name = CSS.escape({ ' ': 'Space', '+': 'Plus' }[key] ?? key);
  const button = document.querySelector(
    `:is(header, .tile:not([hidden])) [aria-keyshortcuts="${name}" i]:not([hidden])`);
  return button && (() => button.click());
}

listenToKeys((key) => (selected ? pressOf(key) : ALL_KEYS[key]));
document.addEventListener('visibilitychange', ask);
addEventListener('resize', show);
addEventListener('popstate', () => select(topicOfAddress(), false));
const BUTTONS = {
  back: () => select(''),
  previous: () => step(-1),
  next: () => step(1),
  pause,
  earlier: () => steps.by(-1, shown(), beside()),
  later: () => steps.by(1, shown(), beside()),
  save: () => save(shown()),
  rectified: () => change({ isRectified: !tiles.get(selected).isRectified }),
  full: () => (document.fullscreenElement ? document.exitFullscreen()
    : tiles.get(shown())?.element.requestFullscreen?.()),
  link: () => copyLink(Boolean(node.token)),
  'plain-link': () => copyLink(false),
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
setInterval(() => document.hidden || show(), REFRESH_MS);

if (selected) {
  Object.assign(addTile(selected), { range: readLimits(given.get('range')),
    colors: given.get('colors') === 'gray' ? 'gray' : '',
    isRectified: given.get('rectified') === 'true' });
}
layOut();
