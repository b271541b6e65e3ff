"""What three.js computes from its own shadow map, in NumPy, sharing no code with the package.

Input are the settings of a drawing, the light's matrices, the interpolated positions and normals, and the map, all as
the engine had them: rasterization takes no part. three.js r187, `WebGLRenderer`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

# The faces of a cube map as OpenGL numbers them: major axis and its sign, then axes and signs of s and of t.
CUBE = (
    ((0, 1), (2, -1), (1, -1)),
    ((0, -1), (2, 1), (1, -1)),
    ((1, 1), (0, 1), (2, 1)),
    ((1, -1), (0, 1), (2, -1)),
    ((2, 1), (0, 1), (1, -1)),
    ((2, -1), (0, -1), (1, -1)),
)
GOLDEN_ANGLE = 2.399963229728653
f32 = np.float32


def three_visibility(settings: Mapping[str, Any], info: Mapping[str, Any], arrays: Mapping[str, np.ndarray]):
    """Visibility (h, w) by three.js' rules; 1 where there is no receiver.

    `settings` is a job of `experiments/engines`, `info` and `arrays` are what it gave back.
    """
    light, type_ = settings["light"], settings["shadowType"]
    is_reversed = settings.get("reversedDepthBuffer", False)
    mesh = arrays["mesh"]
    receives = np.array([m.get("receives", True) for m in settings["meshes"]] + [False])[mesh]
    at = np.argwhere(receives)
    offset = light.get("normalBias", 0.0) * arrays["normal"][receives].astype(np.float64)
    position = arrays["position"][receives].astype(np.float64) + offset
    bias, radius = light.get("bias", 0.0), light.get("radius", 1.0)
    turn = 2 * np.pi * interleaved_gradient_noise(at[:, ::-1] + 0.5)
    if light["type"] == "point":
        function = {"Basic": point_basic, "PCF": point_pcf}[type_.removesuffix("Soft")]
        way = position - np.array(info["lightPosition"])
        value = function(arrays["map"], way, info["near"], info["far"], bias, radius, turn, is_reversed)
    else:
        coordinate = np.c_[position, np.ones(len(position))] @ np.reshape(info["shadowMatrix"], (4, 4)).astype(f32)
        coordinate = coordinate[:, :3] / coordinate[:, 3:]
        z = coordinate[:, 2] + (-bias if is_reversed else bias)
        inside = ((coordinate[:, :2] >= 0) & (coordinate[:, :2] <= 1)).all(1) & (z <= 1)
        uv = coordinate[:, :2]
        if type_ == "Basic":
            value = compare(nearest(arrays["map"], uv), z, is_reversed)
        elif type_ == "VSM":
            value = chebyshev(arrays["map_blurred"], uv, z, is_reversed)
        else:
            value = pcf(arrays["map"], uv, z, radius, turn, is_reversed)
        value = np.where(inside, value, 1.0)
    visibility = np.ones(mesh.shape)
    visibility[receives] = 1 + (value - 1) * light.get("intensity", 1.0)
    return visibility


def compare(texel: np.ndarray, z: np.ndarray, is_reversed: bool) -> np.ndarray:
    """LEQUAL, as the texture unit or the shader does it, in float32."""
    texel, z = texel.astype(f32), z.astype(f32)
    return ((z >= texel) if is_reversed else (z <= texel)).astype(np.float64)


def interleaved_gradient_noise(fragment: np.ndarray) -> np.ndarray:
    """(n,), from gl_FragCoord (n, 2), in float32."""
    x, y = fragment.astype(f32).T
    inner = x * f32(0.06711056) + y * f32(0.00583715)
    outer = f32(52.9829189) * (inner - np.floor(inner))
    return (outer - np.floor(outer)).astype(np.float64)


def disk(turn: np.ndarray) -> list[np.ndarray]:
    """The five taps (n, 2) of the unit disk."""
    angles = [GOLDEN_ANGLE * k + turn for k in range(5)]
    return [np.sqrt((k + 0.5) / 5) * np.c_[np.cos(a), np.sin(a)] for k, a in enumerate(angles)]


def nearest(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    height, width = image.shape[:2]
    x, y = np.floor(uv * [width, height]).astype(int).T
    return image[y.clip(0, height - 1), x.clip(0, width - 1)]


def footprint(uv: np.ndarray, width: int, height: int):
    """The four texels of bilinear filtering, (x, y, weight) each, not yet clamped."""
    place = uv * [width, height] - 0.5
    low = np.floor(place).astype(int)
    share = place - low
    for dx in (0, 1):
        for dy in (0, 1):
            weight = (share[:, 0] if dx else 1 - share[:, 0]) * (share[:, 1] if dy else 1 - share[:, 1])
            yield low[:, 0] + dx, low[:, 1] + dy, weight


def pcf(depth: np.ndarray, uv: np.ndarray, z: np.ndarray, radius: float, turn: np.ndarray, is_reversed: bool):
    height, width = depth.shape
    total = np.zeros(len(uv))
    for tap in disk(turn):
        for x, y, weight in footprint(uv + tap * radius / [width, height], width, height):
            texel = depth[y.clip(0, height - 1), x.clip(0, width - 1)]
            total += 0.2 * weight * compare(texel, z, is_reversed)
    return total


def blurred(depth: np.ndarray, radius: float, samples: int) -> np.ndarray:
    """The map (h, w, 2) of mean and standard deviation, rounded to half floats after each pass: the engine's bits.

    Every operation is one in float32, as the software rasterizer does it.
    """
    return horizontally(vertically(depth, radius, samples), radius, samples)


def vertically(depth: np.ndarray, radius: float, samples: int) -> np.ndarray:
    height = depth.shape[0]
    rows = [in_texels(np.arange(height, dtype=f32), o * f32(radius), height).astype(int) for o in offsets(samples)]
    return as_half(*mean_and_deviation([(depth[row], depth[row] * depth[row]) for row in rows]))


def horizontally(moments: np.ndarray, radius: float, samples: int) -> np.ndarray:
    height, width = moments.shape[:2]
    # In maps whose height is no power of two, rounding moves each row a little towards a neighbour.
    own_low, own_high, own_share = between(in_texels(np.arange(height, dtype=f32), f32(0), height), height)
    pairs = []
    for offset in offsets(samples):
        low, high, share = between(in_texels(np.arange(width, dtype=f32), offset * f32(radius), width), width)
        rows = mix(moments[:, low], moments[:, high], share[:, None])
        mean, deviation = np.moveaxis(mix(rows[own_low], rows[own_high], own_share[:, None, None]), -1, 0)
        pairs.append((mean, deviation * deviation + mean * mean))
    return as_half(*mean_and_deviation(pairs))


def offsets(samples: int) -> list[np.float32]:
    if samples == 1:
        return [f32(0)]
    return [f32(-1) + f32(i) * (f32(2) / f32(samples - 1)) for i in range(samples)]


def in_texels(texel: np.ndarray, offset: np.float32, size: int) -> np.ndarray:
    """The place of a texel's centre, moved by `offset`, as the texture unit has it: clamped to less than `size`."""
    place = (texel + f32(0.5) + offset) / f32(size)
    return place.clip(f32(0), np.nextafter(f32(1), f32(0))) * f32(size)


def between(place: np.ndarray, size: int):
    """The two texels that `place` lies between, clamped to the edge, and the second one's share."""
    low = np.floor(place - f32(0.5))
    return low.astype(int).clip(0, size - 1), (low + 1).astype(int).clip(0, size - 1), place - f32(0.5) - low


def mix(low: np.ndarray, high: np.ndarray, share: np.ndarray) -> np.ndarray:
    return low + share * (high - low)


def mean_and_deviation(pairs: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    # Summed in order and in float32: the cancellation is part of the picture.
    mean, square = np.zeros_like(pairs[0][0], f32), np.zeros_like(pairs[0][0], f32)
    for value, squared in pairs:
        mean, square = mean + value, square + squared
    share = f32(1) / f32(len(pairs))
    mean, square = mean * share, square * share
    return mean, np.sqrt(np.maximum(f32(0), square - mean * mean))


def as_half(*channels: np.ndarray) -> np.ndarray:
    return np.stack(channels, -1).astype(np.float16).astype(f32)


def chebyshev(moments: np.ndarray, uv: np.ndarray, z: np.ndarray, is_reversed: bool) -> np.ndarray:
    height, width = moments.shape[:2]
    mean, deviation = np.zeros((2, len(uv)))
    for x, y, weight in footprint(uv, width, height):
        texel = moments[y.clip(0, height - 1), x.clip(0, width - 1)]
        mean, deviation = mean + weight * texel[:, 0], deviation + weight * texel[:, 1]
    variance = np.maximum(deviation**2, 1e-7)
    upper = variance / (variance + (z - mean) ** 2)
    return np.maximum(compare(mean, z, is_reversed), ((upper - 0.3) / 0.65).clip(0, 1))


def cube_texel(cube: np.ndarray, way: np.ndarray):
    """Face (n,) and its s, t (n, 2) in 0..1 of the directions `way` (n, 3)."""
    axis = np.abs(way).argmax(1)
    major = np.take_along_axis(way, axis[:, None], 1)[:, 0]
    face = 2 * axis + (major < 0)
    st = np.empty((len(way), 2))
    for index, (_, *sides) in enumerate(CUBE):
        here = face == index
        for k, (side, sign) in enumerate(sides):
            st[here, k] = 0.5 * (sign * way[here, side] / np.abs(major[here]) + 1)
    return face, st


def cube_nearest(cube: np.ndarray, way: np.ndarray) -> np.ndarray:
    size = cube.shape[-1]
    face, st = cube_texel(cube, way)
    x, y = np.floor(st * size).astype(int).clip(0, size - 1).T
    return cube[face, y, x]


def cube_fetch(cube: np.ndarray, face: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The texel of `face` at x, y, or, one beyond its border, the neighbouring face's."""
    size = cube.shape[-1]
    # Barely past the border, so that the place along the edge stays the same.
    st = np.stack([x, y], -1) + 0.5
    st = st.clip(-1e-4, size + 1e-4) * 2 / size - 1
    way = np.empty((len(face), 3))
    for index, ((axis, sign), *sides) in enumerate(CUBE):
        here = face == index
        way[here, axis] = sign
        for k, (side, turned) in enumerate(sides):
            way[here, side] = turned * st[here, k]
    return cube_nearest(cube, way)


def point_basic(cube, way, near, far, bias, radius, turn, is_reversed):
    axis_distance = np.abs(way).max(1)
    z = far * (axis_distance - near) / (axis_distance * (far - near)) + bias
    texel = cube_nearest(cube, way)
    value = compare(1 - texel.astype(f32) if is_reversed else texel, z, False)
    return np.where((axis_distance >= near) & (axis_distance <= far), value, 1.0)


def point_pcf(cube, way, near, far, bias, radius, turn, is_reversed):
    size = cube.shape[-1]
    distance = np.linalg.norm(way, axis=1)
    unit = way / distance[:, None]
    side = np.where((np.abs(unit[:, 0]) > np.abs(unit[:, 2]))[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    tangent = np.cross(unit, side)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    bitangent = np.cross(unit, tangent)
    if is_reversed:
        a, b = -near / (far - near) - bias, near * far / ((far - near) * distance)
    else:
        a, b = far / (far - near) + bias, -near * far / ((far - near) * distance)
    total = np.zeros(len(way))
    for tap in disk(turn):
        direction = unit + (tangent * tap[:, :1] + bitangent * tap[:, 1:]) * radius / size
        z = a + b / np.abs(direction).max(1)
        face, st = cube_texel(cube, direction)
        for x, y, weight in footprint(st, size, size):
            total += 0.2 * weight * compare(cube_fetch(cube, face, x, y), z, is_reversed)
    axis_distance = np.abs(way).max(1)
    return np.where((axis_distance >= near) & (axis_distance <= far), total, 1.0)
