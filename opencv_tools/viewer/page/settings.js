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

// Settings beside the pictures: the range of depth, and parameters of cameras.

import { make, part } from './page.js';

/** @import { Answer, Parameter, Request } from '../messages.js' */

const RETRY_MS = 3000; // after a camera that did not describe its parameters
const LONGEST_SLIDER = 10000; // a longer range is a field, because a pixel would be many steps
const LARGEST = 1e300; // of the node

/**
 * Return two numbers that a comma separates, the lower one first; null for another text.
 * @param {string | null} text
 */
export function readLimits(text) {
  const limits = (text ?? '').split(',').map(Number);
  const isValid = limits.length === 2 && limits[0] < limits[1]
    && limits.every((one) => Math.abs(one) <= LARGEST);
  return isValid ? limits : null;
}

/**
 * Return the sentence about limits in the address that are not used; '' if there are none.
 * @param {string | null} text
 */
export function explainLimits(text) {
  return !text || readLimits(text) ? ''
    : `The range ${text} is not used: give two numbers, the lower one first.`;
}

/** Return a number with its unit. */
const measure = (value, unit) => `${Number(value.toPrecision(4))} ${unit}`;

/** Form with the range and the colours of depth. */
export class RangeForm {
  #form = part('range');
  #onChange;

  /**
   * @param {(values: { range: number[] | null, colors: string }) => void} onChange called with
   *   the limits, null for automatic ones, and the colours of depth.
   */
  constructor(onChange) {
    this.#onChange = onChange;
    this.#form.addEventListener('change', () => this.#change());
    this.#form.addEventListener('submit', (event) => event.preventDefault());
  }

  /**
   * @param {number[] | null} used limits of the present picture; null if it has none.
   * @param {number[] | null} chosen limits that somebody has chosen; null for automatic limits.
   * @param {string} colors colours that somebody has chosen; '' for the first ones.
   * @param {string} unit of depth; '' for other numbers.
   */
  show(used, chosen, colors, unit) {
    this.#form.hidden = !used;
    if (!used) return;
    for (const element of this.#form.querySelectorAll('[data-of]')) element.hidden = !unit;
    part('colors').value = colors || part('colors').options[0].value;
    part('bar').dataset.colors = part('colors').value;
    const [low, high] = chosen ?? used;
    part('bar-low').textContent = measure(low, unit);
    part('bar-high').textContent = measure(high, unit);
    part('automatic').checked = !chosen;
    for (const [place, input] of [part('low'), part('high')].entries()) {
      input.readOnly = !chosen;
      const isTyping = chosen && this.#form.contains(document.activeElement);
      if (!isTyping) input.value = chosen ? chosen[place] : Number(used[place].toPrecision(4));
    }
  }

  #change() {
    const limits = readLimits(`${part('low').valueAsNumber},${part('high').valueAsNumber}`);
    part('high').setCustomValidity(limits ? '' : 'Give two numbers, the lower one first.');
    const { value: colors, options: [first] } = part('colors');
    const isValid = part('automatic').checked || this.#form.reportValidity();
    if (!isValid) return;
    this.#onChange({ range: part('automatic').checked ? null : limits,
      colors: colors === first.value ? '' : colors });
  }
}

/** Return words of a parameter's name: exposure_time_absolute is "exposure time absolute". */
const words = (name) => name.replaceAll('_', ' ');

/** Return a field for a number. @param {Parameter} parameter */
function makeNumber({ type, minimum, maximum, step }) {
  return make('input', { type: 'number', min: minimum ?? '', max: maximum ?? '',
    step: step || (type === 'integer' ? 1 : 'any') });
}

/** Return the input for a parameter. @param {Parameter} parameter */
function makeInput(parameter) {
  const { type, minimum, maximum, choices } = parameter;
  if (!choices.length && (type === 'integer' || type === 'double')) {
    const input = makeNumber(parameter);
    const isRange = minimum !== null && maximum !== null && maximum - minimum <= LONGEST_SLIDER;
    if (isRange) input.type = 'range';
    return input;
  }
  const input = make(choices.length ? 'select' : 'input');
  for (const [value, text] of choices) input.append(new Option(text, JSON.stringify(value)));
  if (!choices.length && type === 'bool') {
    Object.assign(input, { type: 'checkbox', role: 'switch' });
  }
  return input;
}

function read(input, { type, choices }) {
  if (choices.length) return JSON.parse(input.value);
  if (type === 'bool') return input.checked;
  return type === 'string' ? input.value : input.valueAsNumber;
}

function write(input, { type, choices }, value) {
  if (choices.length) input.value = JSON.stringify(value);
  else if (type === 'bool') input.checked = value;
  else input.value = value;
}

/** One parameter of a node: a slider, menu, switch or field. */
class Row {
  #parameter;
  #send;
  #input;
  #field = null; // beside a slider, for exact numbers
  #isSending = false;
  #next = null; // input that has changed meanwhile

  constructor(parameter, send) {
    this.#parameter = parameter;
    this.#send = send;
    this.#input = makeInput(parameter);
    const kind = { checkbox: 'switch', range: 'slider', number: 'number' }[this.#input.type];
    this.element = make('label', { className: kind ?? 'field', title: parameter.description },
      make('span', {}, words(parameter.name)), this.#input);
    if (kind === 'slider') {
      this.#field = makeNumber(parameter);
      this.#input.before(this.#field);
      this.#field.addEventListener('change', () => this.#set(this.#field));
    }
    for (const input of this.element.querySelectorAll('input, select')) {
      input.setAttribute('aria-label', words(parameter.name));
      input.disabled = parameter.read_only;
    }
    this.isSimple = !parameter.read_only
      && (kind === 'slider' || kind === 'switch' || parameter.choices.length > 0);
    // A slider sends while it moves, but no faster than the camera answers.
    this.#input.addEventListener(kind === 'slider' ? 'input' : 'change',
      () => this.#set(this.#input));
    this.update(parameter);
  }

  #set(input) {
    const value = read(input, this.#parameter);
    if (Number.isNaN(value)) return;
    this.#show(value);
    this.#next = this.#isSending && input;
    if (this.#isSending) return;
    this.#isSending = true;
    this.#send(this.#parameter.name, value);
  }

  /** Show the value that the node has after a request. */
  answered(value) {
    this.#isSending = false;
    if (this.#next) this.#set(this.#next);
    else this.#show(value);
  }

  /** Show the value of the node, unless somebody changes it here. */
  update({ value }) {
    const { activeElement: active } = document;
    const isTyping = this.element.contains(active) && active.matches('input:not([type=checkbox])');
    if (!this.#isSending && !isTyping) this.#show(value);
  }

  #show(value) {
    write(this.#input, this.#parameter, value);
    if (this.#field) this.#field.value = value;
  }
}

/** Parameters of one node that publishes images, and the switch of its camera. */
class CameraPanel {
  element = make('section', { className: 'node', hidden: true }); // until it has settings
  #rows = new Map();
  #shape = '';

  constructor(node, send) {
    this.node = node;
    this.send = send;
    this.element.append(make('h2', {}, node));
  }

  update({ parameters, capture }) {
    const shape = JSON.stringify([capture, parameters.map((one) => ({ ...one, value: 0 }))]);
    if (shape !== this.#shape) this.#build(parameters, capture);
    this.#shape = shape;
    for (const parameter of parameters) this.#rows.get(parameter.name).update(parameter);
  }

  #build(parameters, capture) {
    this.element.replaceChildren(make('h2', {}, this.node));
    if (capture) this.element.append(this.#captureButtons());
    const others = make('details', {}, make('summary', {}, 'Other parameters'));
    this.#rows.clear();
    for (const parameter of parameters) {
      const row = new Row(parameter, (name, value) => this.send({ set: this.node, name, value }));
      this.#rows.set(parameter.name, row);
      (row.isSimple ? this.element : others).append(row.element);
    }
    if (others.children.length > 1) this.element.append(others);
    this.element.hidden = this.element.children.length < 2;
  }

  #captureButtons() {
    return make('p', { className: 'buttons' }, ...[true, false].map((on) => make('button', {
      onclick: () => this.send({ capture: this.node, on }),
    }, on ? 'Start camera' : 'Stop camera')));
  }

  answered({ name, value }) {
    this.#rows.get(name)?.answered(value);
  }
}

/** The controls of the cameras and recorders, if the node allows them. */
export class Controls {
  #element;
  #send;
  #notify;
  #isEnabled = false;
  /** @type {{ cameras: string[], recorders: string[] }} */
  #nodes = { cameras: [], recorders: [] };
  #panels = new Map();
  #shown = '';

  /**
   * @param {Element} element parent of the controls.
   * @param {(message: Request) => void} send sends a message to the server.
   * @param {(sentence: string) => void} notify shows a sentence.
   */
  constructor(element, send, notify) {
    this.#element = element;
    this.#send = send;
    this.#notify = notify;
  }

  /** Begin a connection, with or without controls. @param {boolean} isEnabled */
  enable(isEnabled) {
    this.#isEnabled = isEnabled;
    this.#nodes = { cameras: [], recorders: [] };
    this.#shown = '';
  }

  /** Show the controls of the nodes that publish a topic. @param {string[]} publishers */
  show(publishers) {
    const { cameras: all, recorders: some } = this.#nodes;
    const cameras = this.#isEnabled ? all.filter((one) => publishers.includes(one)) : [];
    const recorders = this.#isEnabled && publishers.length ? some : [];
    const shown = JSON.stringify([cameras, recorders]);
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.#panels.clear();
    this.#element.replaceChildren();
    for (const node of cameras) {
      const panel = new CameraPanel(node, this.#send);
      this.#panels.set(node, panel);
      this.#element.append(panel.element);
      this.#send({ parameters: node });
    }
    for (const node of recorders) this.#element.append(this.#recorder(node));
  }

  #recorder(node) {
    const onclick = () => this.#send({ save: node });
    return make('section', { className: 'node' }, make('h2', {}, node),
      make('button', { onclick }, 'Record the next picture'));
  }

  /** Handle a message of the server that concerns controls. @param {Answer} message */
  receive({ nodes, parameters, set, capture, save }) {
    if (nodes) this.#nodes = nodes;
    if (parameters) this.#described(parameters);
    if (set) {
      this.#panels.get(set.node)?.answered(set);
      if (set.ok) this.#send({ parameters: set.node }); // others may depend on this one
      else this.#notify(set.message);
    }
    const done = capture ?? save;
    if (done) this.#notify(done.message || (done.ok ? 'Done' : 'Not done'));
  }

  /** Show the parameters of a camera; one that does not answer is asked again. */
  #described(parameters) {
    const { node, ok, message } = parameters;
    const panel = this.#panels.get(node);
    if (ok !== false) {
      panel?.update(parameters);
      return;
    }
    this.#notify(message);
    setTimeout(() => {
      if (panel && this.#panels.get(node) === panel) this.#send({ parameters: node });
    }, RETRY_MS);
  }
}
