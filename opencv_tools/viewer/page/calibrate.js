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

import { Board, Result, Views } from './calibrate_panel.js';
import { Connection } from './connection.js';
import { createNotice, part, showName, showState, write } from './page.js';
import { keep, readAddress } from './state.js';
import { Tile } from './tile.js';

/** @import { Session } from '../messages.js' */

const REFRESH_MS = 500;
const SAY_MS = 3000;
const NOTICE_MS = 10000;
const RATE = 15; // of the pictures in Hz; the search for the board needs the other time
const RADIUS = 3.5; // of a corner in pixels of the style sheet
const FLASH_MS = 400;
const KEPT = 8; // frames whose corners are kept until they are shown

/** Corners and covered cells, drawn above a picture that fills its frame. */
class Overlay {
  #canvas = document.createElement('canvas');
  #frame;
  #corners = new Map(); // by frame, the newest last
  #shown = ''; // frame
  #cells = [];
  #isCovered = true;
  #request = 0; // of the next drawing

  /** @param frame element of the picture. */
  constructor(frame) {
    this.#frame = frame;
    this.#canvas.className = 'overlay';
    this.#canvas.setAttribute('aria-hidden', 'true');
    frame.append(this.#canvas);
    new ResizeObserver(() => this.#draw()).observe(frame);
  }

  set isCovered(isCovered) {
    this.#isCovered = isCovered;
    this.#draw();
  }

  /** Show corners while their frame is shown; parts of the width and the height of the picture. */
  see(frame, corners) {
    this.#corners.set(frame, corners);
    if (this.#corners.size > KEPT) this.#corners.delete(this.#corners.keys().next().value);
    this.show(this.#shown);
  }

  /** Show the corners of the frame that the picture shows. */
  show(frame) {
    this.#shown = frame;
    this.#canvas.dataset.corners = this.#corners.get(frame)?.length ?? 0;
    this.#draw();
  }

  /** Show which cells have corners of views. */
  cover(cells) {
    this.#cells = cells;
    this.#draw();
  }

  clear() {
    this.#cells = [];
    this.#corners.clear();
    this.show(this.#shown);
  }

  /** Show that a view was taken. */
  flash() {
    this.#frame.classList.add('taken');
    setTimeout(() => this.#frame.classList.remove('taken'), FLASH_MS);
  }

  /** Draw with the next picture of the screen, once for all changes before that. */
  #draw() {
    this.#request ||= requestAnimationFrame(() => {
      this.#request = 0;
      this.#drawAll();
    });
  }

  #drawAll() {
    const scale = devicePixelRatio;
    const [width, height] = [this.#frame.clientWidth, this.#frame.clientHeight];
    const size = [Math.round(width * scale), Math.round(height * scale)];
    if (this.#canvas.width !== size[0]) [this.#canvas.width] = size; // a new size costs memory
    if (this.#canvas.height !== size[1]) [, this.#canvas.height] = size;
    const context = this.#canvas.getContext('2d');
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    if (this.#isCovered) this.#drawCells(context, width, height);
    context.lineWidth = 1.5;
    context.strokeStyle = '#00231a';
    context.fillStyle = '#3df5b0';
    for (const [x, y] of this.#corners.get(this.#shown) ?? []) {
      context.beginPath();
      context.arc(x * width, y * height, RADIUS, 0, 2 * Math.PI);
      context.fill();
      context.stroke();
    }
  }

  #drawCells(context, width, height) {
    const rows = this.#cells.length;
    context.lineWidth = 1;
    context.strokeStyle = 'rgb(255 255 255 / 0.5)';
    context.fillStyle = 'rgb(40 200 130 / 0.18)';
    this.#cells.forEach((row, y) => row.forEach((count, x) => {
      const cell = [x * width / row.length, y * height / rows, width / row.length, height / rows];
      if (count) context.fillRect(...cell);
      context.strokeRect(...cell);
    }));
  }
}

keep({ token: '' });
const topic = readAddress().get('topic') ?? '';
const query = `topic=${encodeURIComponent(topic)}`;
const notify = createNotice(NOTICE_MS);
/** @type {number[]} */
let widths = [];
/** @type {Session | null} */
let state = null;
let shownNotice = '';

const pictures = new Connection({
  connected(hello) {
    ({ widths } = hello);
    tile.reset();
  },
  disconnected(text) {
    if (text) notify(text, false);
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
  frame: (bytes) => tile.draw(bytes),
});
const tile = new Tile(topic, pictures);
tile.link.removeAttribute('aria-label'); // it leads nowhere here
part('picture').append(tile.element);
const overlay = new Overlay(tile.link);
tile.canvas.addEventListener('drawn', ({ detail: { origin } }) => {
  overlay.show(`${origin.exact}/${origin.number}`);
});

const session = new Connection({
  connected(hello) {
    board.connected(hello);
    result.connected(hello);
    tile.name = hello.topic;
    notify('');
    show();
  },
  disconnected(text) {
    state = null;
    overlay.clear();
    if (text) notify(text, false);
    show();
  },
  received(message) {
    if (message.state) receiveState(message.state);
    if (message.seen) {
      overlay.see(message.seen.frame, message.seen.corners);
      write(part('capture'), sentence(message.seen.capture));
    }
    if (message.error) notify(sentence(message.error));
  },
}, `/calibrate/ws?${query}`);

const board = new Board(session.send);
const views = new Views(session.send);
const result = new Result(session.send, query);

/** Return a text of the server as a sentence. */
function sentence(text) {
  return text && `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? '' : '.'}`;
}

/** Use the state of the session. @param {Session} received */
function receiveState(received) {
  const before = state;
  state = received;
  if (state.notice !== shownNotice) {
    shownNotice = state.notice;
    notify(sentence(state.notice));
  }
  if (before && state.views.length > before.views.length) overlay.flash();
  overlay.cover(state.board ? state.cells : []);
  for (const one of [board, views, result]) one.show(state);
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
  showState(session.mood);
  write(part('hint'), sentence(nextStep()));
  if (!state?.board) write(part('capture'), '');
  const width = widths.find((step) => step >= tile.view.width) ?? 0;
  tile.ask(!document.hidden, { width, rate: RATE, searched: true });
  tile.show(session.mood);
}

/** Say the next step and the newest view to a screen reader, but not each change. */
function say() {
  if (!state) return;
  const count = state.views.length === 1 ? '1 view' : `${state.views.length} views`;
  write(part('said'), `${part('hint').textContent} ${count}.`);
}

part('coverage').addEventListener('change', () => {
  overlay.isCovered = part('coverage').checked;
});
part('back').href = `/?${query}`;
showName(part('title'), `Calibrate ${topic}`);
document.title = `Calibrate ${topic}`;
document.addEventListener('visibilitychange', show);
addEventListener('resize', show);
setInterval(() => document.hidden || show(), REFRESH_MS);
setInterval(say, SAY_MS);
show();
