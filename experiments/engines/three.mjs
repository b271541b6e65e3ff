// Draws a job with three.js' WebGLRenderer. `engines.py` says what a job holds.

import * as THREE from "three";
import { channels, readTexture, saveSeen } from "./readback.mjs";

export const version = THREE.REVISION;

const SIDES = { front: THREE.FrontSide, back: THREE.BackSide, double: THREE.DoubleSide };
export const TYPES = {
  Basic: THREE.BasicShadowMap, PCF: THREE.PCFShadowMap, PCFSoft: THREE.PCFSoftShadowMap, VSM: THREE.VSMShadowMap,
};

function swap(source, before, after) {
  if (!source.includes(before)) throw new Error(`three.js' shader has no ${JSON.stringify(before)}`);
  return source.replace(before, after);
}

// The stock ShadowMaterial, whose last colour is replaced by the factor that it computed.
export function probe(mesh, index) {
  const material = new THREE.ShadowMaterial({ side: SIDES[mesh.side ?? "front"], transparent: false, fog: false });
  material.blending = THREE.NoBlending;
  material.shadowSide = mesh.shadowSide ? SIDES[mesh.shadowSide] : null;
  material.onBeforeCompile = (shader) => {
    shader.uniforms.probeMesh = { value: index + 1 };
    shader.vertexShader = swap(shader.vertexShader, "void main() {",
      "varying vec3 vProbePosition;\nvarying vec3 vProbeNormal;\nvoid main() {");
    shader.vertexShader = swap(shader.vertexShader, "#include <fog_vertex>",
      "vProbePosition = worldPosition.xyz;\nvProbeNormal = shadowWorldNormal;");
    shader.fragmentShader = swap(shader.fragmentShader, "void main() {", `
      uniform float probeMesh;
      varying vec3 vProbePosition;
      varying vec3 vProbeNormal;
      layout(location = 1) out highp vec4 probePosition;
      layout(location = 2) out highp vec4 probeNormal;
      void main() {`);
    shader.fragmentShader = swap(shader.fragmentShader, "#include <premultiplied_alpha_fragment>", "");
    shader.fragmentShader = swap(shader.fragmentShader,
      "gl_FragColor = vec4( color, opacity * ( 1.0 - getShadowMask() ) );", `
      gl_FragColor = vec4( getShadowMask(), probeMesh, gl_FragCoord.z, 1.0 );
      probePosition = vec4( vProbePosition, 1.0 );
      probeNormal = vec4( vProbeNormal, 1.0 );`);
  };
  return material;
}

function stock(mesh) {
  const material = new THREE.ShadowMaterial({ side: SIDES[mesh.side ?? "front"], transparent: false });
  material.blending = THREE.NoBlending;
  material.shadowSide = mesh.shadowSide ? SIDES[mesh.shadowSide] : null;
  return material;
}

function addMesh(scene, mesh, index) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(mesh.vertices, 3));
  if (mesh.normals) geometry.setAttribute("normal", new THREE.BufferAttribute(mesh.normals, 3));
  geometry.setIndex(new THREE.BufferAttribute(mesh.faces, 1));
  const object = new THREE.Mesh(geometry, probe(mesh, index));
  object.castShadow = mesh.casts ?? true;
  object.receiveShadow = mesh.receives ?? true;
  object.frustumCulled = false;
  scene.add(object);
  return object;
}

function makeLight(settings) {
  const light = { directional: () => new THREE.DirectionalLight(), spot: () => new THREE.SpotLight(),
    point: () => new THREE.PointLight() }[settings.type]();
  light.castShadow = true;
  light.position.fromArray(settings.position);
  if (settings.target) light.target.position.fromArray(settings.target);
  return light;
}

const RECEIVING = ["bias", "normalBias", "radius", "blurSamples", "intensity"];
const ON_SHADOW = [...RECEIVING, "focus", "aspect"];
const ON_LIGHT = ["angle", "distance"];
const KNOWN = [...ON_SHADOW, ...ON_LIGHT, "type", "position", "target", "mapSize", "camera"];

function set(light, settings) {
  const { shadow } = light;
  const unknown = Object.keys(settings).filter((name) => !KNOWN.includes(name));
  if (unknown.length) throw new Error(`a light of three.js has no ${unknown}; expected some of ${KNOWN}`);
  for (const name of ON_SHADOW) if (settings[name] !== undefined) shadow[name] = settings[name];
  for (const name of ON_LIGHT) if (settings[name] !== undefined) light[name] = settings[name];
  if (settings.mapSize) shadow.mapSize.set(...[settings.mapSize].flat().concat(settings.mapSize).slice(0, 2));
  if (settings.position) light.position.fromArray(settings.position);
  if (settings.target) light.target.position.fromArray(settings.target);
  if (settings.camera) {
    Object.assign(shadow.camera, settings.camera);
    shadow.camera.updateProjectionMatrix();
  }
}

function makeCamera(settings, isReversed) {
  if (!settings.view) {
    const camera = new THREE.PerspectiveCamera(settings.fov, settings.aspect, settings.near, settings.far);
    camera.up.fromArray(settings.up ?? [0, 1, 0]);
    camera.position.fromArray(settings.position);
    camera.lookAt(new THREE.Vector3().fromArray(settings.target));
    return camera;
  }
  const camera = new THREE.Camera();
  camera.matrixAutoUpdate = camera.matrixWorldAutoUpdate = false;
  camera.matrixWorldInverse.fromArray(settings.view).transpose();
  camera.matrixWorld.copy(camera.matrixWorldInverse).invert();
  camera.projectionMatrix.fromArray(settings.projection).transpose();
  if (isReversed) {
    // From -1..1 to 1..0, which is what three.js' own cameras do here.
    camera._reversedDepth = true;
    const turn = new THREE.Matrix4().set(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -0.5, 0.5, 0, 0, 0, 1);
    camera.projectionMatrix.premultiply(turn);
  }
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  return camera;
}

export function floatTarget(width, height, count) {
  return new THREE.WebGLRenderTarget(width, height, {
    type: THREE.FloatType, format: THREE.RGBAFormat, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter,
    generateMipmaps: false, count, depthBuffer: true, stencilBuffer: false,
  });
}

// The blur passes draw over the depth that they read, so it is copied just before them.
function keepVsmDepth(renderer, shadow) {
  const gl = renderer.getContext();
  const draw = renderer.renderBufferDirect;
  const kept = { texture: null };
  renderer.renderBufferDirect = (camera, scene, geometry, material, object, group) => {
    if (material.uniforms?.shadow_pass && !("HORIZONTAL_PASS" in material.defines)) {
      const { width, height } = shadow.map;
      gl.deleteTexture(kept.texture);
      kept.texture = gl.createTexture();
      const bound = gl.getParameter(gl.TEXTURE_BINDING_2D);
      gl.bindTexture(gl.TEXTURE_2D, kept.texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT32F, width, height);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.bindTexture(gl.TEXTURE_2D, bound);
      const [from, to] = [gl.getParameter(gl.READ_FRAMEBUFFER_BINDING), gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING)];
      const frame = gl.createFramebuffer();
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, frame);
      gl.framebufferTexture2D(gl.DRAW_FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, kept.texture, 0);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, renderer.properties.get(shadow.map).__webglFramebuffer);
      gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.DEPTH_BUFFER_BIT, gl.NEAREST);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, from);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, to);
      gl.deleteFramebuffer(frame);
    }
    draw(camera, scene, geometry, material, object, group);
  };
  return kept;
}

async function saveMaps(renderer, light, type, vsm, save) {
  const gl = renderer.getContext();
  const { shadow } = light;
  const { width, height } = shadow.map;
  const handle = (texture) => renderer.properties.get(texture).__webglTexture;
  const read = (texture, isCube) => readTexture(gl, texture, width, height, isCube);
  if (type === "VSM") {
    await save("map", channels(read(vsm.texture), 1), [height, width]);
    await save("map_vertical", channels(read(handle(shadow.mapPass.texture)), 2), [height, width, 2]);
    await save("map_blurred", channels(read(handle(shadow.map.texture)), 2), [height, width, 2]);
  } else if (light.isPointLight) {
    await save("map", channels(read(handle(shadow.map.depthTexture), true), 1), [6, height, width]);
  } else {
    await save("map", channels(read(handle(shadow.map.depthTexture)), 1), [height, width]);
  }
  renderer.resetState();
}

export async function savePicture(renderer, target, job, save) {
  const { width, height } = job;
  const read = (attachment) => {
    const texels = new Float32Array(width * height * 4);
    renderer.readRenderTargetPixels(target, 0, 0, width, height, texels, undefined, attachment);
    return texels;
  };
  const first = read(0);
  await saveSeen(first, job, save);
  if (job.outputs.includes("position")) await save("position", channels(read(1), 3), [height, width, 3]);
  if (job.outputs.includes("normal")) await save("normal", channels(read(2), 3), [height, width, 3]);
}

async function saveStock(renderer, scene, camera, job, objects, save) {
  const { width, height } = job;
  const target = new THREE.WebGLRenderTarget(width, height);
  const probes = objects.map((object) => object.material);
  objects.forEach((object, i) => (object.material = stock(job.meshes[i])));
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  objects.forEach((object, i) => (object.material = probes[i]));
  const texels = new Uint8Array(width * height * 4);
  renderer.readRenderTargetPixels(target, 0, 0, width, height, texels);
  // ShadowMaterial draws black with the opacity of the shadow.
  await save("picture", Uint8Array.from({ length: width * height }, (_, i) => 255 - texels[4 * i + 3]), [height, width]);
}

async function saveGrid(renderer, scene, camera, job, light, save) {
  const { width, height } = job;
  const target = floatTarget(width, height, 1);
  const texels = new Float32Array(width * height * 4);
  renderer.setRenderTarget(target);
  const own = {};
  for (const name of new Set(job.grid.flatMap(Object.keys))) {
    if (!RECEIVING.includes(name)) throw new Error(`a grid cannot change ${name}; expected some of ${RECEIVING}`);
    own[name] = light.shadow[name];
  }
  const chunk = Math.max(1, Math.floor(4e6 / (width * height)));
  let kept = [];
  for (const [index, settings] of job.grid.entries()) {
    const before = [light.shadow.radius, light.shadow.blurSamples];
    set(light, { ...own, ...settings });
    // Only the blurred map depends on a setting, and only on these two.
    const isBlurredAnew = light.shadow.radius !== before[0] || light.shadow.blurSamples !== before[1];
    light.shadow.autoUpdate = false;
    light.shadow.needsUpdate = job.shadowType === "VSM" && isBlurredAnew;
    renderer.render(scene, camera);
    renderer.readRenderTargetPixels(target, 0, 0, width, height, texels);
    const visibility = new Float32Array(width * height);
    for (let i = 0; i < width * height; i++) visibility[i] = texels[4 * i + 3] === 1 ? texels[4 * i] : 1;
    kept.push(visibility);
    if (kept.length === chunk || index + 1 === job.grid.length) {
      const joined = new Float32Array(kept.length * width * height);
      kept.forEach((part, i) => joined.set(part, i * width * height));
      await save("grid", joined, [job.grid.length, height, width]);
      kept = [];
    }
  }
}

export async function draw(job, save) {
  const { width, height } = job;
  const isReversed = job.reversedDepthBuffer ?? false;
  const canvas = document.createElement("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: false, reversedDepthBuffer: isReversed });
  if (isReversed && !renderer.capabilities.reversedDepthBuffer) throw new Error("there is no reversed depth buffer here");
  renderer.setPixelRatio(1);
  renderer.setSize(16, 16, false);
  renderer.setClearColor(0, 0);
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = TYPES[job.shadowType];
  const scene = new THREE.Scene();
  const objects = job.meshes.map((mesh, index) => addMesh(scene, mesh, index));
  const light = makeLight(job.light);
  scene.add(light);
  if (light.target) scene.add(light.target);
  set(light, job.light);
  const camera = makeCamera(job.camera, isReversed);
  const vsm = job.shadowType === "VSM" ? keepVsmDepth(renderer, light.shadow) : null;

  const target = floatTarget(width, height, 3);
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  await savePicture(renderer, target, job, save);
  const { shadow } = light;
  if (job.outputs.includes("map") && shadow.map) await saveMaps(renderer, light, job.shadowType, vsm, save);
  const info = {
    lightView: shadow.camera.matrixWorldInverse.elements.slice(),
    lightProjection: shadow.camera.projectionMatrix.elements.slice(),
    shadowMatrix: shadow.matrix.elements.slice(),
    near: shadow.camera.near,
    far: shadow.camera.far,
    lightPosition: light.getWorldPosition(new THREE.Vector3()).toArray(),
    mapSize: shadow.mapSize.toArray(),
    view: camera.matrixWorldInverse.elements.slice(),
    projection: camera.projectionMatrix.elements.slice(),
    renderer: renderer.getContext().getParameter(renderer.getContext().getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? 7937),
  };
  if (job.outputs.includes("picture")) await saveStock(renderer, scene, camera, job, objects, save);
  if (job.grid) await saveGrid(renderer, scene, camera, job, light, save);
  renderer.dispose();
  renderer.forceContextLoss();
  return info;
}
