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

// The drawing: one camera, one or two views, names. It draws only after a change.

const MAX_NAMES = 200; // in one view
const MOVED_PIXELS = 5; // a click with less movement chooses a link
const KEPT_MS = 10000; // the browser has read the file by then

export class Stage {
  constructor(box, { names, onChoose, beforeView }) {
    this.box = box;
    this.names = names;
    this.onChoose = onChoose;
    this.beforeView = beforeView;
    this.draws = 0;
    this.views = ['urdf'];
    this.wanted = false;
    this.scene = new THREE.Scene();
    this.light = new THREE.DirectionalLight(0xffffff, 2);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x777777, 1.6), this.light);
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.renderer = new THREE.WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    const canvas = this.renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute('role', 'img');
    canvas.setAttribute('aria-label', 'Robot');
    box.prepend(canvas);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.addEventListener('change', () => {
      this.isMoved = true;
      this.request();
    });
    this.controls.listenToKeyEvents(canvas);
    let pressed = [0, 0];
    canvas.addEventListener('pointerdown', (event) => {
      pressed = [event.clientX, event.clientY];
    });
    canvas.addEventListener('pointerup', (event) => {
      const distance = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
      if (distance < MOVED_PIXELS) this.choose(event);
    });
    new ResizeObserver(() => this.resize()).observe(box);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.request());
    this.resize();
  }

  resize() {
    this.renderer.setSize(this.box.clientWidth, this.box.clientHeight);
    this.request();
  }

  /** Draw once before the next picture of the screen. */
  request() {
    if (this.wanted) return;
    this.wanted = true;
    requestAnimationFrame(() => this.draw());
  }

  /** Return the views with their rectangles in pixels. */
  rectangles() {
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    const isTall = height > width;
    this.box.dataset.tall = isTall;
    return this.views.map((view, number) => {
      const part = number / this.views.length;
      return isTall
        ? { view, left: 0, top: part * height, width, height: height / this.views.length }
        : { view, left: part * width, top: 0, width: width / this.views.length, height };
    });
  }

  draw() {
    this.wanted = false;
    this.draws += 1;
    const { renderer, camera, scene } = this;
    this.light.position.copy(camera.position);
    scene.background = new THREE.Color(getComputedStyle(this.box).backgroundColor);
    renderer.setScissorTest(true);
    const labels = [];
    for (const one of this.rectangles()) {
      const bottom = this.box.clientHeight - one.top - one.height;
      renderer.setViewport(one.left, bottom, one.width, one.height);
      renderer.setScissor(one.left, bottom, one.width, one.height);
      camera.aspect = one.width / Math.max(one.height, 1);
      camera.updateProjectionMatrix();
      labels.push(...this.beforeView(one.view).slice(0, MAX_NAMES).map(
        (label) => this.place(label, one)));
      renderer.render(scene, camera);
    }
    this.showNames(labels.filter(Boolean));
  }

  /** Return where a name stands on the page; nothing if the camera does not see it. */
  place({ text, point }, { left, top, width, height }) {
    const seen = point.clone().project(this.camera);
    if (Math.abs(seen.x) > 1 || Math.abs(seen.y) > 1 || Math.abs(seen.z) > 1) return undefined;
    return { text, x: left + (seen.x + 1) / 2 * width, y: top + (1 - seen.y) / 2 * height };
  }

  showNames(labels) {
    while (this.names.childElementCount > labels.length) this.names.lastChild.remove();
    while (this.names.childElementCount < labels.length) {
      this.names.append(document.createElement('span'));
    }
    labels.forEach(({ text, x, y }, number) => {
      const element = this.names.children[number];
      if (element.textContent !== text) element.textContent = text;
      element.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    });
  }

  choose({ offsetX, offsetY }) {
    const one = this.rectangles().find(({ left, top, width, height }) => (
      offsetX >= left && offsetX < left + width && offsetY >= top && offsetY < top + height));
    if (!one) return;
    this.beforeView(one.view);
    this.camera.aspect = one.width / one.height;
    this.camera.updateProjectionMatrix();
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((offsetX - one.left) / one.width * 2 - 1,
      1 - (offsetY - one.top) / one.height * 2), this.camera);
    for (const { object } of ray.intersectObject(this.scene, true)) {
      let owner = object;
      let isShown = true;
      while (owner && owner.userData.link === undefined) {
        isShown &&= owner.visible;
        owner = owner.parent;
      }
      if (owner && isShown && owner.visible && owner.parent.parent.visible) {
        this.onChoose(owner.userData);
        return;
      }
    }
  }

  /** Look at a box from the front, the left and above. */
  fit(box) {
    const center = box.getCenter(new THREE.Vector3());
    const size = Math.max(box.getSize(new THREE.Vector3()).length(), 0.02);
    const { camera, controls } = this;
    const narrow = Math.min(...this.rectangles().map(({ width, height }) => width / height), 1);
    const distance = size * 0.56 / Math.tan(camera.fov * Math.PI / 360) / Math.max(narrow, 0.2);
    camera.position.set(1, -1, 0.6).normalize().multiplyScalar(distance).add(center);
    camera.near = distance / 1000;
    camera.far = distance * 100;
    controls.target.copy(center);
    controls.update();
    this.isMoved = false;
    this.request();
  }

  /** Save the picture as a file. */
  save(name) {
    this.draw();
    // The picture has to be taken before the browser shows it and clears the buffer.
    this.renderer.domElement.toBlob((blob) => {
      const link = document.createElement('a');
      link.href = URL.createObjectURL(blob);
      link.download = name;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), KEPT_MS);
    });
  }
}
