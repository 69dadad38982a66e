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

/** @typedef {{ clientX: number, clientY: number }} Place */

const MOST = 64; // pixels of the page for a pixel of the image
const WHEEL = { speed: 0.002, most: 300, line: 33 }; // line: pixels of a wheel that counts lines
const ENLARGED = 2; // a picture that is larger than this shows its pixels as squares

const limit = (value, low, high) => Math.min(high, Math.max(low, value));

/** Place of a picture in its frame: zoom and pan, by pointer, wheel, touch and keys. */
export class View {
  size = [0, 0]; // of the image
  #frame;
  #canvas;
  #line; // in pixels of the image
  onPlace = () => {}; // called when the picture has another place
  #onChange = () => {};
  #scale = 0; // pixels of the page for a pixel of the image; 0 fits the frame
  #center = [0, 0]; // pixel of the image in the middle of the frame
  #part = [0, 0, 0, 0]; // of the image that the canvas has: x, y, width and height
  #pointers = new Map();
  #pointer = null; // where the pointer is
  #turns = 0; // quarters, after the flip
  #isFlipped = false;

  /**
   * Place a picture, and place it again when its frame has another size.
   * @param {HTMLAnchorElement} frame
   * @param {HTMLCanvasElement} canvas
   */
  constructor(frame, canvas) {
    this.#frame = frame;
    this.#canvas = canvas;
    this.#line = frame.querySelector('.line');
    new ResizeObserver(() => this.place()).observe(frame);
  }

  /**
   * Listen to the pointers in the frame, unless the frame is a link.
   * @param {() => void} onChange called after a zoom.
   * @param {(event: PointerEvent) => boolean} onPointer called with an event of a pointer; returns
   *   whether it has another meaning.
   */
  listen(onChange, onPointer) {
    const frame = this.#frame;
    this.#onChange = onChange;
    const actions = {
      wheel: (event) => {
        event.preventDefault();
        const pixels = event.deltaY * (event.deltaMode ? WHEEL.line : 1);
        this.zoom(this.scale * Math.exp(-limit(pixels, -WHEEL.most, WHEEL.most) * WHEEL.speed),
          this.#exact(event));
      },
      dblclick: (event) => this.zoom(this.#scale ? 0 : 1 / devicePixelRatio, this.#exact(event)),
      pointerdown: (event) => {
        if (event.button) return; // of the menu, not of the picture
        frame.setPointerCapture(event.pointerId);
        if (!onPointer(event)) this.#pointers.set(event.pointerId, event);
      },
      pointermove: (event) => {
        this.#pointer = event;
        if (!onPointer(event) && this.#pointers.has(event.pointerId)) this.#drag(event);
      },
      pointerleave: (event) => onPointer(event),
    };
    actions.pointerup = actions.pointercancel = (event) => {
      this.#pointers.delete(event.pointerId);
      onPointer(event);
    };
    for (const [name, action] of Object.entries(actions)) {
      frame.addEventListener(name, (event) => !frame.href && this.size[0] && action(event));
    }
  }

  /** Return the place of a wheel or a click, which is rounded, as that of the pointer. */
  #exact(event) {
    const isThere = this.#pointer && ['clientX', 'clientY'].every(
      (name) => Math.abs(event[name] - this.#pointer[name]) < 1);
    return isThere ? this.#pointer : event;
  }

  /** Size of the frame in pixels of the page, along the axes of the image. */
  get #room() {
    const { width, height } = this.#frame.getBoundingClientRect(); // not rounded
    return this.#turns % 2 ? [height, width] : [width, height];
  }

  /** Width that the image can have, in pixels of the screen. */
  get width() {
    return this.#room[0] * devicePixelRatio;
  }

  get #fitting() {
    return Math.min(...this.#room.map((one, axis) => one / this.size[axis]));
  }

  /** Pixels of the page for a pixel of the image. */
  get scale() {
    return this.#scale || this.#fitting;
  }

  /** Part of the image that can be seen: x, y, width and height; null for the whole image. */
  get region() {
    const ends = this.size.map((size, axis) => {
      const half = this.#room[axis] / this.scale / 2;
      return [Math.max(0, Math.floor(this.#center[axis] - half)),
        Math.min(size, Math.ceil(this.#center[axis] + half))];
    });
    const sides = ends.map(([low, high]) => high - low);
    return !this.#scale || !sides.every(Boolean) || String(sides) === String(this.size) ? null
      : [...ends.map(([low]) => low), ...sides];
  }

  /** Return the way from pixels of the image to those of the frame. */
  get matrix() {
    const { width, height } = this.#frame.getBoundingClientRect();
    const { scale } = this;
    return new DOMMatrix().translate(width / 2, height / 2).rotate(90 * this.#turns)
      .scale(this.#isFlipped ? -scale : scale, scale)
      .translate(...this.#center.map((one) => -one));
  }

  #toImage({ clientX, clientY }) {
    const { left, top } = this.#frame.getBoundingClientRect();
    return this.matrix.inverse().transformPoint({ x: clientX - left, y: clientY - top });
  }

  /** Return the pixel at a place on the page; null outside of the image. @param {Place} place */
  pixel(place) {
    const { x, y } = this.#toImage(place);
    const pixel = [Math.floor(x), Math.floor(y)];
    return pixel.every((one, axis) => one >= 0 && one < this.size[axis]) ? pixel : null;
  }

  /**
   * Zoom, and keep a pixel at its place.
   * @param {number} scale pixels of the page for a pixel of the image; 0 fits the frame.
   * @param {Place} [from] place on the page of the pixel; none for the one in the middle.
   * @param {Place} to place on the page to which the pixel moves.
   */
  zoom(scale, from, to = from) {
    const held = from && this.#toImage(from);
    const wanted = limit(scale, Math.min(this.#fitting, 1 / devicePixelRatio),
      Math.max(MOST, this.#fitting));
    this.#scale = !scale || Math.abs(wanted / this.#fitting - 1) < 1e-3 ? 0 : wanted;
    const now = from && this.#toImage(to);
    if (from) this.#center = [this.#center[0] + held.x - now.x, this.#center[1] + held.y - now.y];
    this.place();
    this.#onChange();
  }

  /** Pan with one pointer; zoom with two. */
  #drag(event) {
    const before = this.#grip();
    this.#pointers.set(event.pointerId, event);
    const after = this.#grip();
    const ratio = after.spread / before.spread;
    if (this.#scale || ratio !== 1) this.zoom(this.scale * ratio, before, after);
  }

  /** Return the middle of the pointers, and their distance. */
  #grip() {
    const [one, other = one] = this.#pointers.values();
    return {
      clientX: (one.clientX + other.clientX) / 2, clientY: (one.clientY + other.clientY) / 2,
      spread: Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY) || 1,
    };
  }

  /** Place a canvas that has a part of an image; an image of another size fits the frame. */
  show(part, size) {
    if (String([part, size]) === String([this.#part, this.size])) return;
    if (String(size) !== String(this.size)) this.#scale = 0;
    this.#part = part;
    this.size = size;
    this.place();
  }

  /** Flip the image from left to right, then turn it by quarters. */
  turn({ turns, isFlipped }) {
    if (turns === this.#turns && isFlipped === this.#isFlipped) return;
    this.#turns = turns;
    this.#isFlipped = isFlipped;
    this.place();
  }

  /** Pixel of the image in the middle of the frame. */
  get middle() {
    return this.#center.map(Math.floor);
  }

  /** Pan as far as necessary to see a pixel. @param {number[]} pixel */
  reveal(pixel) {
    this.#center = pixel.map((one, axis) => {
      const half = this.#room[axis] / this.scale / 2 - 0.5;
      return limit(this.#center[axis], one + 0.5 - half, one + 0.5 + half);
    });
    this.place();
    this.#onChange();
  }

  /** Width of the image to its height, as it is shown. */
  get ratio() {
    const [width, height] = this.#turns % 2 ? this.size.toReversed() : this.size;
    return width / height;
  }

  /** Place the canvas again, because the frame has another size. */
  place() {
    const [x, y, width, height] = this.#part;
    if (!width || !this.#room[0]) return;
    this.#center = this.size.map((size, axis) => {
      const half = this.#room[axis] / this.scale / 2;
      return 2 * half >= size ? size / 2 : limit(this.#center[axis], half, size - half);
    });
    this.#canvas.style.width = `${width}px`;
    this.#canvas.style.height = `${height}px`;
    this.#canvas.style.transform = String(this.matrix.translate(x, y));
    this.#line?.setAttribute('transform', String(this.matrix));
    this.#canvas.classList.toggle('enlarged', this.scale * devicePixelRatio > ENLARGED);
    this.#frame.classList.toggle('zoomed', Boolean(this.#scale));
    this.onPlace();
  }
}
