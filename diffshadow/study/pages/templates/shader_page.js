// Draws the scene with the exported shader: the shadow map of each light, then the picture, one pass for each light.
// WebGL 2 and nothing else.

const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.getElementById("scene");
const cut = document.getElementById("cut");
const view = document.getElementById("view");
const { width, height, camera, map, lights, shading } = data;

const HEAD = "#version 300 es\nprecision highp float;\nprecision highp sampler2D;\n";
const NOTHING = "void main() {}";
const glsl = (name) => `#version 300 es\n${document.getElementById(name).textContent}`;

const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, depth: false, preserveDrawingBuffer: true });

// A program with `set(name, …values)` for its uniforms.
function program(vertex, fragment) {
  const made = gl.createProgram();
  for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const of = (name) => gl.getUniformLocation(made, name);
  return {
    use: () => gl.useProgram(made),
    matrices: (each) => { for (const name in each) gl.uniformMatrix4fv(of(name), false, each[name]); },
    floats: (each) => { for (const name in each) gl[`uniform${[each[name]].flat().length}fv`](of(name), [each[name]].flat()); },
    flags: (each) => { for (const name in each) gl.uniform1i(of(name), each[name]); },
  };
}

function texture(format, wide, high) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, wide, high);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  return made;
}

// Drivers take seconds to compile a long table of numbers. It is put into a texture: the text reads it there.
function withTables(text) {
  const tables = new Map(), wide = 1024;
  text = text.replace(/const float (\w+)\[(\d+)\] = .*?\((.*)\);/g, (whole, name, length, numbers) => {
    if (length <= 256) return whole;
    const made = texture(gl.R32F, wide, Math.ceil(length / wide)), all = new Float32Array(wide * Math.ceil(length / wide));
    all.set(numbers.split(",").map(Number));
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, wide, all.length / wide, gl.RED, gl.FLOAT, all);
    tables.set(name, made);
    return `uniform sampler2D ${name};`;
  });
  for (const name of tables.keys()) text = text.replace(new RegExp(`${name}\\[(.*?)\\]`, "g"), `texelFetch(${name}, ivec2(($1) % ${wide}, ($1) / ${wide}), 0).r`);
  return { text, tables };
}

// Three corners for each face, so that each has the face's own normal.
async function loadMesh({ bytes, vertices, faces }) {
  const packed = Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const place = new Float32Array(buffer, 0, 3 * vertices), index = new Uint32Array(buffer, 12 * vertices, 3 * faces);
  const normal = new Int16Array(buffer, 12 * (vertices + faces), 3 * vertices);
  const colour = new Uint16Array(buffer, 18 * vertices + 12 * faces, 3 * vertices);
  const out = new Float32Array(36 * faces);
  for (let face = 0; face < faces; face++) {
    const [a, b, c] = [0, 1, 2].map((corner) => 3 * index[3 * face + corner]);
    const [u, v] = [b, c].map((to) => [0, 1, 2].map((k) => place[to + k] - place[a + k]));
    const across = [0, 1, 2].map((k) => u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
    const size = Math.hypot(...across) || 1;
    [a, b, c].forEach((from, corner) => {
      for (let k = 0, to = 36 * face + 12 * corner; k < 3; k++, to++) {
        out[to] = place[from + k];
        out[to + 3] = across[k] / size;
        out[to + 6] = normal[from + k] / 32767;
        out[to + 9] = colour[from + k] / 65535;
      }
    });
  }
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, out, gl.STATIC_DRAW);
  for (let k = 0; k < 4; k++) {
    gl.enableVertexAttribArray(k);
    gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 48, 12 * k);
  }
}

// The shadow map of a light, as the README of the export says; its layers lie one above the other.
function drawMap(light, depths) {
  const internal = { float32: gl.DEPTH_COMPONENT32F, unorm24: gl.DEPTH_COMPONENT24, unorm16: gl.DEPTH_COMPONENT16 }[map.format];
  const layers = light.world_to_eye.length / 16, high = map.height * layers;
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  if (Math.max(map.width, high) > most) throw new Error(`This machine's textures have at most ${most} texels along a side; the map has ${map.width} x ${high}.`);
  const made = texture(internal, map.width, high);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, made, 0);
  gl.clear(gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  gl.depthFunc(gl.LESS);
  if (map.cull !== "none") gl.enable(gl.CULL_FACE);
  gl.cullFace(map.cull === "front" ? gl.FRONT : gl.BACK);
  if (map.offset) gl.enable(gl.POLYGON_OFFSET_FILL);
  gl.polygonOffset(...(map.offset ?? [0, 0]));
  // An offset is not added to depths that a shader writes.
  const drawn = map.offset ? depths.plain : depths.exact;
  drawn.use();
  for (let layer = 0; layer < layers; layer++) {
    gl.viewport(0, layer * map.height, map.width, map.height);
    drawn.floats({ viewport: [0, layer * map.height, map.width, map.height] });
    drawn.matrices({ world_to_eye: light.world_to_eye.slice(16 * layer, 16 * layer + 16), eye_to_clip: light.eye_to_clip });
    gl.drawArrays(gl.TRIANGLES, 0, 3 * data.mesh.casters);
  }
  [gl.CULL_FACE, gl.POLYGON_OFFSET_FILL].forEach((state) => gl.disable(state));
  return made;
}

// Matrices are lists of 16 numbers, column after column.
const times = (a, b) => a.map((_, i) => [0, 1, 2, 3].reduce((sum, k) => sum + a[(i % 4) + 4 * k] * b[4 * (i >> 2) + k], 0));
const moved = (x, y, z) => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
const turned = (angle, i, j) => {
  const made = moved(0, 0, 0), [c, s] = [Math.cos(angle), Math.sin(angle)];
  [made[5 * i], made[5 * j], made[4 * i + j], made[4 * j + i]] = [c, c, s, -s];
  return made;
};

const orbit = { yaw: 0, pitch: 0, zoom: 1 };

// The configuration's camera, turned about its target and moved towards it. Unmoved, it is the camera to the bit.
function cameraNow() {
  const { yaw, pitch, zoom } = orbit, [x, y, z] = camera.target;
  let { world_to_eye, eye_to_clip } = camera;
  if (yaw || pitch || zoom !== 1) {
    const at = times(world_to_eye, moved(x, y, z)).slice(12, 15);
    world_to_eye = [moved(at[0], at[1], camera.perspective ? at[2] * zoom : at[2]), turned(pitch, 1, 2), moved(-at[0], -at[1], -at[2]),
      camera.world_to_eye, moved(x, y, z), turned(yaw, 2, 0), moved(-x, -y, -z)].reduce(times);
    eye_to_clip = [...eye_to_clip];
    if (!camera.perspective) [0, 5].forEach((i) => { eye_to_clip[i] /= zoom; });
    // The depths that the picture needs move with the camera.
    const distance = -at[2] * (camera.perspective ? zoom : 1), near = camera.perspective ? Math.min(1, zoom) * camera.near : distance - camera.reach;
    const far = distance + camera.reach;
    [eye_to_clip[10], eye_to_clip[14]] = camera.perspective
      ? [-(far + near) / (far - near), -2 * far * near / (far - near)] : [-2 / (far - near), -(far + near) / (far - near)];
  }
  const back = [2, 6, 10].map((i) => world_to_eye[i]);
  const eye = [0, 1, 2].map((k) => -[0, 1, 2].reduce((sum, i) => sum + world_to_eye[4 * k + i] * world_to_eye[12 + i], 0));
  return { world_to_eye, eye_to_clip, eye: camera.perspective ? [...eye, 1] : [...back, 0] };
}

function start() {
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) throw new Error("This page needs WebGL 2 with EXT_color_buffer_float.");
  const depths = { plain: program(glsl("scene.vert"), HEAD + NOTHING), exact: program(glsl("scene.vert"), glsl("depth.frag")) };
  const encode = program(glsl("whole.vert"), glsl("encode.frag"));
  const maps = lights.map((light) => drawMap(light, depths));
  const linear = texture(gl.RGBA16F, width, height), depth = gl.createRenderbuffer(), picture = gl.createFramebuffer();
  gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH32F_STENCIL8, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, picture);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, linear, 0);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_STENCIL_ATTACHMENT, gl.RENDERBUFFER, depth);

  // A setting's program for a light is made when it is first seen.
  const made = new Map();
  const programOf = (setting, i) => {
    const key = `${setting} ${i}`, layers = lights[i].world_to_eye.length / 16;
    if (!made.has(key)) {
      const { text, tables } = withTables(data.settings[setting].shaders[i].map((line) => data.lines[line]).join("\n"));
      const names = `#define LAYERS ${layers}\n#define LIGHTS ${lights.length}\n#define LAYER ${layers > 1 ? "shadow_layer(-path)" : "0"}\n`;
      const lit = program(glsl("scene.vert"), `${HEAD}${names}${text}\n${document.getElementById("lit.frag").textContent}`);
      made.set(key, { ...lit, tables });
    }
    return made.get(key);
  };

  return function draw(scale = 1, part = cut ? cut.value / cut.max : 1) {
    const [wide, high] = [width, height].map((side) => Math.ceil(side * scale));
    if (canvas.width !== wide) [canvas.width, canvas.height] = [wide, high];
    const { eye, ...matrices } = cameraNow(), left = Math.round(wide * part);
    const shows_visibility = view.value === "visibility";
    gl.bindFramebuffer(gl.FRAMEBUFFER, picture);
    gl.viewport(0, 0, wide, high);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.SCISSOR_TEST);
    gl.depthFunc(gl.LESS);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.colorMask(false, false, false, false);
    depths.plain.use();
    depths.plain.matrices(matrices);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * data.mesh.faces);
    gl.colorMask(true, true, true, true);
    // Each light adds to the nearest surface, once: of faces in one place, the first counts.
    [gl.SCISSOR_TEST, gl.BLEND, gl.STENCIL_TEST].forEach((state) => gl.enable(state));
    gl.depthFunc(gl.EQUAL);
    gl.blendFunc(gl.ONE, gl.ONE);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    for (const [setting, from, to] of [[0, 0, left], [1, left, wide]]) {
      if (from === to) continue;
      gl.scissor(from, 0, to - from, high);
      lights.forEach((light, i) => {
        const lit = programOf(setting, i);
        gl.stencilFunc(gl.EQUAL, i, 255);
        lit.use();
        [maps[i], ...lit.tables.values()].forEach((each, unit) => {
          gl.activeTexture(gl.TEXTURE0 + unit);
          gl.bindTexture(gl.TEXTURE_2D, each);
        });
        gl.activeTexture(gl.TEXTURE0);
        [...lit.tables.keys()].forEach((name, k) => lit.flags({ [name]: k + 1 }));
        lit.matrices({ ...matrices, light_to_eye: light.world_to_eye, light_to_clip: light.eye_to_clip });
        lit.floats({ ...shading.numbers, ...light.numbers, ambient: i ? [0, 0, 0] : shading.ambient, eye, size: [wide, high] });
        lit.flags({ ...shading.flags, has_cone: light.has_cone, shows_visibility });
        gl.drawArrays(gl.TRIANGLES, 0, 3 * data.mesh.faces);
      });
    }
    [gl.SCISSOR_TEST, gl.BLEND, gl.STENCIL_TEST, gl.DEPTH_TEST].forEach((state) => gl.disable(state));
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.bindTexture(gl.TEXTURE_2D, linear);
    encode.use();
    encode.floats({ background: shading.background });
    encode.flags({ shows_visibility });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    // Waits for the picture, so that the time is known.
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  };
}

// A drag turns, a wheel or two fingers zoom; keys do both. While something moves, a slow machine draws fewer pixels.
function control(draw) {
  const touching = new Map(), initial = { ...orbit };
  let waits = false, slow = false, rest = 0;
  const show = (moving) => {
    clearTimeout(rest);
    if (moving && slow) rest = setTimeout(() => show(false), 250);
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => {
      waits = false;
      const began = performance.now(), scale = moving && slow ? 0.5 : 1;
      draw(scale);
      if (scale < 1) return;
      slow = performance.now() - began > 60;
      document.body.dataset.fullPicture ??= Math.round(performance.now());
    });
  };
  const turn = (yaw, pitch, zoom = 1) => {
    orbit.yaw += yaw;
    orbit.pitch = Math.min(Math.max(orbit.pitch + pitch, -camera.elevation - 0.1), 1.55 - camera.elevation);
    orbit.zoom = Math.min(Math.max(orbit.zoom * zoom, 0.1), 8);
    show(true);
  };
  const spread = ([a, b]) => Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  const on = (target, names, act, options) => names.split(" ").forEach((name) => target?.addEventListener(name, act, options));
  on(canvas, "pointerdown", (event) => { touching.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); });
  on(canvas, "pointerup pointercancel", (event) => touching.delete(event.pointerId));
  on(canvas, "pointermove", (event) => {
    const last = touching.get(event.pointerId);
    if (!last) return;
    const before = touching.size === 2 && spread([...touching.values()]);
    touching.set(event.pointerId, event);
    if (before) turn(0, 0, before / Math.max(spread([...touching.values()]), 1));
    else turn((event.clientX - last.clientX) * 0.008, (event.clientY - last.clientY) * 0.008);
  });
  on(canvas, "wheel", (event) => { event.preventDefault(); turn(0, 0, Math.exp(event.deltaY * 0.001)); }, { passive: false });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1], "+": [0, 0, 0.9], "-": [0, 0, 1.1] };
  on(canvas, "keydown", (event) => { if (keys[event.key]) { event.preventDefault(); turn(...keys[event.key]); } });
  on(document.getElementById("reset"), "click", () => { Object.assign(orbit, initial); show(false); });
  on(cut, "input", () => show(true));
  on(view, "change", () => show(false));
  show(false);
}

try {
  await loadMesh(data.mesh);
  const draw = start();
  // The setting that matters comes first, with fewer pixels: without a GPU, the whole picture takes its time.
  draw(0.5, cut ? 0 : 1);
  document.body.dataset.firstPicture = Math.round(performance.now());
  control(draw);
} catch (error) {
  const shown = document.getElementById("failure");
  shown.textContent = `The picture cannot be drawn here: ${error.message}`;
  shown.hidden = false;
}
