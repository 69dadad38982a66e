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

// A robot in the scene: its shapes, frames, axes, and the arrows of both conventions.
import { Motion, matrixOf, plane } from './motion.js';
import { fillShape } from './shapes.js';

const COLORS = { visual: 0xa9b4c0, collision: 0xe08a1e, inertia: 0x8a5cd6, axis: 0xd6336c,
  urdf: 0x1c7ed6, sdf: 0x2b9348, different: 0xe03131, chosen: 0x977103 };
const OPACITY = { collision: 0.4, inertia: 0.5 };
const LOADING_MS = 3000; // between two pictures while meshes are loaded
const MAX_MARKS = 1000; // frames, axes and arrows of each kind
export const PARTS = ['visuals', 'collisions', 'inertia', 'frames', 'axes'];

const flat = (object) => Object.assign(object, { matrixAutoUpdate: false });
const place = (object, numbers) => {
  flat(object).matrix.copy(matrixOf(numbers));
  return object;
};

/** One robot. Links are not nested, so that a chain may have any length. */
export class RobotView {
  constructor(robot, { number, meshes, onLoaded, different = [] }) {
    this.robot = robot;
    this.number = number;
    this.motion = new Motion(robot);
    this.numbers = Object.fromEntries(['link', 'joint', 'frame'].map((one) => [one, new Map(
      robot[`${one}s`].map((owner, place) => [owner.name, place]))])); // by name
    this.group = new THREE.Group();
    this.different = new Set(different);
    this.materials = [];
    this.context = { meshes, onLoaded: () => {
      if (!this.size) return; // not complete yet
      if (!meshes.waiting) clearTimeout(this.timer);
      else if (this.timer) return;
      this.timer = setTimeout(() => { // once for all meshes that have come
        this.timer = undefined;
        this.rescale();
        onLoaded();
      }, meshes.waiting && LOADING_MS);
    }, wire: this.material(COLORS.different, 1, THREE.LineBasicMaterial) };
    this.links = [];
  }

  /** Create all links, with pauses, and return the view. */
  async build(rest) {
    for (const [number, link] of this.robot.links.entries()) {
      this.links.push(this.createLink(link, number));
      await rest();
    }
    this.rescale();
    this.update();
    return this;
  }

  material(color, opacity = 1, Kind = THREE.MeshStandardMaterial, link = -1) {
    return this.adopt(new Kind({ color, transparent: opacity < 1, opacity,
      depthWrite: opacity === 1 }), link);
  }

  /** Keep a material for the choice of a link, the fading and the end. */
  adopt(material, link = -1) {
    material.side = THREE.DoubleSide;
    this.materials.push({ material, link, opacity: material.opacity,
      glow: material.emissive?.getHex() });
    return material;
  }

  createLink(link, number) {
    const view = { group: flat(new THREE.Group()), shapes: [] };
    const { radii, pose } = link.inertial?.ellipsoid ?? {};
    const lists = { visuals: link.visuals, collisions: link.collisions,
      inertia: radii ? [{ pose, geometry: { kind: 'ellipsoid', radii }, color: [] }] : [] };
    for (const [part, shapes] of Object.entries(lists)) {
      const kind = part.replace(/s$/, '');
      shapes.forEach((shape, index) => {
        const isDifferent = this.different.has(`${kind}:${number}:${index}`)
          || this.different.has(`link:${number}:-1`);
        const [r, g, b, alpha = 1] = shape.color;
        const color = isDifferent ? COLORS.different : shape.color.length
          ? new THREE.Color().setRGB(r, g, b, 'srgb') : COLORS[kind];
        const material = this.material(color, OPACITY[kind] ?? Math.max(0.05, alpha), undefined,
          number);
        const group = place(new THREE.Group(), shape.pose);
        Object.assign(group.userData, { part, robot: this.number, link: number, material,
          isSized: kind !== 'inertia' && shape.geometry.kind !== 'plane' });
        fillShape(group, shape, { ...this.context, material,
          adopt: kind === 'visual' && !shape.color.length && !isDifferent && ((found) => (
            Array.isArray(found) ? found.map((one) => this.adopt(one.clone(), number))
              : this.adopt(found.clone(), number))) });
        view.group.add(group);
        view.shapes.push(group);
      });
    }
    this.group.add(view.group);
    return view;
  }

  /** Return the corners of the parts that are shown, or else the places of the links. */
  corners(parts) {
    this.links.forEach(({ group }, number) => group.matrix.copy(this.motion.links[number]));
    this.group.updateMatrixWorld(true);
    const corners = [];
    // Planes have no end, and wrong moments of inertia make ellipsoids very large.
    for (const shape of this.links.flatMap(({ shapes }) => shapes)) {
      if (shape.userData.isSized && parts.has(shape.userData.part)) {
        shape.traverse(({ geometry, matrixWorld }) => {
          if (!geometry) return;
          if (!geometry.boundingBox) geometry.computeBoundingBox();
          const { min, max } = geometry.boundingBox;
          for (let bits = 0; bits < 8; bits += 1) {
            corners.push(new THREE.Vector3(bits & 1 ? min.x : max.x, bits & 2 ? min.y : max.y,
              bits & 4 ? min.z : max.z).applyMatrix4(matrixWorld));
          }
        });
      }
    }
    for (const arrow of parts.has('axes') ? this.axes.flat() : []) {
      corners.push(new THREE.Vector3(0, arrow.cone.position.y, 0).applyMatrix4(arrow.matrixWorld));
    }
    return parts.has('frames') || !corners.length ? corners.concat(this.links.map(
      ({ group }) => new THREE.Vector3().setFromMatrixPosition(group.matrixWorld))) : corners;
  }

  /** Return the middle of the shapes of a link that are shown, or else its place. */
  middle(number) {
    const { group, shapes } = this.links[number];
    const box = new THREE.Box3();
    for (const shape of shapes) if (shape.visible && shape.userData.isSized) box.expandByObject(shape);
    return box.isEmpty() ? new THREE.Vector3().setFromMatrixPosition(group.matrixWorld)
      : box.getCenter(new THREE.Vector3());
  }

  /** Create the marks again if the size of the robot has changed, as when a mesh has come. */
  rescale() {
    const box = new THREE.Box3().setFromPoints(
      this.corners(new Set(['visuals', 'collisions', 'frames'])));
    const size = Math.max(box.getSize(new THREE.Vector3()).length(), 0.02);
    if (this.size && Math.abs(size - this.size) < 0.1 * this.size) return;
    this.size = size;
    for (const object of this.marks ?? []) object.removeFromParent();
    this.createMarks();
    this.update();
  }

  /** Create frames, axes and arrows; their lengths depend on the size of the robot. */
  createMarks() {
    const { robot, size } = this;
    this.marks = [];
    const mark = (part, object) => {
      object.userData.part = part;
      this.group.add(object);
      this.marks.push(object);
      return object;
    };
    const above = (object) => Object.assign(object, { renderOrder: 1 });
    const axes = new THREE.AxesHelper(size * 0.08);
    axes.material.depthTest = false;
    const frame = () => mark('frames', above(flat(
      new THREE.LineSegments(axes.geometry, axes.material))));
    const first = (list) => list.slice(0, MAX_MARKS);
    this.isCut = robot.links.length > MAX_MARKS;
    this.frames = { link: first(robot.links).map(frame), joint: first(robot.joints).map(frame),
      frame: first(robot.frames).map(frame) };
    this.adopt(axes.material);
    const arrow = (part, color, head) => {
      const object = mark(part, new THREE.ArrowHelper(
        new THREE.Vector3(0, 0, 1), new THREE.Vector3(), 1, color));
      for (const one of [above(object.line), above(object.cone)]) {
        one.material.depthTest = false; // arrows are seen through the shapes
        this.adopt(one.material);
      }
      object.userData.head = size * head;
      return object;
    };
    this.axes = first(robot.joints).map((joint, number) => joint.axes.slice(0, joint.drawn_axes).map(
      () => arrow('axes', this.different.has(`joint:${number}:-1`) ? COLORS.different
        : COLORS.axis, 0.02)));
    this.arrows = { urdf: first(robot.joints).map((joint, number) => arrow('urdf',
      this.different.has(`joint:${number}:-1`) ? COLORS.different : COLORS.urdf, 0.03)),
    sdf: first(robot.links).map((link, number) => arrow('sdf',
      this.different.has(`link:${number}:-1`) ? COLORS.different : COLORS.sdf, 0.03)) };
  }

  /** Place all objects at the positions of the joints. */
  update() {
    const { motion, robot } = this;
    this.links.forEach(({ group }, number) => group.matrix.copy(motion.links[number]));
    for (const [kind, poses] of [['link', motion.links], ['joint', motion.joints],
      ['frame', motion.frames]]) {
      this.frames[kind].forEach((object, number) => object.matrix.copy(poses[number]));
    }
    const at = (matrix) => new THREE.Vector3().setFromMatrixPosition(matrix);
    this.axes.forEach((arrows, number) => motion.axes(number).forEach((direction, index) => point(
      arrows[index], at(motion.joints[number]), direction.multiplyScalar(this.size * 0.15))));
    this.arrows.urdf.forEach((object, number) => {
      const start = at(motion.links[robot.joints[number].parent]);
      point(object, start, at(motion.origins[number]).sub(start));
    });
    this.arrows.sdf.forEach((object, number) => {
      const start = this.startOfPose(robot.links[number].name);
      point(object, start, at(motion.links[number]).sub(start));
    });
    this.group.updateMatrixWorld(true);
  }

  /** Return the origin of the frame that the SDF file places a link in. */
  startOfPose(name) {
    const [kind, other] = this.robot.files.sdf.poses.link?.[name]?.in ?? ['model', ''];
    const matrix = kind === 'model' ? undefined : this.matrixOfFrame(kind, other);
    const start = new THREE.Vector3();
    return matrix ? start.setFromMatrixPosition(matrix) : start;
  }

  /** Return the matrix of a link, joint or frame by its name. */
  matrixOfFrame(kind, name) {
    return this.motion[`${kind}s`][this.numbers[kind].get(name)];
  }

  /**
   * Show what belongs to a convention.
   * @param convention `urdf` or `sdf`.
   * @param shown names of the parts that are shown.
   */
  show(convention, shown) {
    for (const object of this.group.children) {
      const { part } = object.userData;
      if (part) object.visible = shown.has(part === convention ? 'frames' : part);
    }
    for (const { shapes } of this.links) {
      for (const object of shapes) object.visible = shown.has(object.userData.part);
    }
    if (!shown.has('frames')) return;
    for (const [kind, other] of [['joint', 'urdf'], ['link', 'sdf']]) {
      for (const object of this.frames[kind]) object.visible = convention === other;
    }
  }

  /** Set how much of the robot is seen, from 0 to 1. */
  fade(amount) {
    this.group.visible = amount > 0.01;
    for (const { material, opacity } of this.materials) {
      material.opacity = opacity * amount;
      if (material.transparent !== material.opacity < 1) material.needsUpdate = true;
      material.transparent = material.opacity < 1;
    }
  }

  /** Mark the shapes of one link. */
  mark(number) {
    for (const { material, link, glow } of this.materials) {
      material.emissive?.setHex(link === number && link >= 0 ? COLORS.chosen : glow);
    }
  }

  /** Free the memory of the graphics. */
  dispose() {
    this.group.traverse((object) => {
      object.geometry?.dispose();
    });
    for (const { material } of this.materials) {
      material.map?.dispose();
      material.dispose();
    }
  }
}

/** Place an arrow, and hide one without a length. */
function point(arrow, start, vector) {
  const length = vector.length();
  arrow.position.copy(start);
  arrow.scale.setScalar(length > 1e-9 ? 1 : 1e-9);
  if (length <= 1e-9) return;
  const { head } = arrow.userData;
  // Not setDirection, which is inexact for directions near y.
  const direction = vector.divideScalar(length);
  const [u, v] = plane(direction.toArray()).map((one) => new THREE.Vector3(...one));
  arrow.quaternion.setFromRotationMatrix(new THREE.Matrix4().makeBasis(u, direction, v.negate()));
  arrow.setLength(length, Math.min(head, length / 2), Math.min(head, length / 2) * 0.5);
}
