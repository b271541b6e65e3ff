"""Shadow look-ups by OpenGL: `texture(sampler2DShadow, ...)` at given points of a given map."""

import numpy as np
from _opengl import OpenGL, State

VERTEX_SHADER = """
#version 330
in vec2 position;
void main() { gl_Position = vec4(position, 0.0, 1.0); }
"""

FRAGMENT_SHADER = """
#version 330
uniform sampler2D points;
uniform sampler2DShadow map;
out float lit;
void main() { lit = textureLod(map, texelFetch(points, ivec2(gl_FragCoord.xy), 0).xyz, 0.0); }
"""

SIDE = 64
MAP_RESOLUTION = (24, 32)


def draw_lookups(gl: OpenGL) -> dict[str, np.ndarray]:
    """Look-ups with every depth format, filter and compare, beside the map and the points.

    **Returns:** `clip` (v, 4) and `faces` (f, 3), what is drawn to the map; `depth_32` and `depth_24` (24, 32), the
    map; `points` (64, 64, 3), `u`, `v` and reference depth of each look-up; and `lit_BITS_FILTER_COMPARE` (64, 64),
    with `BITS` 32 or 24, `FILTER` `nearest` or `linear` and `COMPARE` `less` or `lequal`. Outside of the map its
    depth is 1.
    """
    import moderngl

    random = np.random.default_rng(11)
    clip = np.concatenate([random.uniform(-0.95, 0.95, (90, 3)), np.ones((90, 1))], axis=1).astype(np.float32)
    faces = np.arange(90, dtype=np.int32).reshape(30, 3)
    found = {"clip": clip, "faces": faces}
    drawn = {bits: gl.draw(clip, faces, MAP_RESOLUTION, bits, State()).depth for bits in (32, 24)}
    points = _points(random, drawn)
    found |= {"points": points, "depth_32": drawn[32], "depth_24": drawn[24]}

    context = gl.context
    program = context.program(vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER)
    corners = context.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
    array = context.vertex_array(program, [(corners, "2f", "position")])
    program["points"], program["map"] = 0, 1
    asked = context.texture((SIDE, SIDE), 3, points.tobytes(), dtype="f4")
    asked.filter = (moderngl.NEAREST, moderngl.NEAREST)
    target = context.framebuffer([context.texture((SIDE, SIDE), 1, dtype="f4")])
    for bits in (32, 24):
        depth = gl.depth_texture(clip, faces, MAP_RESOLUTION, bits, State())
        for filter_name, filter_value in (("nearest", moderngl.NEAREST), ("linear", moderngl.LINEAR)):
            for compare_name, compare in (("less", "<"), ("lequal", "<=")):
                depth.filter = (filter_value, filter_value)
                depth.compare_func = compare
                asked.use(0)
                depth.use(1)
                gl.clamp_to_border(depth, 1.0)
                target.use()
                context.enable_only(context.NOTHING)
                array.render(context.TRIANGLES)
                lit = np.frombuffer(target.read(components=1, dtype="f4"), np.float32).reshape(SIDE, SIDE)
                found[f"lit_{bits}_{filter_name}_{compare_name}"] = lit.copy()
        depth.release()
    return found


def _points(random: np.random.Generator, drawn: dict[int, np.ndarray]) -> np.ndarray:
    """Random points a little beyond the map and the depth range; a quarter at texel centres with the very depth."""
    height, width = MAP_RESOLUTION
    points = random.uniform((-0.1, -0.1, -0.1), (1.1, 1.1, 1.2), (SIDE * SIDE, 3))
    n = SIDE * SIDE // 4
    row, column = random.integers(0, height, n), random.integers(0, width, n)
    exact = np.where(np.arange(n) % 2, drawn[32][row, column], (drawn[24][row, column] / (2**24 - 1)))
    points[:n] = np.stack([(column + 0.5) / width, (row + 0.5) / height, exact], axis=1)
    # Another quarter near the stored depth, where neighbours differ.
    points[n : 2 * n, 2] = exact + random.normal(0, 0.02, n)
    points[n : 2 * n, :2] = points[:n, :2] + random.uniform(-0.6, 0.6, (n, 2)) / (width, height)
    return points.astype(np.float32).reshape(SIDE, SIDE, 3)
