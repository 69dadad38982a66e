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

const RADIUS = 3.5; // of a corner in pixels of the style sheet
const FLASH_MS = 400;
const KEPT_MS = 600; // of corners without a newer image

/** Corners and covered cells, drawn above a picture that fills its frame. */
export class Overlay {
  #canvas = document.createElement('canvas');
  #frame;
  #corners = [];
  #cells = [];
  #isCovered = true;
  #timer = 0;
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

  /** Show corners, parts of the width and the height of the picture. */
  see(corners) {
    this.#corners = corners;
    this.#canvas.dataset.corners = corners.length;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.see([]), KEPT_MS);
    if (!corners.length) clearTimeout(this.#timer);
    this.#draw();
  }

  /** Show which cells have corners of views. */
  cover(cells) {
    this.#cells = cells;
    this.#draw();
  }

  clear() {
    this.#cells = [];
    this.see([]);
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
    for (const [x, y] of this.#corners) {
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
