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

import { showChart } from './chart.js';

/** @import { Request } from '../messages.js' */
/** @import { Tile } from './tile.js' */

const CROSS = 12; // pixels of an arm
const AGAIN_MS = 200; // between two questions of a kind, while the cursor rests

/** Questions about the pixels of one picture: of the cursor, of a line, of all. */
export class Look {
  /** Kind of the chart, 'profile' or 'histogram'; '' for none. */
  chart = '';
  #tile;
  #send;
  #cursor = null;
  #place = null; // of the pointer over this picture, on the page
  #reason = ''; // why there are no charts
  #begin = null; // of a line that is drawn
  #line = null;
  #asked = {}; // by kind
  #later = 0; // timer of the questions that came too early
  #output;
  #chart; // its element
  #follows = false; // the pointer over another picture
  #exposed; // canvas that marks over-exposed pixels
  #cells = new DOMMatrix(); // of this canvas in the image

  /**
   * @param {Tile} tile
   * @param {(message: Request) => void} send sends a message to the server.
   * @param {(place?: number[]) => void} onPoint called with the place of the cursor as parts of
   *   the width and the height.
   */
  constructor(tile, send, onPoint) {
    this.onPoint = onPoint;
    this.#tile = tile;
    this.#send = send;
    this.#output = tile.element.querySelector('.pixel');
    this.#chart = tile.element.querySelector('.chart');
    this.#exposed = tile.element.querySelector('.exposed');
    this.#chart.addEventListener('click', ({ target }) => {
      if (target.dataset.at) this.#point(JSON.parse(target.dataset.at), true);
      this.#drawLine();
      this.ask();
    });
  }

  /** Use an event of a pointer; return whether it draws a line. */
  use(event) {
    const isGone = event.type === 'pointerleave' && event.pointerType === 'mouse';
    this.#place = isGone ? null : event;
    this.#pointAt(this.#place);
    const pixel = this.#cursor;
    if (event.type === 'pointerdown' && event.shiftKey && !this.#reason) this.#setChart('profile');
    if (event.type === 'pointerdown' && this.chart === 'profile') this.#begin = pixel;
    if (event.type === 'pointercancel') this.#begin = null;
    if (this.#begin && pixel) this.#line = [this.#begin, pixel];
    if (event.type === 'pointerup') this.#begin = null;
    this.#drawLine();
    this.ask();
    return Boolean(this.#begin);
  }

  /** Move the cursor by pixels to the right and down, as they are shown; the view follows it. */
  step(x, y) {
    const { view } = this.#tile;
    if (!view.size[0]) return;
    const { a, b, c, d } = view.matrix.inverse();
    const way = [a * x + c * y, b * x + d * y];
    const pixel = (this.#cursor ?? view.middle).map((one, axis) => Math.min(view.size[axis] - 1,
      Math.max(0, one + Math.round(way[axis] * view.scale))));
    this.#place = null;
    this.#point(pixel, true);
    if (this.#begin) this.#line = [this.#begin, pixel];
    this.#tell();
    view.reveal(pixel);
  }

  /** Begin a line at the cursor, or end it; return whether there can be one. */
  anchor() {
    if (this.chart !== 'profile' || !this.#cursor) return false;
    this.#begin = this.#begin ? null : this.#cursor;
    return true;
  }

  /** Use the pixel that is under the pointer now, because the picture has another place. */
  move() {
    if (this.#place) this.#pointAt(this.#place);
    else this.#drawLine();
    this.#exposed.style.transform = String(this.#tile.view.matrix.multiply(this.#cells));
  }

  /** Mark over-exposed pixels, or mark them no more. */
  toggleExposed() {
    const button = this.#tile.element.querySelector('[data-look=exposed]');
    button.ariaPressed = String(button.ariaPressed !== 'true');
    this.#exposed.hidden = true; // until the answer
    this.ask();
  }

  /** Whether over-exposed pixels are marked. */
  get marks() {
    return this.#tile.element.querySelector('[data-look=exposed]').ariaPressed === 'true';
  }

  /** Draw stripes over the cells of an answer. */
  #mark({ bits, columns, step, place: [x, y] }) {
    const bytes = Uint8Array.from(atob(bits), (one) => one.charCodeAt(0));
    const rows = Math.floor((8 * bytes.length) / columns);
    const image = new ImageData(columns, rows);
    for (let cell = 0; cell < rows * columns; cell += 1) {
      const isOver = (bytes[cell >> 3] >> (7 - (cell % 8))) & 1;
      const isRed = ((cell % columns) + Math.floor(cell / columns)) % 4 < 2;
      if (isOver) image.data.set([isRed ? 255 : 0, 0, 0, 255], 4 * cell);
    }
    Object.assign(this.#exposed, { width: columns, height: rows, hidden: false });
    this.#exposed.getContext('2d').putImageData(image, 0, 0);
    this.#cells = new DOMMatrix().translate(x, y).scale(step);
    this.move();
  }

  #pointAt(place) {
    this.#point(place && this.#tile.view.pixel(place), false);
    this.#tell();
    this.#drawLine();
  }

  /** Show the cursor in the picture beside this one. */
  #tell() {
    this.onPoint(this.#cursor?.map((one, axis) => (one + 0.5) / this.#tile.view.size[axis]));
  }

  /** Use a place of a cursor over another picture as if it were here. */
  follow(place) {
    this.#place = null;
    this.#point(place?.map((one, axis) => Math.floor(one * this.#tile.view.size[axis])), true);
    this.#drawLine();
    this.ask();
  }

  #point(pixel, follows) {
    this.#cursor = pixel ?? null;
    this.#follows = follows;
    if (!pixel) this.#output.textContent = '';
  }

  /** Offer charts; '' is no reason against them. */
  offer(reason) {
    this.#reason = reason;
    if (reason && this.chart) this.#setChart('');
    for (const button of this.#tile.element.querySelectorAll('.look [aria-pressed]')) {
      button.disabled = Boolean(reason);
      button.dataset.title ??= button.title;
      button.title = reason || button.dataset.title;
    }
  }

  /** Show another chart, or none if it is shown. */
  toggle(kind) {
    this.#setChart(this.chart === kind ? '' : kind);
    if (kind === 'profile') showChart(this.#chart, kind, { error: 'Draw a line in the picture.' });
    this.ask();
  }

  #setChart(kind) {
    this.chart = kind;
    this.#chart.hidden = !kind;
    this.#line = null;
    this.#drawLine();
    this.#tile.link.classList.toggle('draws', kind === 'profile');
    for (const button of this.#tile.element.querySelectorAll('.look [aria-pressed]')) {
      if (button.dataset.look !== 'exposed') {
        button.ariaPressed = String(button.dataset.look === kind);
      }
    }
  }

  /** Forget the questions of an earlier connection. */
  reset() {
    this.#asked = {};
  }

  /** Ask what has changed; a question waits for the answer to the last one of its kind. */
  ask() {
    if (!this.#output.checkVisibility()) return;
    const { view, isVideo, context } = this.#tile;
    if (isVideo) {
      if (!this.#cursor) return;
      const [red, green, blue] = context.getImageData(...this.#cursor, 1, 1).data;
      this.#answer(`R ${red}, G ${green}, B ${blue} of the decoded video`);
      return;
    }
    if (this.#cursor) this.#question('pixel', { at: this.#cursor });
    if (this.marks) this.#question('exposed', { region: view.region });
    if (this.chart === 'histogram') this.#question('histogram', { region: view.region });
    if (this.#line) this.#question('profile', { from: this.#line[0], to: this.#line[1] });
  }

  #question(kind, details) {
    const { picture, name } = this.#tile;
    const last = this.#asked[kind] ?? { at: -AGAIN_MS };
    const text = JSON.stringify(details);
    const now = performance.now();
    const rest = last.at + AGAIN_MS - now;
    last.isOld = text !== last.text || picture !== last.picture;
    if (picture < 0 || last.waits) return;
    if (rest > 0 && (text === last.text || kind !== 'pixel')) {
      if (last.isOld) this.#askLater(rest);
      return;
    }
    this.#asked[kind] = { text, picture, waits: true, at: now };
    this.#send({ [kind]: name, picture, ...details });
  }

  #askLater(milliseconds) {
    this.#later ||= setTimeout(() => {
      this.#later = 0;
      this.ask();
    }, milliseconds);
  }

  /** Use an answer of the server. */
  receive(kind, answer) {
    const asked = this.#asked[kind];
    if (!asked) return;
    asked.waits = false;
    if (kind === 'exposed') {
      if (answer.error) this.#output.textContent = answer.error;
      else if (this.marks) this.#mark(answer);
    } else if (kind === this.chart) {
      showChart(this.#chart, kind, answer);
    } else if (kind === 'pixel' && this.#cursor) {
      this.#answer(answer.error ?? answer.text, JSON.parse(asked.text).at);
    }
    if (asked.isOld) this.ask();
  }

  #answer(text, [x, y] = this.#cursor) {
    this.#output.textContent = `${x}, ${y}: ${text}`;
  }

  #drawLine() {
    const ends = (this.#line ?? []).map(([x, y]) => `${x + 0.5} ${y + 0.5}`);
    const arm = CROSS / this.#tile.view.scale;
    const [x, y] = this.#cursor ?? [];
    const cross = this.#follows && this.#cursor
      ? `M${x + 0.5 - arm} ${y + 0.5}h${2 * arm}m${-arm} ${-arm}v${2 * arm}` : '';
    this.#tile.element.querySelector('.line').setAttribute(
      'd', cross + (ends.length ? `M${ends.join('L')}` : ''));
  }
}
