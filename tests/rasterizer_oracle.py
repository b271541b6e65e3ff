"""A brute-force rasterizer in NumPy that shares no code with the package: every face at every pixel, exactly.

Faces that need no clipping are drawn with 64-bit integers from the same snapped corners as any rasterizer of 1/256
pixel must use, so their coverage is exact. Faces that reach before the near plane or leave the guard band are never
cut: a pixel centre `(x, y, 1)` is a positive mix `Σ c_i (x_i, y_i, w_i)` of the corners just where it is inside, and its
depth is then `Σ c_i z_i` (Olano & Greer 1997). A rasterizer that clips rounds its new corners, so near their edges,
within `slack`, either answer is right.
"""

from typing import NamedTuple

import numpy as np

SUBPIXELS = 256
GUARD_BAND = 4096
EPSILON = float(np.finfo(np.float32).eps)
# Two corners a half sub-pixel off in x and in y, and twice that for the second rounding.
SNAPPING_SLACK = 1 / 128


class Layers(NamedTuple):
    """What every face is at every pixel, whether or not another hides it.

    - `inside`: (f, h, w), whether the face covers the centre, its depth in [0, 1] and its side not culled.
    - `depth`: (f, h, w), window depth of its plane.
    - `margin`: (f, h, w), distance in pixels of the centre from the face's outline, positive inside.
    - `depth_error`: (f, h, w), what rounding to float32 may change of the depth.
    - `slack`: (f,), what rounding may move of the outline, in pixels; 0 for faces that need no clipping.
    - `clipped`: (f,), whether the face needs clipping.
    """

    inside: np.ndarray
    depth: np.ndarray
    margin: np.ndarray
    depth_error: np.ndarray
    slack: np.ndarray
    clipped: np.ndarray


class Exact(NamedTuple):
    """What each pixel sees.

    - `face`: (h, w), the nearest face, the lowest index of those at the same depth, -1 where there is none.
    - `depth`: (h, w), float64, 1 where there is none.
    - `margin`: (h, w), distance in sub-pixels (1/256 pixel) of the centre from the nearest outline.
    - `gap`: (h, w), depth between the nearest face and the next, infinite where there is no next.
    - `layers`: each face by itself.
    """

    face: np.ndarray
    depth: np.ndarray
    margin: np.ndarray
    gap: np.ndarray
    layers: Layers


def rasterize_exact(clip, faces, resolution, cull="none") -> Exact:
    """Draws `faces` (f, 3) of `clip` (v, 4), clip coordinates that are rounded to float32."""
    layers = draw_layers(clip, faces, resolution, cull)
    depth = np.where(layers.inside, layers.depth, np.inf)
    face = np.argmin(depth, axis=0)
    two = np.sort(np.concatenate([depth, np.full_like(depth[:2], np.inf)]), axis=0)[:2]
    seen = two[0] < np.inf
    gap = np.where(seen, np.where(seen, two[1], np.inf) - np.where(seen, two[0], 0), np.inf)
    margin = np.abs(layers.margin).min(axis=0) * SUBPIXELS
    return Exact(np.where(seen, face, -1), np.where(seen, two[0], 1), margin, gap, layers)


def acceptable(drawn, layers: Layers) -> np.ndarray:
    """Where (h, w) a face map `drawn` (h, w) is right up to rounding of depths, and of edges that clipping made.

    A face may be seen if it covers the centre, or nearly so if it was clipped; and only if none that surely covers
    the centre is surely nearer.
    """
    slack = layers.slack[:, None, None]
    surely = layers.inside & ((layers.margin > slack) | (slack == 0)) & _in_range(layers, -1)
    possibly = (layers.inside | ((slack > 0) & (layers.margin > -slack))) & _in_range(layers, 1)
    bound = np.where(surely, layers.depth + layers.depth_error, np.inf).min(axis=0)
    may_win = possibly & (layers.depth - layers.depth_error <= bound)
    drawn = np.asarray(drawn)
    chosen = np.take_along_axis(may_win, np.maximum(drawn, 0)[None], axis=0)[0]
    return np.where(drawn >= 0, chosen, ~surely.any(axis=0))


def _in_range(layers: Layers, sign: int) -> np.ndarray:
    """Whether the depth lies in [0, 1], made larger (sign 1) or smaller (sign -1) by its rounding."""
    # Only where a depth is near the range's end does its rounding matter.
    error = np.where(layers.depth_error > 0, sign * layers.depth_error, 0)
    inner = (layers.depth >= -error) & (layers.depth <= 1 + error)
    return inner


def draw_layers(clip, faces, resolution, cull="none") -> Layers:
    """Every face at every pixel; arguments as for `rasterize_exact`."""
    corners = np.asarray(clip, np.float32)[np.asarray(faces)]
    clipped = _needs_clipping(corners, resolution).any(axis=1)
    shape = (len(corners), *resolution)
    layers = Layers(
        np.zeros(shape, bool), np.ones(shape), np.empty(shape), np.zeros(shape), np.zeros(len(corners)), clipped
    )
    for chosen, draw in ((~clipped, _draw_snapped), (clipped, _draw_homogeneous)):
        if chosen.any():
            for whole, part in zip(layers, draw(corners[chosen], resolution, cull), strict=False):
                whole[chosen] = part
    return layers


def _needs_clipping(corners, resolution):
    x, y, z, w = np.moveaxis(corners, -1, 0)
    height, width = resolution
    guard_x, guard_y = np.float32(2 * GUARD_BAND / width), np.float32(2 * GUARD_BAND / height)
    return ~((w > 0) & (z >= -w) & (np.abs(x) <= guard_x * w) & (np.abs(y) <= guard_y * w))


def _draw_snapped(corners, resolution, cull):
    """Exact coverage of faces (n, 3, 4) that need no clipping."""
    height, width = resolution
    half = np.float32(0.5)
    ndc = corners[..., :3] / corners[..., 3:]
    window = (ndc * half + half) * np.array([width, height, 1], np.float32)
    xy = np.rint(window[..., :2] * np.float32(SUBPIXELS)).astype(np.int64)
    z = window[..., 2].astype(np.float64)

    following = np.roll(xy, -1, axis=1) - xy
    area = following[:, 0, 0] * -following[:, 2, 1] + following[:, 0, 1] * following[:, 2, 0]
    facing = {"none": area != 0, "back": area > 0, "front": area < 0}[cull]
    turn = np.where(area < 0, -1, 1)[:, None]
    dx, dy = following[..., 0] * turn, following[..., 1] * turn
    # Anticlockwise, a left edge runs downwards, and a bottom edge to the right.
    owns = (dy < 0) | ((dy == 0) & (dx > 0))

    px = (np.arange(width) * SUBPIXELS + SUBPIXELS // 2)[None, None, None, :]
    py = (np.arange(height) * SUBPIXELS + SUBPIXELS // 2)[None, None, :, None]
    dx, dy, owns = (a[:, :, None, None] for a in (dx, dy, owns))
    from_x, from_y = px - xy[..., 0][:, :, None, None], py - xy[..., 1][:, :, None, None]
    edge = dx * from_y - dy * from_x
    inside = ((edge > 0) | ((edge == 0) & owns)).all(axis=1) & facing[:, None, None]

    # Corner k lies opposite the edge from k + 1.
    size = np.maximum(np.abs(area), 1)[:, None, None]
    weights = np.roll(edge, -1, axis=1) / size[:, None]
    depth = np.sum(weights * z[:, :, None, None], axis=1)
    low, high = z.min(axis=1)[:, None, None], z.max(axis=1)[:, None, None]
    depth = np.clip(depth, low, high)

    # A float32 plane rounds in proportion to what is added up in it: slopes, times the way from the first corner.
    rise = np.abs(z - z[:, :1])
    slope_x, slope_y = (
        SUBPIXELS * np.sum(rise * np.abs(np.roll(following[..., k], -1, axis=1)), axis=1)[:, None, None] / size
        for k in (1, 0)
    )
    way_x, way_y = np.abs(from_x[:, 0]) / SUBPIXELS + 64, np.abs(from_y[:, 0]) / SUBPIXELS + 64
    error = 4 * EPSILON * (np.abs(z).max(axis=1)[:, None, None] + slope_x * way_x + slope_y * way_y)
    error = np.minimum(error, high - low + EPSILON)

    # Distance from each edge as a segment.
    length = np.maximum(dx * dx + dy * dy, 1)
    along = np.clip((from_x * dx + from_y * dy) / length, 0, 1)
    distance = np.hypot(from_x - along * dx, from_y - along * dy).min(axis=1) / SUBPIXELS
    margin = np.where((edge >= 0).all(axis=1), distance, -distance)
    return inside & (depth >= 0) & (depth <= 1), depth, margin, error, np.zeros(len(corners))


def _draw_homogeneous(corners, resolution, cull):
    """Coverage of faces (n, 3, 4) wherever their corners lie, without clipping them."""
    height, width = resolution
    corners = corners.astype(np.float64)
    x, y, z, w = np.moveaxis(corners, -1, 0)
    # Rows (x, y, w) in pixels: a centre (px, py, 1) = Σ c_i row_i.
    rows = np.stack([(x + w) / 2 * width, (y + w) / 2 * height, w], axis=-1)
    lines = np.cross(np.roll(rows, -1, axis=1), np.roll(rows, -2, axis=1))
    determinant = np.sum(rows[:, 0] * lines[:, 0], axis=-1)
    facing = {"none": determinant != 0, "back": determinant > 0, "front": determinant < 0}[cull]
    safe = np.where(determinant == 0, 1, determinant)[:, None, None]
    lines = lines / safe
    # The near plane, Σ c_i z_i >= -1, is a fourth line.
    depth_line = np.sum(lines * z[..., None], axis=1, keepdims=True)
    sides = np.concatenate([lines, depth_line + np.array([0, 0, 1.0])], axis=1)

    px, py = (np.arange(width) + 0.5), (np.arange(height) + 0.5)[:, None]
    value = sides[..., 0, None, None] * px + sides[..., 1, None, None] * py + sides[..., 2, None, None]
    steepness = np.hypot(sides[..., 0], sides[..., 1])[..., None, None]
    far_off = np.where(value >= 0, np.inf, -np.inf)
    distance = np.where(steepness > 0, value / np.where(steepness > 0, steepness, 1), far_off)
    margin = np.where(facing[:, None, None], distance.min(axis=1), -np.inf)
    depth = (value[:, 3] - 1) * 0.5 + 0.5
    inside = (value >= 0).all(axis=1) & facing[:, None, None] & (depth <= 1)

    slack = SNAPPING_SLACK + _clip_rounding(corners, resolution)
    error = 0.5 * steepness[:, 3] * slack[:, None, None] + 8 * EPSILON
    return inside, depth, margin, np.broadcast_to(error, depth.shape), slack


def _clip_rounding(corners, resolution):
    """How far, in pixels, float32 may move the corners that the near plane and the guard band make; (n,)."""
    guard_x, guard_y = (2 * GUARD_BAND / n for n in resolution[::-1])
    planes = np.array([[0, 0, 1, 1], [1, 0, 0, guard_x], [-1, 0, 0, guard_x], [0, 1, 0, guard_y], [0, -1, 0, guard_y]])
    outer = np.roll(corners, -1, axis=1)
    largest = np.maximum(np.abs(corners).max(axis=-1), np.abs(outer).max(axis=-1))
    moved = np.zeros(len(corners))
    for plane in planes:
        d, d_outer = corners @ plane, outer @ plane
        crosses = (d >= 0) != (d_outer >= 0)
        t = d / np.where(crosses, d - d_outer, 1)
        new = corners + t[..., None] * (outer - corners)
        w = np.where(crosses & (new[..., 3] > 0), new[..., 3], np.inf)
        aside = 1 + np.minimum(np.abs(new[..., :2]).max(axis=-1) / w, max(guard_x, guard_y))
        # Subtracting numbers of size `largest` leaves w, and with it the place x / w, this far off.
        moved = np.maximum(moved, (4 * EPSILON * largest / w * aside * max(resolution) / 2).max(axis=1))
    return moved
