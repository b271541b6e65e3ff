// Reads textures back as they are: each texel is fetched without filtering or comparison and drawn into floats.

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }`;

const FLAT = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D map;
out vec4 texel;
void main() { texel = texelFetch(map, ivec2(gl_FragCoord.xy), 0); }`;

// The direction of a texel's centre, as OpenGL's table of cube map faces has it.
const CUBE = `#version 300 es
precision highp float;
precision highp samplerCube;
uniform samplerCube map;
uniform int face;
uniform float size;
out vec4 texel;
void main() {
  vec2 at = gl_FragCoord.xy * 2.0 / size - 1.0;
  vec3 way = face == 0 ? vec3(1.0, -at.y, -at.x) : face == 1 ? vec3(-1.0, -at.y, at.x)
    : face == 2 ? vec3(at.x, 1.0, at.y) : face == 3 ? vec3(at.x, -1.0, -at.y)
    : face == 4 ? vec3(at.x, -at.y, 1.0) : vec3(-at.x, -at.y, -1.0);
  texel = textureLod(map, way, 0.0);
}`;

function program(gl, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

// Returns Float32Array (faces, height, width, 4), bottom row first. The caller must reset the engine's cached state.
export function readTexture(gl, texture, width, height, isCube = false) {
  const target = isCube ? gl.TEXTURE_CUBE_MAP : gl.TEXTURE_2D;
  const painter = program(gl, isCube ? CUBE : FLAT);
  const color = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, color);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, height);
  gl.bindTexture(gl.TEXTURE_2D, null);
  const frame = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, color, 0);
  gl.bindVertexArray(null);
  gl.bindSampler(0, null);
  for (const test of [gl.BLEND, gl.DEPTH_TEST, gl.CULL_FACE, gl.SCISSOR_TEST, gl.STENCIL_TEST]) gl.disable(test);
  gl.colorMask(true, true, true, true);
  gl.viewport(0, 0, width, height);
  gl.bindTexture(target, texture);
  const names = [gl.TEXTURE_COMPARE_MODE, gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER];
  const kept = names.map((name) => gl.getTexParameter(target, name));
  [gl.NONE, gl.NEAREST, gl.NEAREST].forEach((value, i) => gl.texParameteri(target, names[i], value));
  gl.useProgram(painter);
  gl.uniform1i(gl.getUniformLocation(painter, "map"), 0);
  const faces = isCube ? 6 : 1;
  const texels = new Float32Array(faces * width * height * 4);
  for (let face = 0; face < faces; face++) {
    if (isCube) {
      gl.uniform1i(gl.getUniformLocation(painter, "face"), face);
      gl.uniform1f(gl.getUniformLocation(painter, "size"), width);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, texels.subarray(face * width * height * 4));
  }
  kept.forEach((value, i) => gl.texParameteri(target, names[i], value));
  gl.bindTexture(target, null);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(frame);
  gl.deleteTexture(color);
  gl.deleteProgram(painter);
  const error = gl.getError();
  if (error) throw new Error(`reading a texture back: OpenGL error ${error}`);
  return texels;
}

// The first `count` channels of each texel.
export function channels(texels, count) {
  const picked = new Float32Array((texels.length / 4) * count);
  for (let i = 0; i < texels.length / 4; i++) for (let c = 0; c < count; c++) picked[i * count + c] = texels[4 * i + c];
  return picked;
}

// Saves what the shadow's pass wrote: visibility, the number of the mesh from 1, depth, and 1 where something is seen.
export async function saveSeen(first, job, save) {
  const { width, height } = job;
  const [visibility, depth] = [new Float32Array(width * height), new Float32Array(width * height)];
  const mesh = new Int32Array(width * height);
  for (let i = 0; i < width * height; i++) {
    const isCovered = first[4 * i + 3] === 1;
    visibility[i] = isCovered ? first[4 * i] : 1;
    mesh[i] = isCovered ? first[4 * i + 1] - 1 : -1;
    depth[i] = isCovered ? first[4 * i + 2] : 1;
  }
  await save("visibility", visibility, [height, width]);
  if (job.outputs.includes("mesh")) await save("mesh", mesh, [height, width]);
  if (job.outputs.includes("depth")) await save("depth", depth, [height, width]);
}
