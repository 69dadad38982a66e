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

// Forward kinematics, as robot/kinematics.py computes them.

// 12 numbers are a rotation in row order, and a translation.
/** @type {(numbers: number[]) => any} */
export function matrixOf(numbers) {
  const [a, b, c, d, e, f, g, h, i, x, y, z] = numbers;
  return new THREE.Matrix4().set(a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1);
}

/** Return x, y, z, roll, pitch and yaw. @param {{ elements: number[] }} matrix */
export function poseOf(matrix) {
  const [a, d, g, , b, e, , , c, f, , , x, y, z] = matrix.elements;
  const level = Math.hypot(a, d);
  const yaw = level > 1e-15 ? Math.atan2(d, a) : 0;
  const [sine, cosine] = [Math.sin(yaw), Math.cos(yaw)];
  const roll = Math.atan2(sine * c - cosine * f, cosine * e - sine * b);
  return [x, y, z, roll, Math.atan2(-g, level), yaw];
}

const about = (axis, angle) => new THREE.Matrix4().makeRotationAxis(
  new THREE.Vector3(...axis), angle);
const along = (axis, distance) => new THREE.Matrix4().makeTranslation(
  ...axis.map((value) => value * distance));

/** Return two directions across a normal. @type {(normal: number[]) => number[][]} */
export function plane([x, y, z]) {
  const across = Math.abs(x) < 0.55 ? [0, z, -y] : [-z, 0, x];
  const u = new THREE.Vector3(...across).normalize().toArray();
  return [u, [y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]]];
}

/** Return the motion of a joint at a position. */
function motion({ kind, axes }, position) {
  if (kind === 'fixed' || !position.length) return new THREE.Matrix4();
  if (kind === 'revolute') return about(axes[0], position[0]);
  if (kind === 'prismatic') return along(axes[0], position[0]);
  if (kind === 'universal') {
    return about(axes[0], position[0]).multiply(about(axes.at(-1), position[1]));
  }
  if (kind === 'planar') {
    const [u, v] = plane(axes[0]);
    return along(u, position[0]).multiply(along(v, position[1]))
      .multiply(about(axes[0], position[2]));
  }
  const [roll, pitch, yaw] = position.slice(-3);
  const [x, y, z] = kind === 'floating' ? position : [0, 0, 0];
  return new THREE.Matrix4().makeTranslation(x, y, z).multiply(about([0, 0, 1], yaw))
    .multiply(about([0, 1, 0], pitch)).multiply(about([1, 0, 0], roll));
}

/** Poses of a robot's links, joints and frames in its model. */
export class Motion {
  constructor(robot) {
    this.robot = robot;
    this.positions = robot.joints.map((joint) => joint.spans.map(() => 0));
    this.links = robot.links.map((link) => matrixOf(link.pose));
    this.joints = robot.joints.map(() => new THREE.Matrix4());
    this.origins = robot.joints.map(() => new THREE.Matrix4()); // joints at zero
    this.frames = robot.frames.map(() => new THREE.Matrix4());
    this.steps = robot.joints.map((joint) => ['step', 'child_step', 'loop_step'].map(
      (name) => matrixOf(joint[name])));
    this.frameSteps = robot.frames.map((frame) => matrixOf(frame.step));
    this.reset();
  }

  /** Set one number of a joint's position, and those of the joints that mimic it. */
  move(joint, index, value) {
    this.positions[joint][index] = value;
    this.follow();
    this.update();
  }

  /** Set the positions of joints, given their numbers, and those of the joints that mimic them. */
  place(positions) {
    for (const [joint, values] of positions) {
      Object.assign(this.positions[joint], values);
    }
    this.follow();
    this.update();
  }

  /** Set all positions to zero, and those of the joints that mimic others. */
  reset() {
    for (const position of this.positions) position.fill(0);
    this.follow();
    this.update();
  }

  /** Set the positions of mimic joints. */
  follow() {
    for (const number of this.robot.mimic_order) {
      for (const [index, leader, multiplier, offset] of this.robot.joints[number].mimic) {
        this.positions[number][index] = multiplier * (this.positions[leader]?.[0] ?? 0) + offset;
      }
    }
  }

  /** Compute all poses. */
  update() {
    const { robot, links, joints, origins } = this;
    for (const number of robot.order) {
      const joint = robot.joints[number];
      const [step, childStep] = this.steps[number];
      origins[number].multiplyMatrices(links[joint.parent], step);
      joints[number].multiplyMatrices(origins[number], motion(joint, this.positions[number]));
      links[joint.child].multiplyMatrices(joints[number], childStep);
    }
    robot.joints.forEach((joint, number) => {
      if (!joint.loop) return;
      joints[number].multiplyMatrices(links[joint.child], this.steps[number][2]);
      origins[number].copy(joints[number]);
    });
    robot.frames.forEach((frame, number) => {
      this.frames[number].multiplyMatrices(links[frame.link], this.frameSteps[number]);
    });
  }

  /** Return the directions of a joint's axes in the model. The first moves with the parent. */
  axes(number) {
    const { axes, drawn_axes: count } = this.robot.joints[number];
    return axes.slice(0, count).map((axis, index) => new THREE.Vector3(...axis)
      .transformDirection(index ? this.joints[number] : this.origins[number]));
  }
}
