"""Draws golden shadow factors with OpenGL and stores them in the folder `techniques` beside this script.

    python tests/golden/make_golden_techniques.py

needs what `make_golden.py` needs. `golden_techniques.py` says what is stored.
"""

from itertools import product
from pathlib import Path

import numpy as np
from _opengl import OpenGL, State
from _techniques import LINEAR, TAPS, Light, Painter, View, bind_map, offset_table, offset_texture, scene, view

FOLDER = Path(__file__).parent / "techniques"
IMAGE = (96, 112)
MAP = (128, 144)
RADIUS = 3.5

# By name: bits, what is culled, and polygon offset.
MAPS = {
    "float32": (32, State()),
    "unorm24": (24, State()),
    "unorm24_cull_front": (24, State(cull="front")),
    "float32_cull_back_offset": (32, State(cull="back", offset=(1.5, 8.0))),
    "unorm24_offset": (24, State(offset=(2.0, 4.0))),
}
COMPARES = {"less": "<", "less_equal": "<="}
# Biases in texels' widths.
BIASES = {
    "none": {"constant_bias": 0.0, "slope_bias": 0.0, "least_bias": 0.0},
    "constant": {"constant_bias": 1.25, "slope_bias": 0.0, "least_bias": 0.0},
    "slope": {"constant_bias": 0.0, "slope_bias": 7.0, "least_bias": 1.5},
}


def camera() -> View:
    half = np.tan(np.deg2rad(21))
    height, width = IMAGE
    return view((2.7, 3.0, 3.9), (0.0, 0.3, 0.1), (half * width / height, half), 0.5, 12.0, perspective=True)


def lights() -> dict[str, Light]:
    """Both leave a part of the ground beside their map, and a part beyond their far plane."""
    aspect = MAP[1] / MAP[0]
    way = np.array([-0.5, 1.0, 0.3]) / np.linalg.norm([-0.5, 1.0, 0.3])
    sun = view(way * 4 + [0.0, 0.3, 0.2], (0.0, 0.3, 0.2), (2.2 * aspect, 2.2), 1.0, 5.4, perspective=False)
    # Straight down, and all numbers binary fractions: on the slab, stored and reference depth are exactly 1/2.
    turn = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, -4], [0, 0, 0, 1]], np.float32)
    overhead = View(turn, np.diag([1 / 2.25, 0.5, -0.5, 1]).astype(np.float32), 2.0, 6.0)
    overhead.eye_to_clip[2, 3] = -2.0
    lamp = view((-1.7, 3.3, 1.6), (0.1, 0.2, 0.1), (0.62 * aspect, 0.62), 1.0, 5.6, perspective=True)
    return {
        "directional": Light(sun, (*way, 0.0)),
        "overhead": Light(overhead, (0.0, 1.0, 0.0, 0.0)),
        "spot": Light(lamp, (-1.7, 3.3, 1.6, 1.0)),
    }


def combinations(light: str):
    """Technique, map, bias and compare of each factor that is stored."""
    if light == "overhead":
        yield from product(("nearest", "bilinear", "box"), ["float32"], ["none"], COMPARES)
        return
    for technique in TAPS:
        for name, (bits, state) in MAPS.items():
            plain = state == State()
            bias = "slope" if technique == "box" else "constant" if plain else "none"
            for compare in COMPARES if plain else ["less" if bits == 32 else "less_equal"]:
                yield technique, name, bias, compare


def draw_light(
    gl: OpenGL, painter: Painter, light: Light, cases: list[tuple[str, str, str, str]], covered: np.ndarray
) -> dict[str, np.ndarray]:
    """What is stored of one light; `covered` (h, w) says which pixels show a surface."""
    clip = light.view.clip(painter.vertices)
    common = {"texel_depth": light.view.texel_depth(MAP), "map": 0, "offsets": 1, "radius": RADIUS, "early_out": True}
    found: dict[str, np.ndarray] = {
        "world_to_eye": light.view.world_to_eye,
        "eye_to_clip": light.view.eye_to_clip,
        "near_far": np.array([light.view.near, light.view.far], np.float32),
        "at": np.array(light.at, np.float32),
    }
    for bias in sorted({case[2] for case in cases}):
        painter.set("coordinates", light, common | BIASES[bias])
        painter.render("coordinates")
        at, facing = painter.read(0), painter.read(1)
        found["coordinate"] = np.where(covered[..., None], at[..., :3], 0)
        found[f"reference_{bias}"] = np.where(covered, at[..., 3], 0)
        found["facing"] = covered & (facing > 0)
    for name in sorted({case[1] for case in cases}):
        bits, state = MAPS[name]
        found |= {f"cull_{name}": np.array(state.cull), f"offset_{name}": np.array(state.offset, np.float32)}
        found[f"map_{name}"] = gl.draw(clip, painter.faces, MAP, bits, state).depth
        texture = gl.depth_texture(clip, painter.faces, MAP, bits, state)
        for technique, bias, compare in ((case[0], *case[2:]) for case in cases if case[1] == name):
            bind_map(gl, texture, technique in LINEAR, COMPARES[compare])
            painter.set(technique, light, common | BIASES[bias])
            painter.render(technique)
            taps = np.where(covered, painter.read()[..., 0], 0)
            found[f"taps-{technique}-{name}-{bias}-{compare}"] = taps if technique in LINEAR else as_counts(taps)
        texture.release()
    return found


def as_counts(taps: np.ndarray) -> np.ndarray:
    """Whole numbers of lit taps in a byte each.

    **Raises** `ValueError` if they are not whole.
    """
    counts = taps.astype(np.uint8)
    if (counts != taps).any():
        raise ValueError("nearest taps add up to numbers that are not whole; expected each to be 0 or 1")
    return counts


def main() -> None:
    gl = OpenGL()
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.npz"):
        old.unlink()
    vertices, faces = scene()
    eye, table = camera(), offset_table()
    painter = Painter(gl, vertices, faces, eye, IMAGE)
    offset_texture(gl, table)
    winner = gl.draw(eye.clip(vertices), faces, IMAGE, 32, State()).winner
    np.savez_compressed(
        FOLDER / "scene.npz",
        vertices=vertices,
        faces=faces.astype(np.int16),
        world_to_eye=eye.world_to_eye,
        eye_to_clip=eye.eye_to_clip,
        near_far=np.array([eye.near, eye.far], np.float32),
        face=winner.astype(np.int16),
        offsets=table,
        radius=np.float32(RADIUS),
        **{f"bias_{name}": np.array(list(values.values()), np.float32) for name, values in BIASES.items()},
    )
    for name, light in lights().items():
        np.savez_compressed(
            FOLDER / f"{name}.npz", **draw_light(gl, painter, light, list(combinations(name)), winner >= 0)
        )
        print(f"{name}: {(FOLDER / f'{name}.npz').stat().st_size / 1e3:.0f} kB")
    total = sum(path.stat().st_size for path in FOLDER.glob("*.npz"))
    print(f"{gl.renderer}, OpenGL {gl.version}: {total / 1e3:.0f} kB in {FOLDER}")


if __name__ == "__main__":
    main()
