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

// The panel: sliders, the tree, the numbers of the chosen link, and the files.
import { poseOf } from './motion.js';

/** @import { Motion } from './motion.js' */
/** @typedef {Record<string, any>} Robot as content.py describes it. */
/** @typedef {{ uri: string, size: number, reason: string, parts?: Record<string, number> }} Mesh */

const MAX_ROWS = 3000;
const MAX_DEPTH = 12; // deeper links are not indented further
const MAX_FRAMES = 100; // of one link
const PLACES = { floating: ['x', 'y', 'z', 'roll', 'pitch', 'yaw'], ball: ['roll', 'pitch', 'yaw'],
  planar: ['u', 'v', 'angle'], universal: ['axis 1', 'axis 2'] };

/** @type {(id: string) => any} */
export const byId = (id) => document.getElementById(id);

/**
 * Return a new element with properties and children; texts are never read as HTML.
 * @param {string} tag
 * @param {Record<string, any>} properties
 * @param {...(Node | string)} children
 */
function element(tag, { data = {}, ...others } = {}, ...children) {
  const created = Object.assign(document.createElement(tag), others);
  Object.assign(created.dataset, data);
  created.append(...children);
  return created;
}

const digits = (value) => String(Number(value.toPrecision(6)));
const joined = (values) => values.map((value) => digits(value)).join('  ');

/**
 * Fill a list with a slider for each number of each movable joint.
 * @param {HTMLElement} list
 * @param {Robot} robot
 * @param {Motion} motion
 * @param {(joint: number, index: number, value: number) => void} onMove
 */
export function fillSliders(list, robot, motion, onMove) {
  const rows = [];
  robot.joints.forEach((joint, number) => joint.spans.slice(0, joint.loop ? 0 : undefined).forEach(
    (span, index) => {
      if (rows.length >= MAX_ROWS) return;
      const [lower, upper] = joint.limits[index];
      const place = PLACES[joint.kind]?.[index];
      const unit = joint.kind === 'prismatic' || (joint.kind === 'floating' && index < 3)
        || (joint.kind === 'planar' && index < 2) ? 'm' : 'rad';
      const leader = joint.mimic.find(([one]) => one === index);
      const name = place ? `${joint.name} ${place}` : joint.name;
      const output = element('output', {}, '0');
      const slider = element('input', { type: 'range', step: 'any', disabled: Boolean(leader),
        min: lower ?? Math.min(-span, (upper ?? 0) - span),
        max: upper ?? Math.max(span, (lower ?? 0) + span), value: 0 });
      slider.addEventListener('input', () => onMove(number, index, Number(slider.value)));
      const limits = lower === null && upper === null ? 'no limits'
        : `${lower === null ? '-∞' : digits(lower)} to ${upper === null ? '∞' : digits(upper)} ${unit}`;
      const follows = leader
        ? `, follows ${robot.joints[leader[1]]?.name ?? 'a joint that does not exist'}` : '';
      const row = element('label', { className: 'joint' }, element('span', {}, name), output, slider,
        element('small', {}, `${joint.type}, ${limits}${follows}`));
      rows.push({ number, index, slider, output, unit });
      list.append(row);
    }));
  if (rows.length >= MAX_ROWS) {
    list.append(element('p', { className: 'hint' }, `The first ${MAX_ROWS} positions are listed.`));
  }
  if (!rows.length) list.append(element('p', { className: 'hint' }, 'No joint moves.'));
  return () => {
    for (const { number, index, slider, output, unit } of rows) {
      const value = motion.positions[number][index];
      output.textContent = `${digits(value)} ${unit}`;
      if (Number(slider.value) !== value) slider.value = value;
    }
  };
}

/**
 * Fill a list with the links, each below its parent, and with the joints between them.
 * @param {HTMLElement} list
 * @param {Robot} robot
 * @param {(link: number) => void} onChoose
 * @returns {(chosen: number) => void} shows which link is chosen.
 */
export function fillTree(list, robot, onChoose) {
  const below = robot.links.map(() => []);
  for (const number of robot.order) below[robot.joints[number].parent].push(number);
  const frames = framesOf(robot);
  const stack = robot.roots.map((link) => [link, 0, -1]).reverse();
  const rows = new Map();
  while (stack.length && rows.size < MAX_ROWS) {
    const [link, depth, joint] = stack.pop();
    const button = element('button', { type: 'button' }, robot.links[link].name);
    if (joint >= 0) {
      button.append(element('small', {}, `${robot.joints[joint].name}, ${robot.joints[joint].type}`));
    }
    button.append(...(frames.get(link) ?? []).map(
      (number) => element('small', {}, `frame ${robot.frames[number].name}`)));
    button.style.paddingLeft = `${0.5 + Math.min(depth, MAX_DEPTH) * 0.9}rem`;
    button.addEventListener('click', () => onChoose(link));
    rows.set(link, button);
    list.append(button);
    for (const other of below[link].reverse()) {
      stack.push([robot.joints[other].child, depth + 1, other]);
    }
  }
  const hidden = robot.links.length - rows.size;
  if (hidden) list.append(element('p', { className: 'hint' }, `${hidden} more links`));
  return (chosen) => rows.forEach((button, link) => {
    button.setAttribute('aria-current', String(link === chosen));
  });
}

/** Return the numbers of the first frames of each link, by the number of the link. */
function framesOf(robot) {
  const found = new Map();
  robot.frames.forEach(({ link }, number) => {
    if (!found.has(link)) found.set(link, []);
    if (found.get(link).length < MAX_FRAMES) found.get(link).push(number);
  });
  return found;
}

/**
 * Fill a table with the numbers of a link and of its joint in every convention.
 * @param {HTMLElement} table
 * @param {Robot} robot
 * @param {Motion} motion
 * @param {number} number
 * @param {{ meshes: Mesh[], onLine: (convention: string, line: number) => void }} context onLine
 *   is called when a number of a file is pressed.
 * @returns a function that shows the numbers at the present positions.
 */
export function fillNumbers(table, robot, motion, number, { meshes, onLine }) {
  table.replaceChildren();
  const link = robot.links[number];
  const joint = robot.joints[link.joint];
  const row = (label, text, name = '') => {
    const cell = element('td', { data: { name } }, text);
    table.append(element('tr', {}, element('th', { scope: 'row' }, label), cell));
    return cell;
  };
  const written = (convention, kind, name, label) => {
    const pose = robot.files[convention].poses[kind]?.[name];
    if (!pose) return;
    const [inKind, inName] = pose.in;
    const cell = row(label, `${joined(pose.numbers)}\nin ${inKind} ${inName}`.trimEnd(),
      `${convention}-${kind}`);
    if (!pose.line) return;
    const button = element('button', { type: 'button', className: 'line' },
      pose.file ? `${pose.file}:${pose.line}` : `line ${pose.line}`);
    if (pose.file || !robot.files[convention].text) button.disabled = true;
    button.addEventListener('click', () => onLine(convention, pose.line));
    cell.append(' ', button);
  };
  row('Link', link.name, 'link');
  if (joint) {
    row('Joint', `${joint.name}, ${joint.type}`, 'joint');
    written('urdf', 'joint', joint.name, 'URDF <origin> of the joint');
    written('sdf', 'joint', joint.name, 'SDF <pose> of the joint');
    joint.axes.slice(0, joint.drawn_axes).forEach((axis) => row('Axis in the joint', joined(axis)));
    for (const [, leader, multiplier, offset] of joint.mimic) {
      row('Mimics', `${robot.joints[leader]?.name ?? '?'} · ${digits(multiplier)} + ${digits(offset)}`);
    }
  } else {
    row('Joint', 'none: a root link');
  }
  written('sdf', 'link', link.name, 'SDF <pose> of the link');
  row('Link in the model at zero', joined(link.in_model), 'in-model');
  const now = row('Link in the model now', '', 'now');
  const inRoot = row('Link in the root link now', '', 'in-root');
  if (link.inertial) {
    row('Mass', `${digits(link.inertial.mass)} kg`);
    row('Inertia xx xy xz yy yz zz', joined(link.inertial.inertia));
  }
  const frames = (framesOf(robot).get(number) ?? []).map((index) => {
    const { name, attached_to: [kind, owner], in_link: inLink } = robot.frames[index];
    row('Frame', `${name}, attached to ${kind} ${owner}`.trimEnd(), 'frame');
    written('sdf', 'frame', name, 'SDF <pose> of the frame');
    row('Frame in the link', joined(inLink), 'frame-in-link');
    return [row('Frame in the model now', '', 'frame-now'), motion.frames[index]];
  });
  for (const kind of ['visuals', 'collisions']) {
    for (const { name, geometry } of link[kind]) {
      const mesh = meshes[geometry.mesh];
      const reason = mesh?.reason || geometry.reason;
      const text = mesh ? `${mesh.uri}, ${mesh.size} bytes` : geometry.kind;
      const lost = Object.values(mesh?.parts ?? {}).map((one) => meshes[one])
        .filter((one) => one.reason).map((one) => ` ${one.uri} not shown: ${one.reason}`);
      const cell = row(kind === 'visuals' ? 'Visual' : 'Collision', `${name} ${text}`.trim());
      if (reason) lost.unshift(` not shown: ${reason}`);
      cell.append(...lost.map((one) => element('span', { className: 'reason' }, one)));
    }
  }
  return () => {
    const pose = motion.links[number];
    now.textContent = joined(poseOf(pose));
    for (const [cell, matrix] of frames) cell.textContent = joined(poseOf(matrix));
    const root = motion.links[robot.roots[0]];
    inRoot.textContent = joined(poseOf(root.clone().invert().multiply(pose)));
  };
}

/**
 * Show the text of a file with one line marked.
 * @param {HTMLDetailsElement} box
 * @param {{ name: string, text: string, reason: string }} file
 * @param {number} line
 */
export function showFile(box, { name, text, reason }, line) {
  box.querySelector('.name').textContent = reason ? `${name} ${reason}`.trim() : name;
  const lines = text.split('\n');
  const cut = (from, to) => lines.slice(from, to).map((one) => `${one}\n`).join('');
  const mark = element('mark', {}, cut(line - 1, line));
  box.querySelector('code').replaceChildren(
    ...(line ? [cut(0, line - 1), mark, cut(line)] : [text]));
  if (line) mark.scrollIntoView({ block: 'center' });
}

/**
 * Fill a list with the differences between two robots.
 * @param {HTMLElement} list
 * @param {Record<string, any>[]} differences
 * @param {(difference: Record<string, any>) => void} onChoose
 */
export function fillDifferences(list, differences, onChoose) {
  list.append(...differences.map((one) => {
    const button = element('button', { type: 'button' },
      element('b', {}, `${one.element} ${one.name}: ${one.property}`),
      element('span', {}, `A ${one.a}`), element('span', {}, `B ${one.b}`));
    button.addEventListener('click', () => onChoose(one));
    return button;
  }));
}
