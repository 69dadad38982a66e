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

import { part } from './page.js';
import { keep, readAddress } from './state.js';

/** @import { Tile } from './tile.js' */

const SVG = 'http://www.w3.org/2000/svg';
const NAMES = ['boxes', 'center', 'outline', 'grid', 'cross']; // of fields, and in the address
const KEPT = 8; // pictures whose boxes are kept
const ARM = 12; // pixels of a cross
const LETTER = 14; // pixels of the height of a label

/** Form with the overlays, which are kept in the address. */
export class OverlayForm {
  #form = part('overlays');
  /** @type {string[]} */
  #published = [];
  #isOpen = false;

  /** Read the overlays of the address. @param {() => void} onChange called after a change. */
  constructor(onChange) {
    const given = readAddress();
    for (const name of NAMES) {
      const value = given.get(name) ?? '';
      const field = this.#form.elements[name];
      if (name === 'boxes') field.add(new Option(value));
      if (field.type === 'checkbox') field.checked = value === 'true';
      else field.value = name === 'grid' && value === 'true' ? '2' : value;
    }
    this.#form.addEventListener('submit', (event) => event.preventDefault());
    this.#form.addEventListener('input', () => {
      keep(this.chosen);
      onChange();
    });
    this.list([]);
  }

  /**
   * Overlays by the name of the field; those without a value are not chosen.
   * @returns {Record<string, any>}
   */
  get chosen() {
    const values = new FormData(this.#form);
    return Object.fromEntries(NAMES.map((name) => [name, values.get(name)]));
  }

  /** What the server is asked for, which says why boxes are not published. */
  get request() {
    const { boxes, center, outline } = this.chosen;
    return { boxes, camera: Boolean(center || outline) };
  }

  /** Whether boxes are chosen that are published. */
  get hasBoxes() {
    return this.#published.includes(this.chosen.boxes);
  }

  /** Use the list of the topics with boxes. @param {string[]} published */
  list(published) {
    this.#published = published;
    const { boxes } = this.#form.elements;
    const { value } = boxes;
    const names = [...new Set(['', ...published, value])];
    boxes.replaceChildren(...names.map((name) => new Option(name || 'None', name)));
    boxes.value = value;
  }

  /** Open the form, or close it. */
  toggle() {
    this.#isOpen = !this.#isOpen;
    for (const button of document.querySelectorAll('[data-look=overlays]')) {
      button.ariaExpanded = String(this.#isOpen);
    }
  }

  /** Show the form on the page with one topic, if it is open. @param {boolean} isOne */
  show(isOne) {
    this.#form.hidden = !isOne || !this.#isOpen;
  }
}

/** What is drawn over one picture: boxes, camera, grid and cross. */
export class Overlay {
  #tile;
  #chosen = {};
  #asked = '';
  #camera = {};
  #boxes = new Map(); // by picture
  #isEmpty = true;
  #part = (name) => this.#tile.element.querySelector(`.overlay ${name}`);

  /** @param {Tile} tile */
  constructor(tile) {
    this.#tile = tile;
    tile.view.onPlace = () => this.#draw();
    tile.canvas.addEventListener('drawn', () => this.#draw());
  }

  /** Forget what was asked, because the connection is a new one. */
  reset() {
    this.#asked = '';
    this.#camera = {};
    this.#boxes.clear();
  }

  /**
   * Draw overlays, and ask for them if that is not what was asked last.
   * @param {Record<string, any>} chosen values of the form.
   * @param {OverlayForm['request'] | null} request what the server is asked for; null for nothing.
   */
  show(chosen, request) {
    const { name, connection } = this.#tile;
    const asked = request && (request.boxes || request.camera) ? JSON.stringify(request) : '';
    if (asked !== this.#asked) connection.send({ overlays: name, ...request });
    this.#asked = asked;
    if (!request?.boxes) this.#boxes.clear();
    this.#chosen = chosen;
    this.#draw();
  }

  /** Use a message of the server. */
  receive(kind, message) {
    if (kind === 'camera') this.#camera = message;
    else this.#boxes.set(message.picture, message.list);
    if (this.#boxes.size > KEPT) this.#boxes.delete(this.#boxes.keys().next().value);
    this.#draw();
  }

  #draw() {
    const { view: { size: [width, height] }, view, picture } = this.#tile;
    const wasEmpty = this.#isEmpty;
    this.#isEmpty = !width || !Object.values(this.#chosen).some(Boolean);
    if (this.#isEmpty && wasEmpty) return;
    const { matrix } = view;
    const { center, outline, grid, cross } = this.#chosen;
    const at = ([x, y]) => matrix.transformPoint({ x, y });
    const path = (points) => points.map((point, place) => {
      const { x, y } = at(point ?? [0, 0]);
      return point ? `${place && points[place - 1] ? 'L' : 'M'}${x} ${y}` : '';
    }).join('');
    const plus = (point) => {
      const { x, y } = at(point);
      return `M${x - ARM} ${y}h${2 * ARM}M${x} ${y - ARM}v${2 * ARM}`;
    };
    const lines = Math.min(50, Math.max(0, Math.floor(Number(grid)) || 0));
    const parts = Array.from({ length: lines }, (_, line) => (line + 1) / (lines + 1));
    const sides = parts.map((part) => path([[part * width, 0], [part * width, height]])
      + path([[0, part * height], [width, part * height]]));
    this.#part('.grid').setAttribute('d', sides.join('')
      + (cross ? plus([width / 2, height / 2]) : ''));
    const { center: middle, outline: border = [] } = this.#camera;
    this.#part('.camera').setAttribute('d', (center && middle ? plus(middle) : '')
      + (outline ? path([...border, ...border.slice(0, 1)]) : ''));
    this.#drawBoxes(this.#boxes.get(picture) ?? [], at);
  }

  #drawBoxes(boxes, at) {
    const group = this.#part('.boxes');
    while (group.children.length > 2 * boxes.length) group.lastChild.remove();
    const child = (place, kind) => group.children[place]
      ?? group.appendChild(document.createElementNS(SVG, kind));
    const labels = boxes.map(([x, y, width, height, angle, text], place) => {
      const [cos, sin] = [Math.cos(angle) / 2, Math.sin(angle) / 2];
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([right, down]) => at([
        x + right * width * cos - down * height * sin,
        y + right * width * sin + down * height * cos]));
      const [xs, ys] = [corners.map((one) => one.x), corners.map((one) => one.y)];
      child(2 * place, 'path').setAttribute(
        'd', `M${corners.map((one) => `${one.x} ${one.y}`).join('L')}Z`);
      const label = child(2 * place + 1, 'text'); // within the frame, if the box is
      label.setAttribute('y', Math.max(Math.min(...ys) - 4, Math.min(LETTER, Math.max(...ys))));
      if (label.textContent !== text) label.textContent = text;
      return [label, Math.min(...xs), Math.max(...xs)];
    });
    const lengths = labels.map(([label]) => label.getComputedTextLength()); // one layout for all
    const { clientWidth } = this.#tile.link;
    labels.forEach(([label, low, high], place) => label.setAttribute('x', Math.max(
      Math.min(low, Math.max(clientWidth, low) - lengths[place]), Math.min(0, high))));
  }
}
