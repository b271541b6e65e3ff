// Draws the scene with the exported shader in WebGL 2: the shadow map of each light, then the picture, with one pass
// per light.

const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.getElementById("scene");
const cut = document.getElementById("cut");
const view = document.getElementById("view");
const { width, height, camera, map, lights, shading } = data;

const HEAD = "#version 300 es\nprecision highp float;\nprecision highp sampler2D;\n";
const NOTHING = "void main() {}";
const glsl = (name) => `#version 300 es\n${document.getElementById(name).textContent}`;

const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, depth: false, preserveDrawingBuffer: true });

// A program, and a function that sets its uniforms by name.
function program(vertex, fragment) {
  const made = gl.createProgram();
  const shaders = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].map(([type, text]) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
    return shader;
  });
  gl.linkProgram(made);
  // A query waits for the compiler, so there is only one.
  if (!gl.getProgramParameter(made, gl.LINK_STATUS))
    throw new Error([...shaders.map((shader) => gl.getShaderInfoLog(shader)), gl.getProgramInfoLog(made)].join("\n"));
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

// Drivers take seconds to compile a long table of numbers, so the shader reads it from a texture.
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
  const read = (name) => `texelFetch(${name}, ivec2(($1) % ${wide}, ($1) / ${wide}), 0).r`;
  for (const name of tables.keys()) text = text.replace(new RegExp(`${name}\\[(.*?)\\]`, "g"), read(name));
  return { text, tables };
}

// Each face has three vertices of its own, so that each face has its own normal.
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

// The shadow map of a light, as in the README of the export. Its layers are stacked vertically.
function drawMap(light, depths) {
  const internal = { float32: gl.DEPTH_COMPONENT32F, unorm24: gl.DEPTH_COMPONENT24, unorm16: gl.DEPTH_COMPONENT16 }[map.format];
  const layers = light.world_to_eye.length / 16, high = map.height * layers;
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  if (Math.max(map.width, high) > most)
    throw new Error(`textures have at most ${most} texels along a side here; the map has ${map.width} x ${high}.`);
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
  // Polygon offset has no effect on depths that a shader writes.
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

function start() {
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) throw new Error("it needs WebGL 2 with EXT_color_buffer_float.");
  const depths = { plain: program(glsl("scene.vert"), HEAD + NOTHING), exact: program(glsl("scene.vert"), glsl("depth.frag")) };
  const encode = program(glsl("whole.vert"), glsl("encode.frag"));
  const maps = lights.map((light) => drawMap(light, depths));
  const linear = texture(gl.RGBA16F, width, height), depth = gl.createRenderbuffer(), picture = gl.createFramebuffer();
  gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH32F_STENCIL8, width, height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, picture);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, linear, 0);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_STENCIL_ATTACHMENT, gl.RENDERBUFFER, depth);

  // A setting's program for a light is made on first use.
  const made = new Map();
  const programOf = (setting, i) => {
    const key = `${setting} ${i}`, layers = lights[i].world_to_eye.length / 16;
    if (!made.has(key)) {
      const { text, tables } = withTables(data.settings[setting].shaders[i].map((line) => data.lines[line]).join("\n"));
      const defined = { LAYERS: layers, LIGHTS: lights.length, LAYER: layers > 1 ? "shadow_layer(-path)" : 0 };
      const names = Object.entries(defined).map((each) => `#define ${each.join(" ")}\n`).join("");
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
    // Each light is added once at each pixel. Of several faces at the same depth, the first counts.
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
    // Waits for the picture, to measure its time.
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  };
}

try {
  await loadMesh(data.mesh);
  const draw = start();
  // The visible setting comes first, with fewer pixels, because the whole picture is slow without a GPU.
  draw(0.5, cut ? 0 : 1);
  document.body.dataset.firstPicture = Math.round(performance.now());
  control(draw);
} catch (error) {
  const shown = document.getElementById("failure");
  shown.textContent = `The picture cannot be drawn here: ${error.message}`;
  shown.hidden = false;
}
