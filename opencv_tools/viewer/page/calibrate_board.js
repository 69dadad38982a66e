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

const LAST = 'calibrated board'; // of localStorage

const part = (id) => document.getElementById(id);

/** The form of the board, with its printable files. */
export class Board {
  #send;
  #chosen = '';

  /** @param send sends a message to the session. */
  constructor(send) {
    this.#send = send;
    part('board').addEventListener('submit', (event) => {
      event.preventDefault();
      this.#send({ board: part('board-text').value });
    });
    part('board-text').addEventListener('input', () => this.#link());
  }

  /** Offer the kinds of boards, each with its example. */
  connected({ boards }) {
    const examples = boards.map((form) => form.split(' ').at(-1));
    part('boards').replaceChildren(...examples.map((text) => new Option(text)));
    if (!part('board-text').value) {
      part('board-text').value = localStorage.getItem(LAST) ?? examples[0];
    }
    this.#link();
  }

  show({ board, note }) {
    if (board && board !== this.#chosen) {
      localStorage.setItem(LAST, board);
      part('board-text').value = board;
      this.#link();
    }
    this.#chosen = board;
    if (note) part('note').textContent = `Note: ${note}.`;
  }

  #link() {
    const board = encodeURIComponent(part('board-text').value);
    for (const kind of ['pdf', 'svg']) {
      part(kind).href = `/calibrate/board?format=${kind}&board=${board}`;
    }
  }
}
