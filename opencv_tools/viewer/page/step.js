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

/** Steps through the frames that the node has kept, while the page is paused. */
export class Steps {
  #send;
  #waits = false; // for the answer, which comes when the picture is drawn
  #next = null; // step that was asked for meanwhile
  #isRepeated = false; // whether a key is held

  /** Begin without steps; `send` sends a message to the server. */
  constructor(send) {
    this.#send = send;
    for (const kind of ['keydown', 'keyup']) {
      addEventListener(kind, ({ repeat }) => { this.#isRepeated = repeat; }, true);
    }
  }

  /** Show the buttons of a paused page. */
  show(isPaused) {
    if (!isPaused) this.#write('');
    for (const button of document.querySelectorAll('button.step')) button.hidden = !isPaused;
  }

  #write(topic, text) {
    for (const output of document.querySelectorAll('output.step')) {
      output.textContent = output.closest('.tile').dataset.topic === topic ? text : '';
    }
  }

  /** Step in a topic and in that beside it, but wait for each picture while a key is held. */
  by(by, step, beside) {
    if (this.#waits && this.#isRepeated) return;
    this.#next = { step, by: by + (this.#next?.step === step ? this.#next.by : 0), beside };
    this.#ask();
  }

  #ask() {
    if (this.#waits || !this.#next) return;
    this.#send(this.#next);
    this.#waits = true;
    this.#next = null;
  }

  /** Show the answer of the server. */
  receive({ topic, text, error }) {
    if (!this.#waits) return; // it is of a picture that was left
    this.#write(document.querySelector('button.step').hidden ? '' : topic, error ?? text);
    this.#waits = false;
    this.#ask();
  }

  /** Forget the steps of an earlier connection, or of another picture. */
  reset() {
    this.#write('');
    this.#waits = false;
    this.#next = null;
  }
}
