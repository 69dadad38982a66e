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

// The live robot of img_viewer: a new robot, the positions of its joints, and their age.
import { byId } from './panel.js';

const REFRESH_MS = 500;

/** Follow the robot until somebody moves a joint, and again after a click on Resume. */
export class Live {
  /**
   * @param {object} listener
   * @param {(found: any) => unknown} listener.onRobot called with each new document.
   * @param {(positions: Iterable<[number, number[]]>) => void} listener.onMove called with the
   *   numbers of joints and their positions.
   * @param {(text: string) => void} listener.onError called with the text above the robot.
   */
  constructor(listener) {
    this.listener = listener;
    this.version = 0; // of the robot that is shown
    this.newest = new Map(); // positions by number of the joint
    this.newestVersion = 0; // of the robot that they belong to
    this.isPaused = this.isLost = false;
    this.isHeld = window.frameElement?.getAttribute('data-held') === 'true';
    this.isSeen = true;
    const address = new URL(location.href);
    address.searchParams.delete('token');
    history.replaceState(null, '', address);
    document.body.dataset.part = address.searchParams.get('part') ?? 'page';
    byId('back').hidden = false;
    byId('resume').addEventListener('click', () => this.pause(false));
    new IntersectionObserver(([{ isIntersecting }]) => {
      this.isSeen = isIntersecting;
      this.watch();
    }).observe(byId('stage'));
    document.addEventListener('visibilitychange', () => this.watch());
    setInterval(() => document.hidden || this.show(), REFRESH_MS);
    this.connect();
  }

  async connect() {
    const { Connection } = await import('./connection.js');
    this.connection = new Connection({
      connected: () => {
        this.isLost = this.isWatching = false;
        this.watch();
      },
      disconnected: (sentence) => {
        this.isLost = true;
        if (sentence) this.report(sentence);
        this.show();
      },
      received: (message) => this.receive(message),
      frame: () => {},
    }, '/robot/ws');
  }

  /** Ask for the robot, or for nothing, if that is not what was asked last. */
  watch() {
    const isWanted = this.isSeen && !this.isHeld && !document.hidden;
    if (!this.connection?.isOpen || isWanted === this.isWatching) return;
    this.isWatching = isWanted;
    this.connection.send({ watch: isWanted });
  }

  /** Hold everything while the page around this one is paused. */
  hold(isHeld) {
    this.isHeld = isHeld;
    this.watch();
    this.show();
  }

  /** Stop to follow, because somebody moves a joint, or follow again. */
  pause(isPaused) {
    if (isPaused === this.isPaused) return;
    this.isPaused = isPaused;
    this.apply(this.newest);
    this.show();
  }

  /** @param {import('../../../viewer/messages.js').RobotAnswer} message */
  async receive({ state, version, positions }) {
    if (positions) {
      this.connection.send({ got: version });
      if (version !== this.newestVersion) this.newest.clear();
      this.newestVersion = version;
      for (const [joint, values] of positions) this.newest.set(joint, values);
      this.apply(positions);
    }
    if (!state) return;
    this.state = state;
    this.show();
    this.report(state.error);
    if (state.version !== this.version) await this.load(state.version);
  }

  /** Show the robot of a version, which is the newest one. */
  async load(version) {
    if (this.loading === version) return;
    this.loading = version;
    try {
      const found = await (await fetch('robot.json')).json();
      if (found.robots) await this.listener.onRobot(found);
      this.version = found.version;
      this.apply(this.newest);
    } catch (err) {
      this.report(String(err));
    } finally {
      this.loading = 0; // the next state asks again
    }
  }

  apply(positions) {
    if (!this.isPaused && this.version && this.newestVersion === this.version) {
      this.listener.onMove(positions);
    }
  }

  report(text) {
    if (text !== this.error) this.listener.onError(text);
    this.error = text;
  }

  /** Show whether the robot is live, and since when it is not. */
  show() {
    const { state = { late: false, age: null, rate: 0, notes: [] } } = this;
    const age = state.age === null ? '' : `${state.age.toFixed(1)} s`;
    let [status, text] = ['late', 'Connecting'];
    const silence = this.isLost ? 'No connection to img_viewer'
      : this.connection?.mood === 'stalled' ? 'img_viewer does not answer' : '';
    if (silence) [status, text] = [this.isPaused ? 'late' : 'silent', silence];
    else if (this.isPaused || this.isHeld) text = 'Paused';
    else if (state.late) text = age ? `No positions for ${age}` : 'No positions yet';
    else if (age) [status, text] = ['live', `Live, ${state.rate} Hz, age ${age}`];
    const sentences = [text, ...(silence ? [] : state.notes)].join('. ').replaceAll('..', '.');
    byId('live').hidden = false;
    byId('live').dataset.status = status;
    if (byId('live').textContent !== sentences) {
      byId('live').title = byId('live').textContent = sentences;
    }
    byId('resume').hidden = !this.isPaused;
  }
}
