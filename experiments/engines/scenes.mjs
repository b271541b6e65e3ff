// node scenes.mjs FOLDER: writes what the tests import.
//
// FOLDER/NAME.json are scenes as users of three.js save them, FOLDER/expected.json what the engine makes of them, and
// FOLDER/shapes.json its own shapes with the vertices that it makes of them.

import { writeFile } from "node:fs/promises";
import path from "node:path";
import * as THREE from "three";

// So that every run gives the same identifiers.
let seed = 1;
Math.random = () => ((seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0) / 2 ** 32);

const SHAPES = [
  new THREE.BoxGeometry(),
  new THREE.BoxGeometry(1.5, 0.7, 2.25, 2, 1, 3),
  new THREE.CapsuleGeometry(0.4, 0.9, 3, 5, 2),
  new THREE.CircleGeometry(1.2, 7, 0.3, 4),
  new THREE.ConeGeometry(0.7, 1.3, 6, 2),
  new THREE.CylinderGeometry(0.4, 0.8, 1.1, 5, 2),
  new THREE.CylinderGeometry(0.9, 0, 1.1, 5, 2, true, 0.4, 3.5),
  new THREE.DodecahedronGeometry(0.8),
  new THREE.IcosahedronGeometry(0.9, 1),
  new THREE.LatheGeometry([new THREE.Vector2(0.1, -0.5), new THREE.Vector2(0.7, 0), new THREE.Vector2(0.3, 0.6)], 5, 0.2, 4),
  new THREE.OctahedronGeometry(1.1, 2),
  new THREE.PlaneGeometry(3, 2, 2, 3),
  new THREE.PolyhedronGeometry([1, 1, 1, -1, -1, 1, -1, 1, -1, 1, -1, -1], [2, 1, 0, 0, 3, 2, 1, 3, 0, 2, 3, 1], 0.6, 1),
  new THREE.RingGeometry(0.4, 1.1, 6, 2, 0.5, 4.5),
  new THREE.SphereGeometry(0.8, 7, 5),
  new THREE.SphereGeometry(0.8, 6, 4, 0.3, 4, 0.5, 1.6),
  new THREE.TetrahedronGeometry(1, 0),
  new THREE.TorusGeometry(0.7, 0.25, 5, 9),
  new THREE.TorusGeometry(0.7, 0.25, 4, 5, 4),
  new THREE.TorusKnotGeometry(0.6, 0.2, 18, 5, 2, 3),
];

function mesh(geometry, material, place, { casts = true, receives = true } = {}) {
  const object = new THREE.Mesh(geometry, material);
  object.castShadow = casts;
  object.receiveShadow = receives;
  object.position.fromArray(place);
  return object;
}

const material = (settings) => new THREE.MeshStandardMaterial(settings);
const front = () => material({ color: 0xc0a080, shadowSide: THREE.FrontSide });

function ground(size = 4) {
  const object = mesh(new THREE.PlaneGeometry(size, size), front(), [0, 0, 0]);
  object.name = "ground";
  object.rotation.x = -Math.PI / 2;
  return object;
}

function camera(place, target, near = 0.5, far = 20) {
  const object = new THREE.PerspectiveCamera(33, 1.25, near, far);
  object.name = "view";
  object.position.fromArray(place);
  object.lookAt(...target);
  return object;
}

// Triangles of a folded sheet, whose two halves have a material each, in an interleaved buffer.
function sheet() {
  const geometry = new THREE.BufferGeometry();
  const [n, s] = [Math.SQRT1_2, 0.35];
  const corners = [[-s, 0, -s], [0, s, -s], [0, s, s], [-s, 0, s], [0, s, -s], [s, 0, -s], [s, 0, s], [0, s, s]];
  const rows = corners.flatMap((corner, i) => [...corner, i < 4 ? -n : n, n, 0]);
  const buffer = new THREE.InterleavedBuffer(new Float32Array(rows), 6);
  geometry.setAttribute("position", new THREE.InterleavedBufferAttribute(buffer, 3, 0));
  geometry.setAttribute("normal", new THREE.InterleavedBufferAttribute(buffer, 3, 3));
  geometry.setIndex([0, 3, 1, 1, 3, 2, 4, 7, 5, 5, 7, 6]);
  geometry.addGroup(0, 6, 0);
  geometry.addGroup(6, 6, 1);
  return geometry;
}

// A hierarchy with turns, a mirror and uneven scales; instances; groups; an off-centre window and a moved target.
function yard() {
  const scene = new THREE.Scene();
  scene.add(ground());
  const pile = new THREE.Group();
  pile.name = "pile";
  pile.position.set(-0.35, 0.3, 0.15);
  pile.rotation.set(0.2, 0.7, -0.1);
  pile.scale.set(1.1, 0.8, 0.9);
  const knot = mesh(new THREE.TorusKnotGeometry(0.28, 0.09, 48, 8), front(), [0, 0.1, 0]);
  knot.name = "knot";
  const mirrored = mesh(new THREE.ConeGeometry(0.18, 0.5, 12), front(), [0.1, 0.15, 0.75]);
  mirrored.name = "mirrored";
  mirrored.scale.set(-1, 1, 1.3);
  mirrored.rotation.z = 0.4;
  pile.add(knot, mirrored);
  scene.add(pile);
  const folded = mesh(sheet(), [material({ side: THREE.DoubleSide }), front()], [0.75, 0.05, 0.55]);
  folded.name = "sheet";
  scene.add(folded);
  const posts = new THREE.InstancedMesh(new THREE.BoxGeometry(0.08, 0.5, 0.08), front(), 5);
  posts.name = "posts";
  posts.castShadow = posts.receiveShadow = true;
  const turn = new THREE.Matrix4();
  for (let i = 0; i < 5; i++) {
    turn.makeRotationY(0.3 * i).setPosition(0.3 + 0.18 * i, 0.25, -0.6 + 0.1 * i);
    posts.setMatrixAt(i, turn);
  }
  scene.add(posts);
  const hidden = mesh(new THREE.SphereGeometry(3), front(), [0, 3, 0]);
  hidden.name = "hidden";
  hidden.visible = false;
  const elsewhere = mesh(new THREE.SphereGeometry(3), front(), [0, 3, 0]);
  elsewhere.name = "on another layer";
  elsewhere.layers.set(3);
  scene.add(hidden, elsewhere, new THREE.AmbientLight(0xffffff, 0.4), new THREE.LineSegments());
  const sun = new THREE.DirectionalLight(0xffffff, 2);
  sun.name = "sun";
  sun.castShadow = true;
  sun.position.set(-1.6, 3, 1.4);
  sun.target.position.set(0, 0.2, 0);
  sun.shadow.mapSize.set(160, 128);
  Object.assign(sun.shadow.camera, { left: -1.5, right: 1.8, top: 1.6, bottom: -1.9, near: 1, far: 6.5 });
  Object.assign(sun.shadow, { bias: -0.002, normalBias: 0.004, radius: 2.5 });
  scene.add(sun, sun.target);
  const crane = new THREE.Group();
  crane.position.set(0.4, 0.2, 0.1);
  const view = camera([1.5, 1.7, 2.3], [0.05, 0.25, 0]);
  crane.add(view);
  scene.add(crane);
  return scene;
}

// A spot light with a range, a focus and an oblong map.
function stage() {
  const scene = new THREE.Scene();
  scene.add(ground());
  const torus = mesh(new THREE.TorusGeometry(0.3, 0.11, 12, 24), front(), [0.45, 0.45, -0.4]);
  torus.name = "torus";
  torus.rotation.y = 0.5;
  const drum = mesh(new THREE.CylinderGeometry(0.2, 0.3, 0.5, 20), front(), [-0.4, 0.25, 0.3]);
  drum.name = "drum";
  const stone = mesh(new THREE.DodecahedronGeometry(0.25), material({ shadowSide: THREE.DoubleSide }), [0.5, 0.3, 0.5]);
  stone.name = "stone";
  const ball = mesh(new THREE.IcosahedronGeometry(0.2, 3), front(), [-0.2, 0.8, -0.5], { casts: false });
  ball.name = "ball";
  scene.add(torus, drum, stone, ball);
  const spot = new THREE.SpotLight(0xffffff, 20, 6, 0.5, 0.3);
  spot.name = "spot";
  spot.castShadow = true;
  spot.position.set(-1.3, 2.6, 1.2);
  spot.shadow.mapSize.set(96, 128);
  spot.shadow.focus = 0.9;
  spot.shadow.aspect = 1.2;
  spot.shadow.camera.near = 0.8;
  Object.assign(spot.shadow, { bias: -0.002, normalBias: 0.005, radius: 2, intensity: 0.8 });
  scene.add(spot, camera([1.9, 1.9, 2.4], [0.05, 0.25, 0]));
  return scene;
}

// A point light among its casters, which cast by the rules of their materials.
function room() {
  const scene = new THREE.Scene();
  scene.add(ground());
  const ball = mesh(new THREE.SphereGeometry(0.25, 24, 16), front(), [-0.5, 0.3, 0.2]);
  ball.name = "ball";
  const cup = mesh(new THREE.SphereGeometry(0.3, 20, 8, 0, 2 * Math.PI, 1.6, 1.4), material({ side: THREE.DoubleSide }), [0.6, 0.35, 0.3]);
  cup.name = "cup";
  const pill = mesh(new THREE.CapsuleGeometry(0.12, 0.3, 6, 14), material(), [0.1, 0.3, -0.6]);
  pill.name = "pill";
  scene.add(ball, cup, pill);
  const lamp = new THREE.PointLight(0xffffff, 5);
  lamp.name = "lamp";
  lamp.castShadow = true;
  lamp.position.set(0.1, 1.35, 0.25);
  Object.assign(lamp.shadow, { bias: -0.004, radius: 2 });
  lamp.shadow.mapSize.set(96, 96);
  Object.assign(lamp.shadow.camera, { near: 0.15, far: 5 });
  scene.add(lamp, camera([1.9, 1.9, 2.4], [0.05, 0.25, 0]));
  return scene;
}

const folder = process.argv[2];

// Nine digits name any single.
const short = (value) => Number(value.toPrecision(9));

// Some corners of each mesh's triangles, in world space, with their normals.
function corners(object) {
  const { geometry } = object;
  const { position, normal } = geometry.attributes;
  const index = geometry.index?.array ?? [...Array(position.count).keys()];
  const rows = [];
  for (let copy = 0; copy < (object.isInstancedMesh ? object.count : 1); copy++) {
    const matrix = object.matrixWorld.clone();
    if (object.isInstancedMesh) {
      const own = new THREE.Matrix4();
      object.getMatrixAt(copy, own);
      matrix.multiply(own);
    }
    const turn = new THREE.Matrix3().getNormalMatrix(matrix);
    for (const corner of index) {
      const place = new THREE.Vector3().fromBufferAttribute(position, corner).applyMatrix4(matrix);
      const way = new THREE.Vector3().fromBufferAttribute(normal, corner).applyMatrix3(turn).normalize();
      rows.push([...place.toArray(), ...way.toArray()].map(short));
    }
  }
  return { name: object.name, count: rows.length, every: 31, rows: rows.filter((_, i) => i % 31 === 0) };
}

const expected = {};
for (const [name, build] of Object.entries({ yard, stage, room })) {
  const scene = build();
  scene.updateMatrixWorld();
  await writeFile(path.join(folder, `${name}.json`), JSON.stringify(scene.toJSON()));
  const view = scene.getObjectByName("view");
  const light = scene.children.find((child) => child.isLight && child.castShadow);
  light.shadow.camera.updateProjectionMatrix();
  if (!light.isPointLight) light.shadow.updateMatrices(light);
  const meshes = [];
  scene.traverseVisible((object) => object.isMesh && object.layers.test(view.layers) && meshes.push(corners(object)));
  expected[name] = {
    view: view.matrixWorldInverse.elements,
    projection: view.projectionMatrix.elements,
    shadow: light.isPointLight ? null : light.shadow.matrix.elements,
    meshes,
  };
}
await writeFile(path.join(folder, "expected.json"), JSON.stringify(expected));
const shapes = SHAPES.map((shape) => ({
  ...shape.toJSON(),
  made: {
    position: Array.from(shape.attributes.position.array, short),
    normal: Array.from(shape.attributes.normal.array, short),
    index: shape.index ? Array.from(shape.index.array) : null,
    groups: shape.groups,
  },
}));
await writeFile(path.join(folder, "shapes.json"), JSON.stringify(shapes));
