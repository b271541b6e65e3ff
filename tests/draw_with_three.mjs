// node draw_with_three.mjs PACKAGES CHROMIUM FOLDER: draws an exported scene in three.js, with the code of the documentation.
//
// PACKAGES is a folder with playwright-core and three in its node_modules. FOLDER holds an export's files; `add_shadow.mjs`,
// the code; and `job.json`: the picture's `width` and `height`, the camera's `world_to_eye` and `eye_to_clip`, the map's
// `size`, and `towards`, the unit vector to the light. Writes `lit.bin` to FOLDER: float32, from the lowest row, how much of
// the light is left at each pixel, and -1 where nothing is lit. Prints the browser's messages as JSON.

import { readFile, writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import path from "node:path";

const [packages, executablePath, folder] = process.argv.slice(2);
const { chromium } = createRequire(`${packages}/`)("playwright-core");
const PAGE = `<!doctype html><title>three.js</title><link rel="icon" href="data:,"><script type="importmap">
{ "imports": { "three": "/node_modules/three/build/three.module.js", "three/addons/": "/node_modules/three/examples/jsm/" } }
</script><script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { addShadow } from "/add_shadow.mjs";
const of = async (name, kind) => (await fetch("/" + name))[kind]();
window.draw = async () => {
  const { width, height, world_to_eye, eye_to_clip, size, towards } = await of("job.json", "json");
  const matrix = (rows) => new THREE.Matrix4().set(...rows.flat());
  const renderer = new THREE.WebGLRenderer();
  const scene = new THREE.Scene(), materials = [];
  (await new GLTFLoader().loadAsync("/scene.glb")).scene.traverse((node) => {
    if (!node.isMesh) return;
    node.updateWorldMatrix(true, false);
    const material = new THREE.MeshLambertMaterial({ side: THREE.DoubleSide });
    const mesh = new THREE.Mesh(node.geometry, material);
    mesh.applyMatrix4(node.matrixWorld);
    scene.add(mesh);
    materials.push(material);
  });
  const toLight = new THREE.Vector3(...towards), sun = new THREE.DirectionalLight(0xffffff, 3);
  sun.position.copy(toLight);
  scene.add(sun);
  const camera = new THREE.Camera();
  camera.applyMatrix4(matrix(world_to_eye).invert());
  camera.projectionMatrix.copy(matrix(eye_to_clip));
  const target = new THREE.WebGLRenderTarget(width, height, { type: THREE.FloatType });
  const drawn = () => {
    renderer.setRenderTarget(target);
    renderer.render(scene, camera);
    const pixels = new Float32Array(4 * width * height);
    renderer.readRenderTargetPixels(target, 0, 0, width, height, pixels);
    return pixels.filter((_, i) => i % 4 === 0);
  };
  const plain = drawn();
  addShadow(renderer, scene, materials, await of("shadow.glsl", "text"), (await of("light.json", "json"))["shadow.glsl"], size, toLight);
  const shadowed = drawn();
  return Array.from(plain, (all, i) => (all > 0.01 ? shadowed[i] / all : -1));
};
window.ready = true;
</script>`;
const TYPES = { ".mjs": "text/javascript", ".js": "text/javascript", ".json": "application/json" };
const server = createServer(async (request, response) => {
  const name = new URL(request.url, "http://localhost").pathname.slice(1);
  try {
    const body = name ? await readFile(path.join(name.startsWith("node_modules/") ? packages : folder, name)) : PAGE;
    response.writeHead(200, { "Content-Type": name ? TYPES[path.extname(name)] ?? "application/octet-stream" : "text/html" });
    response.end(body);
  } catch {
    response.writeHead(404);
    response.end();
  }
});
await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
const args = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"];
const browser = await chromium.launch({ executablePath, args });
const page = await browser.newPage(), messages = [];
page.on("console", (message) => messages.push(message.text()));
page.on("pageerror", (error) => messages.push(error.message));
try {
  await page.goto(`http://127.0.0.1:${server.address().port}/`);
  await page.waitForFunction(() => window.ready, null, { timeout: 60000 });
  const lit = await page.evaluate(() => window.draw());
  await writeFile(path.join(folder, "lit.bin"), new Float32Array(lit));
} finally {
  console.log(JSON.stringify(messages));
  await browser.close();
  server.close();
}
