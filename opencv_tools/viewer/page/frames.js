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

// Frames that the node keeps: steps through them, and their recording.

import { age, make, number, part } from './page.js';

/**
 * @import { Account, Answer, Request, StepAnswer } from '../messages.js'
 * @typedef {(message: Request) => void} Send
 */

/** Steps through the frames that the node has kept, while the page is paused. */
export class Steps {
  #send;
  #waits = false; // for the answer, which comes when the picture is drawn
  #next = null; // step that was asked for meanwhile
  #isRepeated = false; // whether a key is held

  /** @param {Send} send sends a message to the server. */
  constructor(send) {
    this.#send = send;
    for (const kind of ['keydown', 'keyup']) {
      addEventListener(kind, (event) => {
        this.#isRepeated = /** @type {KeyboardEvent} */ (event).repeat;
      }, true);
    }
  }

  /** Show the buttons of a paused page. @param {boolean} isPaused */
  show(isPaused) {
    if (!isPaused) this.#write('');
    part('earlier').hidden = part('later').hidden = !isPaused;
  }

  #write(topic, text = '') {
    for (const output of document.querySelectorAll('output.step')) {
      const tile = /** @type {HTMLElement} */ (output.closest('.tile'));
      output.textContent = tile.dataset.topic === topic ? text : '';
    }
  }

  /**
   * Step in a topic and in that beside it, but wait for each picture while a key is held.
   * @param {number} by frames.
   * @param {string} step
   * @param {string} beside
   */
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

  /** Show the answer of the server. @param {StepAnswer} answer */
  receive({ topic, text, error }) {
    if (!this.#waits) return; // it is of a picture that was left
    this.#write(part('earlier').hidden ? '' : topic, error ?? text);
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

const BUTTONS = ['record', 'keep', 'choose', 'record-chosen'];
const UNKNOWN = 'No answer: nobody knows whether it records';

/** Return bytes as text. */
const amount = (bytes) => (bytes < 1e6 ? `${number(bytes / 1e3)} kB`
  : bytes < 1e9 ? `${number(bytes / 1e6)} MB` : `${number(bytes / 1e9)} GB`);

/** Return an account as text. @param {Account} account */
function describe(account) {
  const { topics, seconds, frames, lost, dropped, failed, bytes, left, name, folder } = account;
  return [`${topics.length} ${topics.length > 1 ? 'topics' : 'topic'}`, age(seconds),
    `${frames} frames`, `${lost} lost`, `${dropped} dropped`, failed && `${failed} failed`,
    amount(bytes), left !== null && `${amount(left)} left`, name && `${folder}/${name}`].filter(Boolean).join(', ');
}

/** The buttons that record, and the account of the recording, which all pages show. */
export class Recording {
  /** @type {Account} */
  #state = { phase: '' };
  #onChange;
  #allowsDownload = false;
  #isKnown = true;
  #wasOn = false; // as the node has said last, maybe over another connection
  #isSeen = false; // by this page, so that the account stays after the end

  /**
   * @param {Send} send sends a message to the server.
   * @param {() => { id: number, name: string, isShown: boolean }[]} topics returns the topics.
   * @param {(sentence: string) => void} onChange called with a sentence after a request, and with
   *   '' at another change.
   */
  constructor(send, topics, onChange) {
    const shown = () => topics().filter(({ isShown }) => isShown).map(({ id }) => id);
    this.#onChange = onChange;
    part('record').addEventListener('click', () => {
      send({ record: this.#state.phase === '' && shown(), since: this.#state.since });
    });
    part('keep').addEventListener('click', () => send({ keep: shown() }));
    part('choice').addEventListener('beforetoggle', () => {
      part('choices').replaceChildren(...topics().map(({ id, name, isShown }) => make('label', {},
        make('input', { type: 'checkbox', value: id, checked: isShown }), ` ${name}`)));
    });
    part('record-chosen').addEventListener('click', () => {
      const chosen = [...part('choices').querySelectorAll(':checked')];
      send({ record: chosen.map(({ value }) => Number(value)), since: this.#state.since });
      part('choice').hidePopover();
    });
    part('forget').addEventListener('click', () => {
      this.#isSeen = false;
      this.#show(this.#state);
    });
  }

  get isOn() {
    return this.#state.phase !== '';
  }

  /** Begin a connection to a node that may not record. @param {boolean} allowsDownload */
  enable(allowsDownload) {
    this.#allowsDownload = allowsDownload;
    this.#show({ phase: '' });
    part('record').hidden = part('choose').hidden = part('record-key').hidden = true;
  }

  /** Say whether the state is known, which it is not while the node is silent. @param {boolean} isKnown */
  know(isKnown) {
    if (isKnown === this.#isKnown) return;
    this.#isKnown = isKnown;
    for (const id of BUTTONS) part(id).disabled = !isKnown;
    this.#tell();
  }

  #tell() {
    const { topics, problem } = this.#state;
    const verb = this.isOn ? 'Recording' : 'Recorded';
    if (this.isOn && !this.#isKnown) part('recording').textContent = UNKNOWN;
    else if (topics) part('recording').textContent = `${verb} ${describe(this.#state)}${problem ? `: ${problem}` : ''}`;
  }

  /** Handle a message of the server that concerns recordings. @param {Answer} message */
  receive({ recording, record, keep }) {
    if (recording) this.#show(recording);
    const isBegun = record?.ok && this.isOn; // as the account says
    const isLost = recording && this.#wasOn && !this.isOn && !recording.topics;
    const done = isBegun ? null : record ?? keep
      ?? (isLost && { message: 'The recording has ended with the node' });
    if (done) this.#onChange(done.message); // an alert
    if (!recording || this.#wasOn === this.isOn) return;
    this.#wasOn = this.isOn;
    part('said').textContent = done ? '' : `The recording has ${this.isOn ? 'begun' : 'ended'}`;
  }

  #show(state) {
    const wasOn = this.isOn;
    this.#state = state;
    this.#isSeen ||= this.isOn;
    part('record').hidden = part('record-key').hidden = false;
    part('record').querySelector('span').textContent = this.isOn ? 'Stop' : 'Record';
    part('choose').hidden = this.isOn;
    part('keep').hidden = !state.keeps;
    part('record').ariaPressed = this.isOn;
    part('recording').hidden = !this.#isSeen || !state.topics;
    part('forget').hidden = part('recording').hidden || this.isOn;
    part('bag').hidden = part('forget').hidden || !this.#allowsDownload || !state.name;
    part('bag').href = `/bag?name=${encodeURIComponent(state.name ?? '')}`;
    this.#tell();
    if (wasOn !== this.isOn) this.#onChange('');
  }
}
