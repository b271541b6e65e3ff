"""Shadow factors by OpenGL: a scene drawn from a camera, with classic shadow-mapping shaders.

The shaders keep to the project's conventions where a technique leaves them open: points beyond the light's far plane,
behind it or outside of its map are lit.
"""

from typing import NamedTuple

import numpy as np
import trimesh
from _opengl import OpenGL, State

Resolution = tuple[int, int]

VERTEX_SHADER = """
#version 330
in vec4 clip;
in vec3 position;
in vec3 normal;
out vec3 world;
flat out vec3 face_normal;
void main() {
    gl_Position = clip;
    world = position;
    face_normal = normal;
}
"""

# The receiver as its light sees it; `light` is the point it shines from with w = 1, the way to it with w = 0.
RECEIVER = """
#version 330
uniform mat4 world_to_eye;
uniform mat4 eye_to_clip;
uniform vec4 light;
uniform float texel_depth;
uniform float constant_bias;
uniform float slope_bias;
uniform float least_bias;
uniform sampler2DShadow map;
in vec3 world;
flat in vec3 face_normal;

bool in_front;

// Where the surface falls in the map, and its window depth.
vec3 shadow_coordinate(out float unit) {
    vec4 clip = eye_to_clip * vec4((world_to_eye * vec4(world, 1.0)).xyz, 1.0);
    in_front = clip.w > 0.0;
    // Window depth per texel's width.
    unit = texel_depth / clip.w;
    return clip.xyz / clip.w * 0.5 + 0.5;
}

float cosine() { return dot(face_normal, normalize(light.xyz - light.w * world)); }
float tap(vec2 at, float depth) { return textureLod(map, vec3(at, depth), 0.0); }
"""

# Each is `sum_of_taps(at, depth)`, to be divided by the number of taps.
TECHNIQUES = {
    "nearest": "float sum_of_taps(vec2 at, float depth) { return tap(at, depth); }",
    "four_tap": """
float sum_of_taps(vec2 at, float depth) {
    vec2 texel = 1.0 / vec2(textureSize(map, 0));
    return tap(at + vec2(-1.0, -1.0) * texel, depth) + tap(at + vec2(-1.0, 1.0) * texel, depth)
         + tap(at + vec2(1.0, 1.0) * texel, depth) + tap(at + vec2(1.0, -1.0) * texel, depth);
}
""",
    "box": """
float sum_of_taps(vec2 at, float depth) {
    vec2 texel = 1.0 / vec2(textureSize(map, 0));
    float sum = 0.0;
    for (int j = -2; j <= 2; j++)
        for (int i = -2; i <= 2; i++)
            sum += tap(at + vec2(i, j) * texel, depth);
    return sum;
}
""",
    # Uralsky, GPU Gems 2, chapter 17: two offsets to a texel of the table, the outermost first.
    "random_disk": """
uniform sampler3D offsets;
uniform float radius;
uniform bool early_out;
float pair(vec2 at, float depth, ivec2 cell, int layer, vec2 scale) {
    vec4 offset = texelFetch(offsets, ivec3(cell, layer), 0);
    return tap(at + offset.xy * scale, depth) + tap(at + offset.zw * scale, depth);
}
float sum_of_taps(vec2 at, float depth) {
    ivec3 size = textureSize(offsets, 0);
    ivec2 cell = ivec2(gl_FragCoord.xy) % size.xy;
    vec2 scale = radius / vec2(textureSize(map, 0));
    float sum = 0.0;
    for (int k = 0; k < 4; k++)
        sum += pair(at, depth, cell, k, scale);
    if (early_out && (sum == 0.0 || sum == 8.0))
        return sum * float(size.z) / 4.0;
    for (int k = 4; k < size.z; k++)
        sum += pair(at, depth, cell, k, scale);
    return sum;
}
""",
}
TECHNIQUES["bilinear"] = TECHNIQUES["nearest"]
TAPS = {"nearest": 1, "bilinear": 1, "four_tap": 4, "box": 25, "random_disk": 32}
LINEAR = ("bilinear", "four_tap")

FACTOR = """
layout(location = 0) out float lit;
void main() {
    float unit;
    vec3 at = shadow_coordinate(unit);
    float bias = unit * max(slope_bias * (1.0 - cosine()), least_bias) + unit * constant_bias;
    lit = in_front && at.z <= 1.0 ? sum_of_taps(at.xy, at.z - bias) : TAPS;
}
"""

# What `FACTOR` computes on its way, with the same expressions.
COORDINATES = """
layout(location = 0) out vec4 found;
layout(location = 1) out float facing;
void main() {
    float unit;
    vec3 at = shadow_coordinate(unit);
    float bias = unit * max(slope_bias * (1.0 - cosine()), least_bias) + unit * constant_bias;
    found = vec4(at, at.z - bias);
    facing = cosine();
}
"""


# The same without taps, and without anything, to tell what each part of a draw costs.
PROJECTION = FACTOR.replace("sum_of_taps(at.xy, at.z - bias)", "at.x + at.y + at.z - bias").replace("TAPS", "1.0")
TRIVIAL = "#version 330\nlayout(location = 0) out float lit;\nvoid main() { lit = 1.0; }"


def fragment_shader(technique: str) -> str:
    """The shader that writes the sum of a technique's taps; or `"coordinates"`, `"projection"` or `"trivial"`."""
    if technique == "trivial":
        return TRIVIAL
    if technique in ("coordinates", "projection"):
        return RECEIVER + (COORDINATES if technique == "coordinates" else PROJECTION)
    return RECEIVER + TECHNIQUES[technique] + FACTOR.replace("TAPS", f"{TAPS[technique]}.0")


class View(NamedTuple):
    """A projection: `world_to_eye` and `eye_to_clip` (4, 4), float32, and the distances of depth 0 and 1."""

    world_to_eye: np.ndarray
    eye_to_clip: np.ndarray
    near: float
    far: float

    @property
    def is_perspective(self) -> bool:
        return self.eye_to_clip[3, 2] != 0

    def clip(self, points: np.ndarray) -> np.ndarray:
        """Clip coordinates (v, 4), float32, of world `points` (v, 3)."""
        eye = points @ self.world_to_eye[:3, :3].T + self.world_to_eye[:3, 3]
        return eye @ self.eye_to_clip[:, :3].T + self.eye_to_clip[:, 3]

    def texel_depth(self, resolution: Resolution) -> float:
        """Window depth per texel's width, at a clip `w` of 1."""
        height, width = resolution
        texel = 2 / np.sqrt(float(self.eye_to_clip[0, 0]) * width * float(self.eye_to_clip[1, 1]) * height)
        span = self.far - self.near
        return texel * (self.far * self.near / span if self.is_perspective else 1 / span)


def view(eye, target, half: tuple[float, float], near: float, far: float, perspective: bool) -> View:
    """A view from `eye` to `target`; `half`, width and height of half the frustum, at distance 1 if it widens."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, (0, 1, 0))
    right /= np.linalg.norm(right)
    world_to_eye = np.eye(4)
    world_to_eye[:3, :3] = np.stack([right, np.cross(right, forward), -forward])
    world_to_eye[:3, 3] = -world_to_eye[:3, :3] @ eye
    eye_to_clip = np.diag([1 / half[0], 1 / half[1], 1, 1])
    span = far - near
    if perspective:
        eye_to_clip[2:, 2:] = [[-(far + near) / span, -2 * far * near / span], [-1, 0]]
    else:
        eye_to_clip[2, 2:] = -2 / span, -(far + near) / span
    return View(world_to_eye.astype(np.float32), eye_to_clip.astype(np.float32), near, far)


def scene() -> tuple[np.ndarray, np.ndarray]:
    """A ball, a ring and a box over a slab, all closed: vertices (v, 3), float32, and faces (f, 3).

    All are tilted, so that only the slab's faces lie level or upright.
    """
    turned = trimesh.transformations.rotation_matrix
    slab = trimesh.creation.box((7.0, 0.4, 7.0))
    slab.apply_translation((0, -0.2, 0))
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.55)
    ball.apply_transform(turned(np.deg2rad(13), (1, 0.3, 0.2)))
    ball.apply_translation((-0.95, 0.62, 0.35))
    ring = trimesh.creation.torus(0.55, 0.2, major_sections=24, minor_sections=14)
    ring.apply_transform(turned(np.deg2rad(65), (1, 0.4, 0.2)))
    ring.apply_translation((0.85, 0.85, -0.45))
    box = trimesh.creation.box((0.7, 0.9, 0.5))
    box.apply_transform(turned(np.deg2rad(28), (0.15, 1, 0.1)))
    box.apply_translation((0.25, 0.52, 1.15))
    whole = trimesh.util.concatenate([slab, ball, ring, box])
    return np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.int32)


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(f, 3), unit, outward."""
    a, b, c = vertices[faces].transpose(1, 0, 2).astype(np.float64)
    normals = np.cross(b - a, c - a)
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)


def offset_table(samples: tuple[int, int] = (4, 8), size: int = 8, seed: int = 5) -> np.ndarray:
    """(n, size, size, 2), float32: for each pixel of a tile stratified points of the disk, from the rim inwards."""
    angles, rings = samples
    jitter = np.random.default_rng(seed).random((2, rings, angles, size, size))
    u = (np.arange(angles)[:, None, None] + jitter[0]) / angles
    v = (np.arange(rings)[::-1, None, None, None] + jitter[1]) / rings
    disk = np.sqrt(v) * np.stack([np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)])
    return np.moveaxis(disk.reshape(2, angles * rings, size, size), 0, -1).astype(np.float32)


class Light(NamedTuple):
    """A light: its view, and where it is: a point with w = 1, the way to it with w = 0."""

    view: View
    at: tuple[float, float, float, float]


class Painter:
    """Draws one scene from one camera, lit through one map after another.

    `channels` are those of the images that shaders write.
    """

    def __init__(
        self,
        gl: OpenGL,
        vertices: np.ndarray,
        faces: np.ndarray,
        camera: View,
        resolution: Resolution,
        channels: tuple[int, ...] = (4, 1),
    ):
        self.gl, self.vertices, self.faces, self.resolution, self.channels = gl, vertices, faces, resolution, channels
        height, width = resolution
        clip = camera.clip(vertices)
        normals = np.repeat(face_normals(vertices, faces)[:, None], 3, axis=1)
        corners = np.concatenate([clip[faces], vertices[faces], normals], axis=-1, dtype=np.float32)
        self.corners = gl.context.buffer(corners.tobytes())
        # A depth buffer of 32-bit floats.
        depth = gl.depth_texture(clip, faces, resolution, 32, State())
        colour = [gl.context.texture((width, height), n, dtype="f4") for n in channels]
        self.target = gl.context.framebuffer(colour, depth)
        self.arrays = {}

    def set(self, technique: str, light: Light, settings: dict) -> None:
        """Sets what the technique's shader is told, as far as it uses it."""
        if technique not in self.arrays:
            program = self.gl.context.program(vertex_shader=VERTEX_SHADER, fragment_shader=fragment_shader(technique))
            names = [name for name in ("clip", "position", "normal") if name in program]
            layout = " ".join({"clip": "4f", "position": "3f", "normal": "3f"}[name] for name in names)
            # Without a shadow nobody asks where the surface is.
            layout += "" if len(names) == 3 else " 24x"
            self.arrays[technique] = self.gl.context.vertex_array(program, [(self.corners, layout, *names)])
        program = self.arrays[technique].program
        for name, matrix in {"world_to_eye": light.view.world_to_eye, "eye_to_clip": light.view.eye_to_clip}.items():
            if name in program:
                program[name].write(matrix.T.tobytes())
        for name, value in ({"light": light.at} | settings).items():
            if name in program:
                program[name] = value

    def render(self, technique: str) -> None:
        """Draws with the technique's shader, and waits for the image."""
        context = self.gl.context
        self.target.use()
        self.target.clear(depth=1.0)
        context.enable_only(context.DEPTH_TEST)
        context.depth_func = "<"
        context.polygon_offset = 0.0, 0.0
        self.arrays[technique].render(context.TRIANGLES)
        context.finish()

    def read(self, attachment: int = 0) -> np.ndarray:
        """One of the images last drawn: (h, w), or (h, w, c) if it has several channels."""
        n = self.channels[attachment]
        pixels = np.frombuffer(self.target.read(components=n, attachment=attachment, dtype="f4"), np.float32)
        return pixels.reshape(*self.resolution, n)[..., 0 if n == 1 else slice(None)]


def bind_map(gl: OpenGL, depth, linear: bool, compare: str) -> None:
    """Makes the depth texture the shaders' `map`: unit 0, and depth 1 beyond its border."""
    import moderngl

    mode = moderngl.LINEAR if linear else moderngl.NEAREST
    depth.filter, depth.compare_func = (mode, mode), compare
    depth.use(0)
    gl.clamp_to_border(depth, 1.0)


def offset_texture(gl: OpenGL, table: np.ndarray):
    """The table (n, p, p, 2) as a 3D texture, two offsets to a texel and `n / 2` deep; bound to unit 1."""
    import moderngl

    n, size = table.shape[:2]
    pairs = table.reshape(n // 2, 2, size, size, 2).transpose(0, 2, 3, 1, 4)
    texture = gl.context.texture3d((size, size, n // 2), 4, np.ascontiguousarray(pairs).tobytes(), dtype="f4")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.use(1)
    return texture
