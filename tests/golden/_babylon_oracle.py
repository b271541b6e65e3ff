"""What Babylon.js computes from its own shadow map, in NumPy, sharing no code with the package.

Input are the settings of a drawing, the light's matrices, the interpolated positions, and the maps, all as the engine
had them: rasterization takes no part. Babylon.js 9.34, `ShadowGenerator` on WebGL2.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from _three_oracle import cube_fetch, cube_nearest, cube_texel, f32, footprint, nearest

POISSON = np.array(
    [(-0.94201624, -0.39906216), (0.94558609, -0.76890725), (-0.094184101, -0.92938870), (0.34495938, 0.29387760)]
)
POISSON_CUBE = np.array([(-1, 1, -1), (1, -1, -1), (-1, -1, -1), (1, -1, 1)], float)
# Exponents of more would overflow a float.
MAX_EXPONENT = 87.0


def babylon_visibility(
    settings: Mapping[str, Any],
    info: Mapping[str, Any],
    arrays: Mapping[str, np.ndarray],
    tables: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Visibility (h, w) by Babylon.js' rules; 1 where there is no receiver.

    `settings` is a job of `experiments/engines`, `info` and `arrays` are what it gave back. Contact hardening needs
    `tables`, the engine's PoissonSamplers32 and PoissonSamplers64 (n, 2).
    """
    generator, name = settings["generator"], info["filter"]
    mesh = arrays["mesh"]
    receives = np.array([m.get("receives", True) for m in settings["meshes"]] + [False])[mesh]
    position = arrays["position"][receives].astype(np.float64)
    darkness, falloff = generator.get("darkness", 0.0), generator.get("frustumEdgeFalloff", 0.0)
    least, whole = info["depthValues"]
    color = arrays.get("map_blurred", arrays.get("map_metric"))
    scale = generator.get("blurScale", 2.0) / info["mapSize"][0]
    if settings["light"]["type"] == "point":
        way = position - np.array(info["lightPosition"])
        metric = ((np.linalg.norm(way, axis=1) + least) / whole).clip(0, 1)
        unit = way / np.linalg.norm(way, axis=1)[:, None] * [1, -1, 1]
        value = point(name, arrays["map_metric"], unit, metric, darkness, scale, generator.get("depthScale", 50.0))
    else:
        clip = np.c_[position, np.ones(len(position))] @ np.reshape(info["shadowMatrix"], (4, 4))
        at = clip[:, :3] / clip[:, 3:]
        metric, uv, z = (clip[:, 2] + least) / whole, 0.5 * at[:, :2] + 0.5, 0.5 * at[:, 2] + 0.5
        inside = ((uv >= 0) & (uv <= 1)).all(1)
        if name in ("PCF", "PCSS"):
            inside &= (metric >= 0) & (metric <= 1)
            quality = generator.get("filteringQuality", "HIGH")
            if name == "PCF":
                lit = pcf(arrays["map_depth"], uv, z, quality)
            else:
                assert tables is not None
                ratio, turn = generator.get("contactHardeningLightSizeUVRatio", 0.1), arrays["random"][receives]
                lit = pcss(arrays["map_depth"], color, uv, z, metric, ratio, turn * 3.1415926, quality, tables)
            value = darkness + (1 - darkness) * lit
        else:
            value = flat(name, color, uv, metric.clip(0, 1), darkness, scale, generator.get("depthScale", 50.0))
        # A lit NONE is not mixed, which is the same.
        edge = smoothstep(1 - falloff, 1.00000012, (at[:, :2] ** 2).sum(1).clip(0, 1))
        value = np.where(inside, value + (1 - value) * edge, 1.0)
    visibility = np.ones(mesh.shape)
    visibility[receives] = value
    return visibility


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    share = ((x - low) / (high - low)).clip(0, 1)
    return share * share * (3 - 2 * share)


def bilinear(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    height, width = image.shape
    taps = footprint(uv, width, height)
    mean = sum((w * image[y.clip(0, height - 1), x.clip(0, width - 1)] for x, y, w in taps), np.zeros(len(uv)))
    # A texture unit's result is a float: the mean of four texels of 1 is 1, not 1 - 1e-16.
    return mean.astype(f32)


def exponential(name: str, metric: np.ndarray, texel: np.ndarray, darkness: float, steepness: float) -> np.ndarray:
    if "CLOSE" in name:
        return np.exp(np.minimum(MAX_EXPONENT, -steepness * (metric - texel))).clip(darkness, 1)
    return 1 - (np.exp(np.minimum(MAX_EXPONENT, steepness * metric)) * texel).clip(0, 1 - darkness)


def flat(name: str, color, uv, metric, darkness: float, scale: float, steepness: float) -> np.ndarray:
    if name == "NONE":
        return np.where(metric.astype(f32) > nearest(color, uv), darkness, 1.0)
    if name == "POISSONSAMPLING":
        hidden = sum((bilinear(color, uv + tap * scale) < metric).astype(float) for tap in POISSON)
        return np.minimum(1, 1 - 0.25 * hidden + darkness)
    return exponential(name, metric, bilinear(color, uv), darkness, steepness)


def point(name: str, cube, unit, metric, darkness: float, scale: float, steepness: float) -> np.ndarray:
    if name == "NONE":
        return np.where(metric.astype(f32) > cube_nearest(cube, unit), darkness, 1.0)
    if name in ("POISSONSAMPLING", "PCF", "PCSS"):
        hidden = sum((cube_linear(cube, unit + tap * scale) < metric).astype(float) for tap in POISSON_CUBE)
        return np.minimum(1, 1 - 0.25 * hidden + darkness)
    return exponential(name, metric, cube_linear(cube, unit), darkness, steepness)


def cube_linear(cube: np.ndarray, way: np.ndarray) -> np.ndarray:
    face, st = cube_texel(cube, way)
    size = cube.shape[-1]
    taps = footprint(st, size, size)
    return sum((weight * cube_fetch(cube, face, x, y) for x, y, weight in taps), np.zeros(len(way)))


def compared(depth: np.ndarray, uv: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The texture unit's LESS, bilinear."""
    height, width = depth.shape
    taps = footprint(uv, width, height)
    less = lambda x, y: z.astype(f32) < depth[y.clip(0, height - 1), x.clip(0, width - 1)]
    return sum((weight * less(x, y) for x, y, weight in taps), np.zeros(len(uv)))


def pcf(depth: np.ndarray, uv: np.ndarray, z: np.ndarray, quality: str) -> np.ndarray:
    """Castaño's tent of 2, 3 or 5 texels, out of 1, 4 or 9 bilinear comparisons."""
    size = depth.shape[0]
    if quality == "LOW":
        return compared(depth, uv, z)
    place = uv * size + 0.5
    s = place - np.floor(place)
    base = (np.floor(place) - 0.5) / size
    if quality == "MEDIUM":
        weights, offsets = [3 - 2 * s, 1 + 2 * s], [(2 - s) / (3 - 2 * s) - 1, s / (1 + 2 * s) + 1]
    else:
        weights = [4 - 3 * s, 7 + 0 * s, 1 + 3 * s]
        offsets = [(3 - 2 * s) / (4 - 3 * s) - 2, (3 + s) / 7, s / (1 + 3 * s) + 2]
    total = np.zeros(len(uv))
    for wx, ox in zip(weights, offsets, strict=True):
        for wy, oy in zip(weights, offsets, strict=True):
            tap = base + np.c_[ox[:, 0], oy[:, 1]] / size
            total += wx[:, 0] * wy[:, 1] * compared(depth, tap, z)
    return total / (16 if quality == "MEDIUM" else 144)


def pcss(depth, color, uv, z, metric, ratio: float, angle, quality: str, tables) -> np.ndarray:
    size = depth.shape[0]
    searched = 32 if quality == "HIGH" else 16
    blockers, total = np.zeros(len(uv)), np.zeros(len(uv))
    for tap in tables[0][:searched]:
        texel = nearest(color, uv + tap * ratio)
        blockers, total = blockers + (texel < metric), total + np.where(texel < metric, texel, 0)
    mean = total / np.maximum(blockers, 1)
    radius = (metric - mean + 10 / size) * ratio
    taps = {"LOW": tables[0][:16], "MEDIUM": tables[0][:32], "HIGH": tables[1]}[quality]
    c, s = np.cos(angle), np.sin(angle)
    lit = np.zeros(len(uv))
    for x, y in taps:
        lit += compared(depth, uv + np.c_[x * c - y * s, y * c + x * s] * radius[:, None], z) / len(taps)
    return np.where(blockers < 1, 1.0, lit + (1 - lit) * (metric - mean))
