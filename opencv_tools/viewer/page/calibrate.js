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

import { Board } from './calibrate_board.js';
import { Overlay } from './calibrate_overlay.js';
import { Result } from './calibrate_result.js';
import { Views } from './calibrate_views.js';
import { Connection } from './connection.js';
import { showName } from './text.js';
import { Tile } from './tile.js';

const REFRESH_MS = 500;
const NOTICE_MS = 10000;
const RATE = 15; // of the pictures in Hz; the search for the board needs the other time
const STALLED_SECONDS = 2;

const part = (id) => document.getElementById(id);
const address = new URL(location);
address.searchParams.delete('token');
history.replaceState(null, '', address);
const topic = address.searchParams.get('topic') ?? '';
const query = `topic=${encodeURIComponent(topic)}`;

let widths = [];
let mood = 'lost';
let state = null;
let noticeTimer = 0;
let shownNotice = '';

const pictures = new Connection({
  connected(hello) {
    ({ widths } = hello);
    tile.reset();
  },
  disconnected(sentence) {
    if (sentence) notify(sentence);
  },
  received(message) {
    if (message.topics && tile.refusal) tile.reset();
    for (const status of message.status ?? []) {
      if (status.name !== tile.name) continue;
      tile.status = status;
      if (status.width) tile.link.style.setProperty('--ratio', status.width / status.height);
    }
    if (message.error) tile.refusal = message.error;
  },
  frame(bytes) {
    tile.draw(bytes);
  },
});
const tile = new Tile(topic, pictures);
tile.link.removeAttribute('aria-label'); // it leads nowhere here
part('picture').append(tile.element);
const overlay = new Overlay(tile.link, topic);

const session = new Connection({
  connected(hello) {
    mood = 'live';
    board.connected(hello);
    result.connected(hello);
    tile.name = hello.topic;
    notify('');
    show();
  },
  disconnected(sentence) {
    mood = 'lost';
    state = null;
    overlay.clear();
    if (sentence) notify(sentence);
    show();
  },
  received(message) {
    if (message.state) receiveState(message.state);
    if (message.seen) {
      overlay.see(message.seen.corners);
      write('capture', sentence(message.seen.capture));
    }
    if (message.error) notify(sentence(message.error), NOTICE_MS);
  },
}, `/calibrate/ws?${query}`);

const send = (message) => session.send(message);
const board = new Board(send);
const views = new Views(send);
const result = new Result(send, query);

/** Return a text of the server as a sentence. */
function sentence(text) {
  return text && `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? '' : '.'}`;
}

/** Write a text if it is another one, because a screen reader reads each change. */
function write(id, text) {
  if (part(id).textContent !== text) part(id).textContent = text;
}

/** Show a sentence below the head of the page; '' removes it. */
function notify(text, milliseconds = 0) {
  part('notice').textContent = text;
  part('notice').hidden = !text;
  clearTimeout(noticeTimer);
  if (text && milliseconds) noticeTimer = setTimeout(() => notify(''), milliseconds);
}

function receiveState(received) {
  const before = state;
  state = received;
  if (state.notice !== shownNotice) {
    shownNotice = state.notice;
    notify(sentence(state.notice), NOTICE_MS);
  }
  if (before && state.views.length > before.views.length) overlay.flash();
  overlay.cover(state.board ? state.cells : []);
  board.show(state);
  views.show(state);
  result.show(state);
  show();
}

/** Return what to do next. */
function nextStep() {
  if (!state) return 'connecting';
  if (state.busy) return `${state.busy}, please wait`;
  if (state.result && !state.stale) return `the calibration is ${state.result.verdict}`;
  return state.hint || 'there are enough views: solve';
}

/** Show the state of the page, the next step, and ask for pictures. */
function show() {
  const present = mood === 'live' && session.silence > STALLED_SECONDS ? 'stalled' : mood;
  const words = { live: 'Live', stalled: 'Stalled', lost: 'Connecting' };
  part('state').dataset.state = present;
  write('state', words[present]);
  write('hint', sentence(nextStep()));
  if (!state?.board) write('capture', '');
  const width = widths.find((step) => step >= tile.view.width) ?? 0;
  tile.ask(!document.hidden, { width, rate: RATE });
  tile.show(present);
}

/** Say the next step and the newest view to a screen reader, but not each change. */
function say() {
  if (!state) return;
  const count = state.views.length === 1 ? '1 view' : `${state.views.length} views`;
  write('said', `${part('hint').textContent} ${count}.`);
}

part('coverage').addEventListener('change', () => { overlay.isCovered = part('coverage').checked; });
part('back').href = `/?${query}`;
showName(part('title'), `Calibrate ${topic}`);
document.title = `Calibrate ${topic}`;
document.addEventListener('visibilitychange', show);
addEventListener('resize', show);
setInterval(() => document.hidden || show(), REFRESH_MS);
setInterval(say, 3000);
show();
