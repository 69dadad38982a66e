// What the page of robot_view uses of three.js.
export {
  ArrowHelper, AxesHelper, Box3, BoxGeometry, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry,
  DirectionalLight, DoubleSide, EdgesGeometry, Group, HemisphereLight, LineBasicMaterial,
  LineSegments, LoadingManager, Matrix4, Mesh, MeshStandardMaterial, PerspectiveCamera, PlaneGeometry,
  Raycaster, Scene, SphereGeometry, Vector2, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/addons/controls/OrbitControls.js';
export { ColladaLoader } from 'three/addons/loaders/ColladaLoader.js';
export { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
export { MTLLoader } from 'three/addons/loaders/MTLLoader.js';
export { OBJLoader } from 'three/addons/loaders/OBJLoader.js';
export { STLLoader } from 'three/addons/loaders/STLLoader.js';
