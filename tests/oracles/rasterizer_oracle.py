"""A brute-force rasterizer in NumPy that shares no code with the package: every face at every pixel, exactly.

Faces that need no clipping are drawn with 64-bit integers from corners snapped to 1/256 pixel, so their coverage is
exact; their depth is that of the plane through the corners before they snap. Faces that reach before the near plane
or leave the guard band are never cut: a pixel centre `(x, y, 1)` is a positive mix `Σ c_i (x_i, y_i, w_i)` of the
corners just where it is inside, and its depth is then `Σ c_i z_i` (Olano & Greer 1997). A rasterizer that clips rounds
its new corners, and the last digit of `x / w` decides how a corner midway between two sub-pixels snaps; so near the
edges of such faces, within `slack`, either answer is right.
"""

from typing import NamedTuple

import numpy as np

SUBPIXELS = 256
GUARD_BAND = 4096
EPSILON = float(np.finfo(np.float32).eps)
# Two corners a half sub-pixel off in x and in y, and twice that for the second rounding.
SNAPPING_SLACK = 1 / 128
# How far the depth of a centre may run beyond that of the corners, as a share of their range.
OVERSHOOT = 0.02


class Layers(NamedTuple):
    """What every face is at every pixel, whether or not another hides it.

    - `inside`: (f, h, w), whether the face covers the centre, at any depth, and its side is not culled.
    - `depth`: (f, h, w), window depth of its plane.
    - `margin`: (f, h, w), distance in pixels of the centre from the face's outline, positive inside.
    - `depth_error`: (f, h, w), what rounding to float32 may change of the depth.
    - `slack`: (f,), how far rounding may move the outline, in pixels; 0 for most faces that need no clipping.
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
    depth = np.where(layers.inside & (layers.depth >= 0) & (layers.depth < 1), layers.depth, np.inf)
    face = np.argmin(depth, axis=0)
    two = np.sort(np.concatenate([depth, np.full_like(depth[:2], np.inf)]), axis=0)[:2]
    seen = two[0] < np.inf
    gap = np.where(seen, np.where(seen, two[1], np.inf) - np.where(seen, two[0], 0), np.inf)
    margin = np.abs(layers.margin).min(axis=0) * SUBPIXELS
    return Exact(np.where(seen, face, -1), np.where(seen, two[0], 1), margin, gap, layers)


def acceptable(drawn, layers: Layers) -> np.ndarray:
    """Where (h, w) a face map `drawn` (h, w) is right up to rounding of depths, and of outlines that have slack.

    A face may be seen if it covers the centre, or nearly so if its outline has slack; and only if none that surely
    covers the centre is surely nearer.
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
    error = sign * layers.depth_error
    return (layers.depth >= -error) & (layers.depth < 1 + error)


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
    """Coverage of faces (n, 3, 4) that need no clipping, in whole numbers."""
    height, width = resolution
    corners = corners.astype(np.float64)
    window = (corners[..., :3] / corners[..., 3:] * 0.5 + 0.5) * [width, height, 1]
    sub_pixels = window[..., :2] * SUBPIXELS
    xy = np.rint(sub_pixels).astype(np.int64)
    # The last digits of a float32 x / w decide to which of two a corner midway between them snaps.
    off_midway = np.abs(sub_pixels - np.floor(sub_pixels) - 0.5)
    midway = off_midway <= 2 * EPSILON * (np.abs(sub_pixels) + SUBPIXELS * max(resolution))
    slack = np.where(midway.any(axis=(1, 2)), SNAPPING_SLACK, 0)

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

    # Distance from each edge as a segment, in the direction in which it was given.
    way_x, way_y = following[..., 0][:, :, None, None], following[..., 1][:, :, None, None]
    along = np.clip((from_x * way_x + from_y * way_y) / np.maximum(way_x**2 + way_y**2, 1), 0, 1)
    distance = np.hypot(from_x - along * way_x, from_y - along * way_y).min(axis=1) / SUBPIXELS
    margin = np.where((edge >= 0).all(axis=1) & facing[:, None, None], distance, -distance)
    depth, error = _plane(window, resolution)
    return inside, depth, margin, error, slack


def _plane(window, resolution):
    """Depth (n, h, w) of the planes of triangles (n, 3, 3) in window coordinates, and what float32 may change of it."""
    height, width = resolution
    x, y, z = (a[:, :, None, None] for a in np.moveaxis(window, -1, 0))
    (dx1, dx2), (dy1, dy2), (dz1, dz2) = ((a[:, 1] - a[:, 0], a[:, 2] - a[:, 0]) for a in (x, y, z))
    area = dx1 * dy2 - dx2 * dy1
    safe = np.where(area == 0, 1, area)
    slope_x, slope_y = (dz1 * dy2 - dz2 * dy1) / safe, (dz2 * dx1 - dz1 * dx2) / safe
    px, py = np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]
    low, high = z.min(axis=1), z.max(axis=1)
    # A centre on a sliver may lie off it before it was snapped, and its depth far beyond the corners'.
    beyond = OVERSHOOT * (high - low)
    depth = np.clip(z[:, 0] + slope_x * (px - x[:, 0]) + slope_y * (py - y[:, 0]), low - beyond, high + beyond)

    # What float32 makes of places, products, the area and the slopes, in this order.
    place = EPSILON * (np.abs(window[..., :2]).max(axis=(1, 2))[:, None, None] + max(resolution))
    sides = np.abs(dx1) + np.abs(dx2) + np.abs(dy1) + np.abs(dy2)
    size = np.abs(safe)
    of_area = (4 * place * sides + 4 * EPSILON * (np.abs(dx1 * dy2) + np.abs(dx2 * dy1))) / size
    rise = np.abs(dz1) + np.abs(dz2)
    largest_x = (np.abs(dz1 * dy2) + np.abs(dz2 * dy1)) / size
    largest_y = (np.abs(dz1 * dx2) + np.abs(dz2 * dx1)) / size
    of_slope = (4 * place * rise + 4 * EPSILON * sides * np.abs(z).max(axis=1)) / size
    error_x, error_y = ((of_area + 4 * EPSILON) * largest + of_slope for largest in (largest_x, largest_y))
    error = error_x * np.abs(px - x[:, 0]) + error_y * np.abs(py - y[:, 0])
    error += 4 * EPSILON * (1 + largest_x * (np.abs(x[:, 0]) + px) + largest_y * (np.abs(y[:, 0]) + py))
    # A place that is off by this much finds another depth on the plane; of a triangle without an area, any.
    error = np.where((of_area > 0.25) | (area == 0), high - low + 2 * beyond, error)
    return depth, error + place * (largest_x + largest_y)


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
    lines = lines / np.where(determinant == 0, 1, determinant)[:, None, None]
    depth_line = np.sum(lines * z[..., None], axis=1, keepdims=True)

    px, py = (np.arange(width) + 0.5), (np.arange(height) + 0.5)[:, None]
    at_centres = lambda line: line[..., 0, None, None] * px + line[..., 1, None, None] * py + line[..., 2, None, None]
    value, depth = at_centres(lines), at_centres(depth_line)[:, 0] * 0.5 + 0.5
    steepness = np.hypot(lines[..., 0], lines[..., 1])[..., None, None]
    distance = np.where(steepness > 0, value / np.where(steepness > 0, steepness, 1), np.copysign(np.inf, value))
    margin = np.where(facing[:, None, None], distance.min(axis=1), -np.inf)
    inside = (value >= 0).all(axis=1) & facing[:, None, None]

    moved, deepened = _clip_rounding(corners, resolution)
    slope = np.abs(depth_line[:, 0, :2]).sum(axis=-1) / 2
    at_middle = 1 + np.abs(depth_line[:, 0] @ [width / 2, height / 2, 1])
    # A corner that moves turns the plane; that of a sliver it turns far.
    turned = np.sum(steepness[..., 0, 0] * (np.abs(z) + np.abs(w)), axis=1) * (2 * moved + 16 * EPSILON * GUARD_BAND)
    error = slope * SNAPPING_SLACK + turned + deepened * at_middle + 8 * EPSILON
    return inside, depth, margin, np.broadcast_to(error[:, None, None], depth.shape), SNAPPING_SLACK + moved


def _clip_rounding(corners, resolution):
    """How far float32 may move, in pixels and in depth, the corners that near plane and guard band make; (n,) each."""
    guard_x, guard_y = (2 * GUARD_BAND / n for n in resolution[::-1])
    planes = np.array([[0, 0, 1, 1], [1, 0, 0, guard_x], [-1, 0, 0, guard_x], [0, 1, 0, guard_y], [0, -1, 0, guard_y]])
    moved = deepened = np.zeros(len(corners))
    for start, end in ((corners, np.roll(corners, -1, axis=1)), (np.roll(corners, -1, axis=1), corners)):
        for plane in planes:
            d_inner, d_outer = start @ plane, end @ plane
            crosses = (d_inner >= 0) & (d_outer < 0)
            way = (d_inner / np.where(crosses, d_inner - d_outer, 1))[..., None] * (end - start)
            new = start + way
            w = np.where(crosses & (new[..., 3] > 0), new[..., 3], np.inf)
            # Numbers that cancel leave this behind.
            left = 4 * EPSILON * (np.abs(start) + np.abs(way)) / w[..., None]
            aside = np.maximum(np.abs(new[..., :2]).max(axis=-1) / w, 2)
            # An error of w moves a corner to or from the middle of the view, which hardly moves an edge in view.
            moved = np.maximum(moved, (left[..., :2].max(axis=-1) + 2 * left[..., 3]).max(axis=1) * max(resolution) / 2)
            deepened = np.maximum(deepened, (left[..., 2] * 2 / aside + left[..., 3]).max(axis=1))
    return moved, deepened
