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

// The page: one or two robots, the choice of the convention, and the reload after a change.
import { Live } from './live.js';
import { PARTS, RobotView } from './robot.js';
import { Meshes, pauses } from './shapes.js';
import { MAX_NAMES, Stage } from './stage.js';
import {
  byId, fillDifferences, fillNumbers, fillSliders, fillTree, showFile,
} from './panel.js';

const RETRY_MS = 2000;
const embedded = byId('robot');
/** @type {any} */
let page; // what is shown: the document, the views of the robots, and what updates the panel
let chosen = { robot: 0, link: 0 };
let pointed; // the link below the pointer, and its robot
let stage;
let live; // in img_viewer
const moves = new Map(); // positions of the live robot since the last drawing, by number of the joint

/** Return the parts that are switched on. */
const shown = () => new Set(PARTS.filter((name) => byId(`show-${name}`).checked));
/** @type {(selector: string) => any} */
const find = (selector) => document.querySelector(selector);
const view = () => find('input[name=view]:checked').value;

const fit = () => page && stage?.fit(page.views.flatMap((one) => one.corners(shown())));

/** Draw again; the camera shows the whole robot until somebody moves the camera. */
function adjust() {
  if (stage?.isMoved) stage.request();
  else fit();
}

/** Show a mesh that has come, or the reason why it is not shown. */
function showMesh() {
  if (!page) return; // another robot is not complete yet
  showChosen();
  fade();
  adjust();
}

/** Prepare the scene for one view, and return its names. */
function beforeView(convention) {
  const parts = shown();
  const labels = [];
  page?.views.forEach((one) => {
    one.show(convention, parts);
    if (!one.group.visible) return;
    const add = (kind, number) => labels.push({ text: one.robot[`${kind}s`][number].name,
      point: kind === 'link' && !parts.has('frames') ? one.middle(number)
        : new THREE.Vector3().setFromMatrixPosition(one.motion[`${kind}s`][number]) });
    const marked = [pointed, chosen.isTinted && chosen].filter((found) => found?.robot === one.number);
    for (const link of new Set(marked.map((found) => found.link))) add('link', link);
    if (!byId('show-names').checked) return;
    const frames = [convention === 'urdf' ? 'joint' : 'link', 'frame'];
    for (const kind of parts.has('frames') ? frames : ['link']) {
      one.robot[`${kind}s`].slice(0, MAX_NAMES).forEach((_, number) => {
        if (kind !== 'link' || !marked.some(({ link }) => link === number)) add(kind, number);
      });
    }
  });
  return labels;
}

/** Show the name of the link below the pointer. */
function showPointed(found) {
  if (found?.link === pointed?.link && found?.robot === pointed?.robot) return;
  pointed = found;
  stage.request();
}

function choose(link, robot = chosen.robot) {
  chosen = { robot, link, isTinted: true };
  showChosen();
}

/** Show the chosen link; the root link at the start is not tinted, as nobody has chosen it. */
function showChosen() {
  const { robot, link, isTinted } = chosen;
  const one = page.views[robot];
  page.views.forEach((other) => other.mark(other === one && isTinted ? link : -1));
  page.showTree(robot === 0 ? link : -1);
  page.showNumbers = fillNumbers(byId('numbers'), one.robot, one.motion, link, {
    meshes: page.document.meshes, onLine: (convention, line) => openFile(convention, line) });
  page.showNumbers();
  stage?.request();
}

function openFile(convention, line = 0) {
  find(`input[name=file][value=${convention}]`).checked = true;
  byId('file').open = true;
  showFile(byId('file'), page.views[chosen.robot].robot.files[convention], line);
}

/** Move a joint of the first robot, and the joint of the same name of the second. */
function move(joint, index, value) {
  const { name, kind } = page.views[0].robot.joints[joint];
  page.views[0].motion.move(joint, index, value);
  const other = page.views[1];
  const same = other ? other.robot.joints.findIndex(
    (one) => one.name === name && one.kind === kind) : -1;
  if (same >= 0) other.motion.move(same, index, value);
  update();
}

/** Move the robot as it has moved since the last drawing, which many messages may precede. */
function follow() {
  if (!moves.size) return;
  page.views[0].motion.place(moves);
  moves.clear();
  update();
}

/** Pause the live robot where it is. */
function pause() {
  live?.pause(true);
  follow();
}

/** Move a joint by a slider, and pause the live robot. */
function moveByUser(joint, index, value) {
  pause();
  move(joint, index, value);
}

function update() {
  page.views.forEach((one) => one.update());
  page.showPositions();
  page.showNumbers();
  stage?.request();
}

function fade() {
  if (page.views.length < 2) return;
  const amount = Number(byId('fade').value);
  page.views[0].fade(1 - amount);
  page.views[1].fade(amount);
  stage?.request();
}

/** Return the numbers of a position that a joint still has, within its limits. */
const within = (position, limits) => position.slice(0, limits.length).map((value, index) => (
  Math.max(limits[index][0] ?? -Infinity, Math.min(limits[index][1] ?? Infinity, value))));

/** Show a document instead of the present one; the positions of joints are kept by name. */
async function show(found) {
  const meshes = new Meshes(found.meshes);
  const rest = pauses();
  const views = await Promise.all(found.robots.map((robot, number) => new RobotView(robot, {
    number, meshes, onLoaded: showMesh,
    different: found.differences.map(({ element, parts }) => (
      `${element === 'inertial' ? 'link' : element}:${parts[number].join(':')}`)) }).build(rest)));
  const kept = new Map(page?.views[0].robot.joints.map(
    (joint, number) => [joint.name, page.views[0].motion.positions[number]]));
  const name = page?.views[chosen.robot].robot.links[chosen.link].name;
  page?.views.forEach((one) => {
    one.dispose();
    one.group.removeFromParent();
  });
  if (!page) { // what a robot without visuals has
    const hasShapes = (kind) => found.robots.some(({ links }) => links.some((one) => one[kind].length));
    byId(`show-${['visuals', 'collisions'].find(hasShapes) ?? 'frames'}`).checked = true;
  }
  pointed = undefined;
  page = { document: found, views };
  for (const one of views) stage?.scene.add(one.group);
  document.title = found.robots.map((robot) => robot.name).join(', ');
  byId('title').textContent = found.robots.map((robot) => robot.files.file).join(' and ');
  for (const id of ['joints', 'tree', 'differences', 'warnings']) byId(id).replaceChildren();
  const [{ robot, motion }] = views;
  page.showPositions = fillSliders(byId('joints'), robot, motion, moveByUser);
  page.showTree = fillTree(byId('tree'), robot, (link) => choose(link, 0));
  fillDifferences(byId('differences'), found.differences, ({ element, parts }) => {
    const number = parts[0][0] >= 0 ? 0 : 1;
    const [place] = parts[number];
    if (place >= 0) {
      choose(element === 'joint' ? views[number].robot.joints[place].child : place, number);
    }
  });
  byId('limits').hidden = !views.some((one) => one.isCut);
  byId('compare').hidden = views.length < 2;
  const { difference_count: count } = found;
  byId('count').textContent = (count === 1 ? '1 difference' : `${count || 'no'} differences`)
    + (count > found.differences.length ? `, the first ${found.differences.length} are listed` : '');
  byId('warnings').append(found.warnings.join('\n'));
  byId('warning').hidden = !found.warnings.length;
  if ([...kept.values()].flat().some(Boolean)) {
    for (const one of views) {
      one.motion.place(one.robot.joints.map((joint, number) => [
        number, within(kept.get(joint.name) ?? [], joint.limits)]));
    }
  }
  chosen.robot = Math.min(chosen.robot, views.length - 1);
  const link = views[chosen.robot].robot.links.findIndex((one) => one.name === name);
  chosen = { ...chosen, link: Math.max(0, link), isTinted: chosen.isTinted && link >= 0 };
  showChosen();
  showFile(byId('file'), robot.files[robot.files.given], 0);
  find(`input[name=file][value=${robot.files.given}]`).checked = true;
  update();
  fade();
  adjust();
}

/** Show an error above the robot; '' for none. */
function report(text) {
  byId('notice').hidden = !text;
  byId('notice').textContent = text;
}

/** Ask the server for each new version of the robot. */
async function askForVersions() {
  let version = -1;
  for (;;) {
    try {
      const answer = await fetch(version < 0 ? 'robot.json' : `robot.json?after=${version}`);
      if (answer.status === 200) {
        const found = await answer.json();
        version = found.version;
        report(found.error ?? '');
        if (found.robots) await show(found);
        if (found.live) {
          followLive(found);
          return;
        }
      } else if (!answer.ok) {
        throw new Error(`${answer.status}`);
      }
    } catch (err) {
      report(err instanceof TypeError ? 'robot_view has ended: start it again' : String(err));
      await new Promise((resolve) => {
        setTimeout(resolve, RETRY_MS);
      });
      version = -1;
    }
  }
}

/** Follow the live robot of img_viewer. */
function followLive({ robots, version }) {
  live = new Live({ onError: report, onRobot: (found) => {
    moves.clear();
    return show(found);
  }, onMove: (positions) => {
    const { positions: shown } = page.views[0].motion;
    for (const [joint, values] of positions) {
      if (String(values) === String(shown[joint])) moves.delete(joint); // as after each pause
      else moves.set(joint, values);
    }
    if (stage && moves.size) stage.request();
    else follow();
  } });
  if (robots) live.version = version;
}

const save = () => page && stage?.save(`${page.views[0].robot.name || 'robot'}.png`);
const reset = () => {
  pause();
  page?.views.forEach(({ motion }) => motion.reset());
  if (page) update();
};
const press = (id) => () => byId(id).click();
const KEYS = { f: fit, s: save, 0: reset, 1: press('view-urdf'), 2: press('view-sdf'),
  3: press('view-both'), v: press('show-visuals'), c: press('show-collisions'),
  i: press('show-inertia'), a: press('show-axes'), n: press('show-names') };

function start() {
  try {
    stage = new Stage(byId('stage'), { names: byId('names'), beforeView,
      beforeDraw: follow,
      onChoose: ({ link, robot }) => choose(link, robot), onPoint: showPointed,
      onResize: () => stage?.isMoved || fit() });
  } catch {
    byId('stage').append('This browser has no WebGL, so it shows only the numbers.');
  }
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    KEYS[event.key.toLowerCase()]?.();
  });
  byId('fit').addEventListener('click', fit);
  byId('save').addEventListener('click', save);
  byId('zero').addEventListener('click', reset);
  byId('fade').addEventListener('input', fade);
  byId('switches').addEventListener('change', ({ target }) => {
    if (!stage) return;
    if (target.name === 'view') byId('show-frames').checked = true; // they are what differs
    stage.views = view() === 'both' ? ['urdf', 'sdf'] : [view()];
    document.body.dataset.view = view();
    adjust();
  });
  byId('file').addEventListener('change', ({ target }) => openFile(target.value));
  if (embedded) show(JSON.parse(embedded.textContent));
  else askForVersions();
}

start();
// For programs that read what is drawn, such as tests.
Object.assign(window, { robotView: {
  get page() { return page; }, get stage() { return stage; },
  get live() { return live; }, move, choose, show,
} });
