// Draws a job with Babylon.js' ShadowGenerator on WebGL2. `engines.py` says what a job holds.

import { Engine } from "@babylonjs/core/Engines/engine.js";
import { Scene } from "@babylonjs/core/scene.js";
import { Camera } from "@babylonjs/core/Cameras/camera.js";
import { DirectionalLight } from "@babylonjs/core/Lights/directionalLight.js";
import { PointLight } from "@babylonjs/core/Lights/pointLight.js";
import { SpotLight } from "@babylonjs/core/Lights/spotLight.js";
import { ShadowGenerator } from "@babylonjs/core/Lights/Shadows/shadowGenerator.js";
import "@babylonjs/core/Lights/Shadows/shadowGeneratorSceneComponent.js";
import { Material } from "@babylonjs/core/Materials/material.js";
import { MaterialPluginBase } from "@babylonjs/core/Materials/materialPluginBase.js";
import { StandardMaterial } from "@babylonjs/core/Materials/standardMaterial.js";
import { RenderTargetTexture } from "@babylonjs/core/Materials/Textures/renderTargetTexture.js";
import { Color4 } from "@babylonjs/core/Maths/math.color.js";
import { Matrix, Vector3 } from "@babylonjs/core/Maths/math.vector.js";
import { Mesh } from "@babylonjs/core/Meshes/mesh.js";
import { VertexData } from "@babylonjs/core/Meshes/mesh.vertexData.js";
import { channels, readTexture, saveSeen } from "./readback.mjs";

export const version = Engine.Version;

const FLOAT = 1; // Constants.TEXTURETYPE_FLOAT
const BYTE = 0;
const NEAREST = 1;
const SHADOW = 0, POSITION = 1, NORMAL = 2, RANDOM = 3;

// Writes what StandardMaterial computed in place of its colour.
class Probe extends MaterialPluginBase {
  constructor(material, mesh, output) {
    super(material, "Probe", 200, { PROBEMESH: 0, PROBEOUTPUT: 0 });
    this.mesh = mesh;
    this.output = output;
    this._enable(true);
  }
  getClassName() {
    return "Probe";
  }
  prepareDefines(defines) {
    defines.PROBEMESH = this.mesh + 1;
    defines.PROBEOUTPUT = this.output;
  }
  getCustomCode(kind) {
    if (kind !== "fragment") return null;
    return { CUSTOM_FRAGMENT_MAIN_END: `
#if PROBEOUTPUT==${SHADOW}
gl_FragColor=vec4(shadow,float(PROBEMESH),gl_FragCoord.z,1.);
#elif PROBEOUTPUT==${POSITION}
gl_FragColor=vec4(vPositionW,1.);
#elif PROBEOUTPUT==${NORMAL}
#ifdef NORMAL
gl_FragColor=vec4(vNormalW,1.);
#else
gl_FragColor=vec4(0.,0.,0.,1.);
#endif
#else
#ifdef SHADOW0
gl_FragColor=vec4(getRand(vPositionFromLight0.xy),0.,0.,1.);
#else
gl_FragColor=vec4(0.,0.,0.,1.);
#endif
#endif
` };
  }
}

// A camera with given matrices, for row vectors as Babylon.js has them.
class MatrixCamera extends Camera {
  constructor(scene, view, projection, near, far) {
    super("camera", Vector3.Zero(), scene);
    this.given = view;
    this.minZ = near;
    this.maxZ = far;
    this.freezeProjectionMatrix(projection);
  }
  _getViewMatrix() {
    return this.given;
  }
  _isSynchronizedViewMatrix() {
    return false;
  }
}

function makeCamera(scene, settings) {
  if (settings.view) {
    const matrix = (values) => Matrix.FromArray(values).transpose();
    return new MatrixCamera(scene, matrix(settings.view), matrix(settings.projection), settings.near ?? 1,
      settings.far ?? 10000);
  }
  const vector = (values) => Vector3.FromArray(values);
  const view = Matrix.LookAtRH(vector(settings.position), vector(settings.target), vector(settings.up ?? [0, 1, 0]));
  const fov = (settings.fov * Math.PI) / 180;
  const projection = Matrix.PerspectiveFovRH(fov, settings.aspect, settings.near, settings.far, false);
  return new MatrixCamera(scene, view, projection, settings.near, settings.far);
}

function makeLight(scene, settings) {
  const vector = (values) => Vector3.FromArray(values);
  const { type, position, direction, ...rest } = settings;
  let light;
  if (type === "directional") light = new DirectionalLight("light", vector(direction), scene);
  else if (type === "spot") {
    light = new SpotLight("light", vector(position), vector(direction), rest.angle, rest.exponent ?? 1, scene);
  } else light = new PointLight("light", vector(position), scene);
  if (position) light.position = vector(position);
  Object.assign(light, rest);
  return light;
}

function addMesh(scene, mesh, index) {
  const object = new Mesh(`mesh ${index}`, scene);
  const data = new VertexData();
  data.positions = mesh.vertices;
  if (mesh.normals) data.normals = mesh.normals;
  const faces = Uint32Array.from(mesh.faces);
  // Babylon.js' own meshes are clockwise, and those of the glTF loader anticlockwise.
  if (mesh.clockwise) for (let i = 0; i < faces.length; i += 3) [faces[i + 1], faces[i + 2]] = [faces[i + 2], faces[i + 1]];
  data.indices = faces;
  data.applyToMesh(object, false);
  object.receiveShadows = mesh.receives ?? true;
  object.alwaysSelectAsActiveMesh = true;
  return object;
}

function makeMaterial(scene, mesh, index, output) {
  const material = new StandardMaterial(`material ${index} ${output}`, scene);
  material.backFaceCulling = mesh.backFaceCulling ?? true;
  material.sideOrientation = mesh.clockwise ? Material.ClockWiseSideOrientation : Material.CounterClockWiseSideOrientation;
  material.specularColor.set(0, 0, 0);
  if (output !== null) new Probe(material, index, output);
  return material;
}

const NAMED = {
  filter: (value) => ShadowGenerator[`FILTER_${value}`],
  filteringQuality: (value) => ShadowGenerator[`QUALITY_${value}`],
};

function set(generator, settings) {
  for (const [name, value] of Object.entries(settings)) {
    if (name === "mapSize" || name === "usefullFloatFirst") continue;
    if (!(name in generator)) throw new Error(`Babylon.js' shadow generator has no ${name}`);
    const converted = typeof value === "string" && NAMED[name] ? NAMED[name](value) : value;
    if (converted === undefined) throw new Error(`Babylon.js has no ${name} ${value}`);
    generator[name] = converted;
  }
}

function pixels(engine, target, width, height, texels) {
  const gl = engine._gl;
  const frame = gl.createFramebuffer();
  const bound = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D,
    target.getInternalTexture()._hardwareTexture.underlyingResource, 0);
  const kind = texels instanceof Float32Array ? gl.FLOAT : gl.UNSIGNED_BYTE;
  gl.readPixels(0, 0, width, height, gl.RGBA, kind, texels);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, bound);
  gl.deleteFramebuffer(frame);
  return texels;
}

async function ready(scene, generator) {
  await scene.whenReadyAsync();
  await generator.forceCompilationAsync();
  // Post-processes that blur compile when they are first drawn.
  for (const process of generator._blurPostProcesses ?? []) {
    while (!process.getEffect()?.isReady()) {
      process.updateEffect();
      await new Promise((resolve) => setTimeout(resolve, 1));
    }
  }
}

async function saveMaps(engine, generator, light, save) {
  const gl = engine._gl;
  const map = generator.getShadowMap();
  const size = map.getSize().width;
  const isCube = light.needCube();
  const handle = (texture) => texture._hardwareTexture.underlyingResource;
  const shape = isCube ? [6, size, size] : [size, size];
  const read = (texture, n = size) => channels(readTexture(gl, handle(texture), n, n, isCube), 1);
  const filter = generator.filter;
  if (filter !== ShadowGenerator.FILTER_PCF) {
    await save("map_metric", read(map.getInternalTexture()), shape);
  }
  if (filter === ShadowGenerator.FILTER_PCF || filter === ShadowGenerator.FILTER_PCSS) {
    await save("map_depth", read(map.depthStencilTexture), shape);
  }
  const rendered = generator.getShadowMapForRendering();
  if (rendered && rendered !== map) {
    const small = rendered.getSize().width;
    await save("map_blurred", read(rendered.getInternalTexture(), small), [small, small]);
  }
}

async function drawPicture(engine, scene, camera, job, objects, generator, save) {
  const { width, height } = job;
  const first = new Float32Array(width * height * 4);
  const target = new RenderTargetTexture("out", { width, height }, scene, {
    generateMipMaps: false, type: FLOAT, samplingMode: NEAREST, generateDepthBuffer: true,
  });
  camera.outputRenderTarget = target;
  const render = async (output, texels) => {
    objects.forEach((object, i) => (object.material = makeMaterial(scene, job.meshes[i], i, output)));
    await ready(scene, generator);
    // The first frames may lack what is still being compiled.
    for (let i = 0; i < 3; i++) scene.render();
    return pixels(engine, target, width, height, texels);
  };
  const interpolated = { position: [POSITION, 3], normal: [NORMAL, 3], random: [RANDOM, 1] };
  for (const [name, [output, count]] of Object.entries(interpolated)) {
    if (!job.outputs.includes(name)) continue;
    const texels = await render(output, new Float32Array(width * height * 4));
    await save(name, channels(texels, count), count === 1 ? [height, width] : [height, width, count]);
  }
  await render(SHADOW, first);
  await saveSeen(first, job, save);
  return target;
}

async function saveGrid(engine, scene, job, generator, target, save) {
  const { width, height } = job;
  const texels = new Float32Array(width * height * 4);
  const chunk = Math.max(1, Math.floor(4e6 / (width * height)));
  const own = Object.fromEntries(job.grid.flatMap(Object.keys).map((name) => [name, generator[name]]));
  let kept = [];
  for (const [index, settings] of job.grid.entries()) {
    set(generator, { ...own, ...settings });
    await ready(scene, generator);
    scene.render();
    pixels(engine, target, width, height, texels);
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

async function saveStock(engine, scene, camera, job, objects, generator, save) {
  const { width, height } = job;
  camera.outputRenderTarget = new RenderTargetTexture("picture", { width, height }, scene, {
    generateMipMaps: false, type: BYTE, samplingMode: NEAREST, generateDepthBuffer: true,
  });
  objects.forEach((object, i) => (object.material = makeMaterial(scene, job.meshes[i], i, null)));
  await ready(scene, generator);
  for (let i = 0; i < 3; i++) scene.render();
  const texels = pixels(engine, camera.outputRenderTarget, width, height, new Uint8Array(width * height * 4));
  await save("picture", Uint8Array.from({ length: width * height }, (_, i) => texels[4 * i]), [height, width]);
}

export async function draw(job, save) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 16;
  const engine = new Engine(canvas, false, { preserveDrawingBuffer: true, stencil: false, antialias: false });
  // So that a changed setting is drawn in the next frame.
  engine.getCaps().parallelShaderCompile = undefined;
  const scene = new Scene(engine);
  // Meshes and matrices are those of OpenGL. The light's own camera is left-handed all the same.
  scene.useRightHandedSystem = true;
  scene.clearColor = new Color4(0, 0, 0, 0);
  scene.ambientColor.set(0, 0, 0);
  const camera = makeCamera(scene, job.camera);
  scene.activeCamera = camera;
  const light = makeLight(scene, job.light);
  const generator = new ShadowGenerator(job.generator.mapSize, light, job.generator.usefullFloatFirst ?? false);
  set(generator, job.generator);
  const objects = job.meshes.map((mesh, index) => addMesh(scene, mesh, index));
  objects.forEach((object, i) => (job.meshes[i].casts ?? true) && generator.addShadowCaster(object));

  if (job.outputs.includes("picture")) await saveStock(engine, scene, camera, job, objects, generator, save);
  const target = await drawPicture(engine, scene, camera, job, objects, generator, save);
  const matrix = (of) => Array.from(of.asArray ? of.asArray() : of.m);
  const near = light.shadowMinZ ?? camera.minZ, far = light.shadowMaxZ ?? camera.maxZ;
  const info = {
    lightView: matrix(generator.viewMatrix),
    lightProjection: matrix(generator.projectionMatrix),
    shadowMatrix: matrix(generator.getTransformMatrix()),
    depthValues: [light.getDepthMinZ(camera), light.getDepthMinZ(camera) + light.getDepthMaxZ(camera)],
    near, far,
    lightPosition: light.position.asArray(),
    mapSize: [generator.mapSize, generator.mapSize],
    filter: Object.keys(ShadowGenerator).find((name) => name.startsWith("FILTER_") && ShadowGenerator[name] === generator.filter).slice(7),
    view: matrix(camera.getViewMatrix()),
    projection: matrix(camera.getProjectionMatrix()),
    renderer: engine.getGlInfo().renderer,
  };
  if (job.outputs.includes("map")) {
    await saveMaps(engine, generator, light, save);
    engine.wipeCaches(true);
  }
  if (job.grid) await saveGrid(engine, scene, job, generator, target, save);
  scene.dispose();
  engine.dispose();
  canvas.getContext("webgl2")?.getExtension("WEBGL_lose_context")?.loseContext();
  return info;
}
