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

import { keep } from './address.js';

/** The robot in the grid: its own page in a frame, which exists while it is shown. */
export class Robot {
  #cameras;
  #button = document.getElementById('show-robot');
  #element = null;
  #isPublished = false;
  #isHidden = new URL(location).searchParams.get('robot') === 'hidden';

  /**
   * Create an object without a robot.
   *
   * @param cameras element with the tiles.
   * @param onChange called when the tile appears or disappears.
   */
  constructor(cameras, onChange) {
    this.#cameras = cameras;
    this.#button.addEventListener('click', () => {
      this.#isHidden = !this.#isHidden;
      keep({ robot: this.#isHidden && 'hidden' });
      onChange();
    });
    this.onChange = onChange;
  }

  get isShown() {
    return Boolean(this.#element && !this.#element.hidden);
  }

  /** Add the tile when the robot is published; it stays, so that it can say why nothing comes. */
  setPublished(isPublished) {
    this.#isPublished ||= isPublished;
    this.onChange();
  }

  /**
   * Show or hide the tile.
   *
   * @param isAll whether the page shows all tiles.
   * @param isPaused whether the page is paused.
   */
  show(isAll, isPaused) {
    this.#button.hidden = !this.#isPublished;
    this.#button.title = this.#isHidden ? 'Show the robot' : 'Hide the robot';
    this.#button.querySelector('span').textContent = this.#button.title;
    if (this.#isPublished && !this.#isHidden && !this.#element) {
      this.#element = document.getElementById('robot-tile').content.firstElementChild
        .cloneNode(true);
      this.#cameras.append(this.#element);
    }
    if (this.#isHidden) {
      this.#element?.remove();
      this.#element = null;
    }
    if (!this.#element) return;
    this.#element.hidden = !isAll;
    const frame = this.#element.querySelector('iframe');
    const isHeld = isPaused || !isAll;
    frame.dataset.held = isHeld; // for a page that is not loaded yet
    frame.contentWindow?.robotView?.live?.hold(isHeld);
  }
}
