// Draws a job with PlayCanvas on WebGL2, without clustered lighting. `engines.py` says what a job holds.

import * as pc from "playcanvas";
import { channels, readTexture, saveSeen } from "./readback.mjs";

export const version = pc.version;

const SHADOW = 0, POSITION = 1, NORMAL = 2, COORDINATES = 3;
const CULLING = { front: pc.CULLFACE_BACK, back: pc.CULLFACE_FRONT, double: pc.CULLFACE_NONE };

function replaced(chunks, name, before, after) {
  const text = chunks.get(name);
  if (!text.includes(before)) throw new Error(`PlayCanvas' shader ${name} has no ${before}`);
  return text.replace(before, after);
}

// The engine's shader, which writes what it computed in place of its colour.
function probes(device) {
  const chunks = pc.ShaderChunks.get(device, "glsl");
  return {
    litUserDeclarationPS: "uniform float probeOutput; uniform float probeMesh; float probeSeen = 1.0; vec3 probeAt = vec3(0.0);",
    lightFunctionLightPS: replaced(chunks, "lightFunctionLightPS", "dAtten *= shadow;", "dAtten *= shadow; probeSeen = shadow;"),
    lightFunctionShadowPS: replaced(chunks, "lightFunctionShadowPS", "// ----- sample the shadow -----", "probeAt = shadowCoord;"),
    outputPS: `
if (probeOutput < 0.5) gl_FragColor = vec4(probeSeen, probeMesh, gl_FragCoord.z, 1.0);
else if (probeOutput < 1.5) gl_FragColor = vec4(vPositionW, 1.0);
else if (probeOutput < 2.5) gl_FragColor = vec4(dVertexNormalW, 1.0);
else gl_FragColor = vec4(probeAt, 1.0);`,
  };
}

function addMesh(app, mesh, index, code) {
  const material = new pc.StandardMaterial();
  material.diffuse = new pc.Color(1, 1, 1);
  material.useFog = material.useTonemap = false;
  material.cull = CULLING[mesh.side ?? "front"];
  for (const [name, text] of Object.entries(code)) material.getShaderChunks("glsl").set(name, text);
  material.setParameter("probeMesh", index + 1);
  material.setParameter("probeOutput", 0);
  material.update();
  const made = new pc.Mesh(app.graphicsDevice);
  made.setPositions(mesh.vertices);
  made.setNormals(mesh.normals);
  made.setIndices(Uint32Array.from(mesh.faces));
  made.update();
  const entity = new pc.Entity();
  const instance = new pc.MeshInstance(made, material);
  entity.addComponent("render", { meshInstances: [instance], castShadows: mesh.casts ?? true, receiveShadows: mesh.receives ?? true });
  app.root.addChild(entity);
  return material;
}

function addCamera(app, settings, target) {
  const entity = new pc.Entity();
  let { fov } = settings;
  let { near, far } = settings;
  if (settings.projection) {
    const [, , , , , y, , , , , a, b] = settings.projection;
    fov = (2 * Math.atan(1 / y) * 180) / Math.PI;
    near ??= b / (a - 1);
    far ??= b / (a + 1);
  }
  entity.addComponent("camera", {
    fov, nearClip: near, farClip: far, clearColor: new pc.Color(0, 0, 0, 0), toneMapping: pc.TONEMAP_NONE,
    gammaCorrection: pc.GAMMA_NONE, renderTarget: target,
  });
  app.root.addChild(entity);
  if (settings.view) {
    const world = new pc.Mat4();
    world.data.set(new pc.Mat4().set(settings.view).transpose().invert().data);
    entity.setPosition(world.getTranslation());
    entity.setRotation(new pc.Quat().setFromMat4(world));
  } else {
    entity.setPosition(...settings.position);
    entity.lookAt(...settings.target, ...(settings.up ?? [0, 1, 0]));
  }
  return entity;
}

function addLight(app, settings) {
  const { type, position, direction, shadowType, ...rest } = settings;
  const entity = new pc.Entity();
  entity.addComponent("light", { type, castShadows: true, shadowType: pc[`SHADOW_${shadowType}`] });
  for (const [name, value] of Object.entries(rest)) {
    if (!(name in entity.light)) throw new Error(`PlayCanvas' light component has no ${name}`);
    entity.light[name] = value;
  }
  app.root.addChild(entity);
  if (position) entity.setPosition(...position);
  if (direction) {
    // A light shines along its -y.
    const at = entity.getPosition();
    entity.lookAt(at.x + direction[0], at.y + direction[1], at.z + direction[2]);
    entity.rotateLocal(90, 0, 0);
  }
  return entity;
}

export async function draw(job, save) {
  const { width, height } = job;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 16;
  document.body.append(canvas);
  const device = await pc.createGraphicsDevice(canvas, { deviceTypes: ["webgl2"], antialias: false });
  const options = new pc.AppOptions();
  options.graphicsDevice = device;
  options.componentSystems = [pc.CameraComponentSystem, pc.LightComponentSystem, pc.RenderComponentSystem];
  const app = new pc.AppBase(canvas);
  app.init(options);
  app.autoRender = false;
  app.start();
  app.scene.clusteredLightingEnabled = false;
  app.scene.ambientLight = new pc.Color(0, 0, 0);
  const texture = new pc.Texture(device, {
    width, height, format: pc.PIXELFORMAT_RGBA32F, mipmaps: false, minFilter: pc.FILTER_NEAREST, magFilter: pc.FILTER_NEAREST,
  });
  const target = new pc.RenderTarget({ colorBuffer: texture, depth: true, samples: 1 });
  const code = probes(device);
  const materials = job.meshes.map((mesh, index) => addMesh(app, mesh, index, code));
  const camera = addCamera(app, job.camera, target);
  const light = addLight(app, job.light);
  const render = async (output) => {
    for (const material of materials) {
      material.setParameter("probeOutput", output);
      material.update();
    }
    // The first frame may lack what is still being compiled.
    app.render();
    app.render();
    return texture.read(0, 0, width, height, { renderTarget: target, immediate: true });
  };
  for (const [name, output] of Object.entries({ position: POSITION, normal: NORMAL, coordinates: COORDINATES })) {
    if (job.outputs.includes(name)) await save(name, channels(await render(output), 3), [height, width, 3]);
  }
  await saveSeen(await render(SHADOW), job, save);
  if (job.grid) {
    const own = Object.fromEntries(job.grid.flatMap(Object.keys).map((name) => [name, light.light[name]]));
    for (const settings of job.grid) {
      Object.assign(light.light, own, settings);
      const seen = await render(SHADOW);
      await save("grid", Float32Array.from({ length: width * height }, (_, i) => (seen[4 * i + 3] === 1 ? seen[4 * i] : 1)), [job.grid.length, height, width]);
    }
    Object.assign(light.light, own);
    await render(SHADOW);
  }
  const made = light.light.light;
  const drawn = made._renderData.filter((each) => made._type !== pc.LIGHTTYPE_DIRECTIONAL || each.camera === camera.camera.camera);
  const list = (matrix) => Array.from(matrix.data);
  drawn.sort((a, b) => a.face - b.face);
  const info = {
    views: drawn.map((each) => list(each.shadowCamera._node.getWorldTransform().clone().invert())),
    projections: drawn.map((each) => list(each.shadowCamera.projectionMatrix)),
    shadowMatrices: drawn.map((each) => list(each.shadowMatrix)),
    nears: drawn.map((each) => each.shadowCamera._nearClip),
    fars: drawn.map((each) => each.shadowCamera._farClip),
    cascadeDistances: Array.from(made._shadowCascadeDistances ?? []),
    lightPosition: light.getPosition().toArray(),
    view: list(camera.getWorldTransform().clone().invert()),
    projection: list(camera.camera.projectionMatrix),
    renderer: device.gl.getParameter(device.gl.RENDERER),
  };
  if (job.outputs.includes("map")) {
    const map = made._shadowMap.texture;
    const { width: size, cubemap } = map;
    const texels = channels(readTexture(device.gl, map.impl._glTexture, size, size, cubemap), 1);
    await save("map", texels, cubemap ? [6, size, size] : [size, size]);
  }
  // The engine's own caches are of no use after reading back.
  device.gl.getExtension("WEBGL_lose_context")?.loseContext();
  canvas.remove();
  return info;
}
