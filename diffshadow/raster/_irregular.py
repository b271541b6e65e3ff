"""The irregular z-buffer, which tests triangles against points of a light's view instead of a grid of texels.

Johnson et al. 2005, "The irregular z-buffer: hardware acceleration for irregular data structures"; Aila & Laine 2004,
"Alias-free shadow maps". The points are sorted in the light's view (`_strips.py`). Each triangle visits the strips that
its bounds overlap. In each strip, it visits the blocks of points between its left and right bound there. The bounds are
wide enough for rounding errors and only leave out pairs that cannot matter. Whether a triangle hides the light from a
point is then tested in world space, in double precision. The point must be inside the three planes through the light
and an edge, and behind the triangle's plane.

Pairs of triangles and strips are numbered, and so are the blocks of some thousand pairs. Loops run over these numbers,
so memory does not depend on the number of pairs.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import dot, in_float64, safe_divide, take
from ..geometry import AbstractLight, Mesh, Textures, View
from ._alpha_test import Cutouts
from ._items import Items
from ._span import extent
from ._strips import BLOCK, Strips, in_strips

# As fractions of the scene's size. A point within the first distance of an edge is hidden by both of the edge's faces.
# Faces within the second distance of a point do not hide it. Rays traced in float64 have the same tolerances.
_TINY = 1e-12
# Triangles that are closer to the light than this fraction of a point's distance do not hide the point. A surface at
# the light's position therefore does not hide it.
_SHORT_OF_LIGHT = 2.0**-20
# Points this close to the view's border, as a fraction of its size, count as inside, because a frustum fitted to a
# surface touches it. Bounds of triangles are widened by twice this value.
_BORDER, _MARGIN = 1e-6, 2e-6
# Triangles are not cut to strips if a corner is this close to the light's plane, as a fraction of its distance from the
# light, or outside of the view by this many views.
_BESIDE, _ASIDE = 1e-9, 1e3
# The numbers of pairs of triangle and strip, and of triangle and block, that are processed together.
_ITEMS, _PAIRS = 8192, 2048


class Shadows(NamedTuple):
    """The space that each triangle hides from the light. There, `edges`, three planes through the light, are not
    negative, and `face`, the triangle's plane, is negative but not below `-reach` (f,). A plane has four coefficients,
    (f,) each. `opposite` is the height of the third corner above each edge's plane, (f,) each."""

    edges: list[list[Float[Array, " f"]]]
    face: list[Float[Array, " f"]]
    reach: Float[Array, " f"]
    opposite: list[Float[Array, " f"]]


class Outlines(NamedTuple):
    """Triangles in a light's views, (t,) = (views · f,) each. Each coordinate of each corner is a separate array.

    - `x`, `y`: corners in the window, from 0 to 1 over all views, three (t,) each.
    - `left`, `right`, `low`, `high`: bounds within the view, empty for triangles that hide nothing.
    - `cut`: whether the corners may be used.
    """

    x: list[Float[Array, " t"]]
    y: list[Float[Array, " t"]]
    left: Float[Array, " t"]
    right: Float[Array, " t"]
    low: Float[Array, " t"]
    high: Float[Array, " t"]
    cut: Bool[Array, " t"]


def hidden_points(
    mesh: Mesh,
    casts: Bool[Array, " f"],
    light: AbstractLight,
    points: Float[Array, "n 3"],
    face: Int[Array, " n"],
) -> Bool[Array, " n"]:
    """Which points on a mesh do not see the light's centre, (n,).

    **Arguments:**

    - `casts`: (f,), the faces of the mesh that hide the light.
    - `points`: (n, 3), world units, at any precision. Each point is moved into its face.
    - `face`: (n,), the face of `mesh` that each point is on, which does not hide the point; -1 for points that do not
      count.

    Points that `seen_points` leaves out are not hidden. The test is in double precision, without derivatives.
    """
    given = lax.stop_gradient((mesh.vertices, mesh.faces, casts, light, *_views_of(light, points), points, face))
    alpha_test = lax.stop_gradient(mesh.alpha_test)
    with jax.enable_x64(True):
        return _hidden_points(*given, alpha_test)


def seen_points(
    mesh: Mesh, light: AbstractLight, points: Float[Array, "n 3"], face: Int[Array, " n"]
) -> Bool[Array, " n"]:
    """Which points on a mesh are in one of the light's views and in front of the light, (n,). Near and far distances
    are ignored. Arguments are as for `hidden_points`."""
    given = lax.stop_gradient((mesh.vertices, mesh.faces, light, *_views_of(light, points), points, face))
    with jax.enable_x64(True):
        return _seen_points(*given)


@eqx.filter_jit
def _views_of(light: AbstractLight, points: Array) -> tuple[View, Array | None]:
    """The light's views, and which of them sees each of `points`, at the precision of `points`."""
    return light.view(), light.layer(points)


@eqx.filter_jit
def _seen_points(
    vertices: Array,
    faces: Array,
    light: AbstractLight,
    view: View,
    layer: Array | None,
    points: Array,
    face: Array,
) -> Array:
    vertices, light, view, points = in_float64((vertices, light, view, points))
    own = take(faces, jnp.maximum(face, 0))
    points = _on_faces(points, [take(vertices, own[:, k]) for k in range(3)])
    return _window(_along_rays(view, light), points, layer)[2] & (face >= 0)


@eqx.filter_jit
def _hidden_points(
    vertices: Array,
    faces: Array,
    casts: Array,
    light: AbstractLight,
    view: View,
    layer: Array | None,
    points: Array,
    face: Array,
    textures: Textures | None,
) -> Array:
    vertices, light, view, points = in_float64((vertices, light, view, points))
    view = _along_rays(view, light)
    # Many faces of padded meshes are points.
    casts = casts & (faces[:, 0] != faces[:, 1])
    # Without the barriers, XLA computes these again for every gather.
    corners = lax.optimization_barrier([take(vertices, faces[:, k]) for k in range(3)])
    low = functools.reduce(jnp.minimum, [jnp.min(corner, axis=0) for corner in corners])
    high = functools.reduce(jnp.maximum, [jnp.max(corner, axis=0) for corner in corners])
    centre, tiny = (low + high) / 2, _TINY * jnp.max(high - low) / 2
    own = jnp.maximum(face, 0)
    points = lax.optimization_barrier(_on_faces(points, [take(at, own) for at in corners]))
    x, y, seen = _window(view, points, layer)
    x, y, seen = lax.optimization_barrier((x, y, seen & (face >= 0)))
    strips = in_strips(x, y, seen)
    outlines = lax.optimization_barrier(_outlines(view, vertices, faces, casts))
    shadows = lax.optimization_barrier(_shadows(corners, light, centre))
    return _test(strips, outlines, shadows, points - centre, jnp.where(seen, own, -1), tiny, textures)


def _along_rays(view: View, light: AbstractLight) -> View:
    """A view that does not change if it is rounded to single precision. Each ray of the light is a point in it, also in
    double precision, so triangles are at the positions of their shadows."""
    towards = light.towards(jnp.zeros((1, 3), jnp.float64))[0]
    turn, shift = view.world_to_eye[..., :3, :3], view.world_to_eye[..., :3, 3]
    along = jnp.sum(turn * towards, axis=-1)
    if light.is_directional:
        across = turn[..., :2, :] - along[..., :2, None] * towards / dot(towards, towards)
        turn = jnp.concatenate([across, turn[..., 2:, :]], axis=-2)
    else:
        shift = -along
    matrix = view.world_to_eye.at[..., :3, :3].set(turn).at[..., :3, 3].set(shift)
    return eqx.tree_at(lambda view: view.world_to_eye, view, matrix)


def _on_faces(points: Float[Array, "n 3"], corners: list[Float[Array, "n 3"]]) -> Float[Array, "n 3"]:
    """The point with the barycentric coordinates of `points` in each triangle with `corners`, three (n, 3)."""
    a, b, c = corners
    ab, ac, ap = b - a, c - a, points - a
    bb, bc, cc, pb, pc = dot(ab, ab), dot(ab, ac), dot(ac, ac), dot(ap, ab), dot(ap, ac)
    determinant = bb * cc - bc * bc
    second = jnp.maximum(safe_divide(cc * pb - bc * pc, determinant), 0)
    third = jnp.maximum(safe_divide(bb * pc - bc * pb, determinant), 0)
    total = jnp.maximum(second + third, 1)
    return a + (second / total)[:, None] * ab + (third / total)[:, None] * ac


def _window(view: View, points: Float[Array, "n 3"], layer: Int[Array, " n"] | None) -> tuple[Array, Array, Array]:
    """The positions of points in the window of all views, which are stacked vertically, and whether the points are in
    their view and in front of the light."""
    if layer is None:
        clip = view.clip(points)
    else:
        # Several times as fast as gathering a matrix for each point.
        def of_view(number: Array, clip: Array) -> Array:
            return jnp.where((layer == number)[:, None], view.facing(number).clip(points), clip)

        clip = lax.fori_loop(0, _views(view), of_view, jnp.zeros((points.shape[0], 4), points.dtype))
    w = clip[:, 3]
    in_front = w > (1e-3 * view.near if view.is_perspective else 0)
    x, y = (jnp.where(in_front, clip[:, k] / jnp.where(in_front, w, 1), 2) * 0.5 + 0.5 for k in range(2))
    inside = in_front & (jnp.maximum(jnp.abs(x - 0.5), jnp.abs(y - 0.5)) <= 0.5 + _BORDER)
    x, y = jnp.clip(x, 0, 1), jnp.clip(y, 0, 1)
    return x, (y if layer is None else (layer + y) / _views(view)), inside


def _views(view: View) -> int:
    matrix = view.matrix
    return 1 if matrix.ndim == 2 else matrix.shape[0]


def _outlines(view: View, vertices: Array, faces: Array, casts: Bool[Array, " f"]) -> Outlines:
    """All triangles in each view."""
    views = _views(view)
    clip = lax.optimization_barrier(view.clip_vertices(vertices).reshape(views, -1, 4))
    outlines = lax.map(lambda given: _outlines_of(given[0], given[1], views, faces, casts), (clip, jnp.arange(views)))
    return jax.tree.map(lambda of_view: of_view.reshape(-1), outlines)


def _outlines_of(clip: Array, number: Array, views: int, faces: Array, casts: Bool[Array, " f"]) -> Outlines:
    """The triangles in one view.

    If a triangle crosses the light's plane, its front part extends to infinity in the directions where its edges cross
    the plane.
    """
    at_corners = [[take(clip[:, k], faces[:, corner]) for corner in range(3)] for k in (0, 1, 3)]
    xs, ys, ws = lax.optimization_barrier(at_corners)
    reach = [jnp.abs(x) + jnp.abs(y) + jnp.abs(w) for x, y, w in zip(xs, ys, ws, strict=True)]
    beside = sum(jnp.abs(w) <= _BESIDE * r for w, r in zip(ws, reach, strict=True)) > 0
    ahead = [w > 0 for w in ws]
    in_window = lambda at: [jnp.where(a, c / jnp.where(a, w, 1), 0) for a, c, w in zip(ahead, at, ws, strict=True)]
    projected_x, projected_y = in_window(xs), in_window(ys)

    def bounds(projected: list[Array], at: list[Array]) -> tuple[Array, Array]:
        lows, highs = [], []
        for corner in range(3):
            other = (corner + 1) % 3
            crosses = ahead[corner] != ahead[other]
            # The point where the edge crosses the plane, times a positive factor.
            where = (at[corner] * ws[other] - at[other] * ws[corner]) * jnp.where(ahead[corner], -1, 1)
            near = jnp.abs(where) <= _BESIDE * (reach[corner] * reach[other])
            low = jnp.where(ahead[corner], projected[corner], jnp.inf)
            lows.append(jnp.where(crosses & ((where < 0) | near), -jnp.inf, low))
            high = jnp.where(ahead[corner], projected[corner], -jnp.inf)
            highs.append(jnp.where(crosses & ((where > 0) | near), jnp.inf, high))
        low, high = jnp.min(jnp.stack(lows), axis=0), jnp.max(jnp.stack(highs), axis=0)
        return jnp.where(beside, -jnp.inf, low), jnp.where(beside, jnp.inf, high)

    (left, right), (low, high) = bounds(projected_x, xs), bounds(projected_y, ys)
    far = jnp.maximum(jnp.maximum(-left, right), jnp.maximum(-low, high))
    seen = casts & (left <= 1 + _MARGIN) & (right >= -1 - _MARGIN) & (low <= 1 + _MARGIN) & (high >= -1 - _MARGIN)
    margin = _MARGIN * jnp.maximum(1, far)
    margin = jnp.where(jnp.isfinite(margin), margin, _MARGIN)
    across = lambda at: at * 0.5 + 0.5
    up = lambda at: (number + across(jnp.clip(at, -1 - _MARGIN, 1 + _MARGIN))) / views
    return Outlines(
        [across(x) for x in projected_x],
        [(number + across(y)) / views for y in projected_y],
        jnp.where(seen, across(left - margin), jnp.inf),
        jnp.where(seen, across(right + margin), -jnp.inf),
        jnp.where(seen, up(low - margin), jnp.inf),
        jnp.where(seen, up(high + margin), -jnp.inf),
        seen & ahead[0] & ahead[1] & ahead[2] & (far < _ASIDE),
    )


def _shadows(corners: list[Array], light: AbstractLight, centre: Array) -> Shadows:
    """The space that each triangle hides, with planes in coordinates relative to `centre`."""
    # A separate array for each coordinate, so that operations vectorize.
    apart = lambda points: [points[:, k] for k in range(3)]
    a, b, c = (apart(corner - centre) for corner in corners)
    to_light = [apart(light.towards(corner)) for corner in corners]
    normal = _unit(_cross(_minus(b, a), _minus(c, a)))
    height = _dot(normal, to_light[0])
    side = jnp.sign(height)

    def plane(normal: list[Array], point: list[Array]) -> list[Array]:
        normal = [side * component for component in normal]
        return [*normal, -_dot(normal, point)]

    edges = [
        plane(_unit(_cross(towards, _minus(end, start))), start)
        for towards, start, end in zip(to_light, (a, b, c), (b, c, a), strict=True)
    ]
    limit = jnp.inf if light.is_directional else jnp.abs(height) * (1 / _SHORT_OF_LIGHT - 1)
    # A triangle that the light sees edge-on hides nothing.
    reach = jnp.where(height == 0, -jnp.inf, jnp.broadcast_to(limit, height.shape))
    opposite = [_height(edge, *corner) for edge, corner in zip(edges, (c, a, b), strict=True)]
    return Shadows(edges, plane(normal, a), reach, opposite)


def _minus(a: list[Array], b: list[Array]) -> list[Array]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: list[Array], b: list[Array]) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[Array], b: list[Array]) -> list[Array]:
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]


def _unit(vector: list[Array]) -> list[Array]:
    length = jnp.sqrt(_dot(vector, vector))
    return [safe_divide(component, length) for component in vector]


def _test(
    strips: Strips,
    outlines: Outlines,
    shadows: Shadows,
    points: Float[Array, "n 3"],
    own: Int[Array, " n"],
    tiny: Float[Array, ""],
    textures: Textures | None,
) -> Bool[Array, " n"]:
    """Which points, with their `own` faces (n,), are in a triangle's shadow."""
    n, faces = points.shape[0], shadows.reach.shape[0]
    there = strips.order < n
    index = jnp.where(there, strips.order, 0)
    own = jnp.where(there, take(own, index), -1)
    places = [jnp.where(own >= 0, take(points[:, k], index), jnp.nan) for k in range(3)]
    planes = [*shadows.edges, shadows.face]
    boxes = _boxes(places, strips)
    cutouts = None if textures is None else Cutouts.of(textures)

    first, count = strips.strips_between(outlines.low, outlines.high)
    items = Items.of(count, jnp.int64)
    blocks = strips.left.shape[0]

    def of_items(state: tuple[Array, Array]) -> tuple[Array, Array]:
        """Processes a group of pairs of triangle and strip."""
        start, hidden = state
        owner, number, valid = items.chunk(start, _ITEMS)
        strip = jnp.where(valid, take(first, owner) + number.astype(jnp.int32), 0)
        face = owner % faces
        left, right = _extent(outlines, owner, take(strips.low, strip), take(strips.high, strip))
        valid = valid & _reaches([take(values, face) for values in shadows.face], boxes, strip, tiny)
        block, length = strips.blocks_between(strip, left, right)
        pairs = Items.of(jnp.where(valid, length, 0), jnp.int64)

        def of_pairs(state: tuple[Array, Array]) -> tuple[Array, Array]:
            """Tests triangles against blocks of points."""
            start, hidden = state
            which, number, exists = pairs.chunk(start, _PAIRS)
            at = jnp.where(exists, take(block, which) + number.astype(jnp.int32), 0)
            triangle = take(face, which)
            x, y, z = (take(place, at) for place in places)
            heights = [_height([take(values, triangle)[:, None] for values in plane], x, y, z) for plane in planes]
            inside = (heights[0] >= -tiny) & (heights[1] >= -tiny) & (heights[2] >= -tiny)
            behind = (heights[3] < -tiny) & (heights[3] >= -take(shadows.reach, triangle)[:, None])
            hit = inside & behind & (take(own, at) != triangle[:, None])
            if textures is not None and cutouts is not None:
                index = jnp.broadcast_to(take(textures.index, triangle)[:, None], hit.shape)
                hit = hit & cutouts.passes(index, *_coordinates(textures, shadows.opposite, triangle, heights[:3]))
            hidden = hidden.at[jnp.where(exists, at, blocks)].max(hit, mode="drop")
            return start + _PAIRS, hidden

        _, hidden = lax.while_loop(lambda state: state[0] < pairs.total, of_pairs, (jnp.int64(0), hidden))
        return start + _ITEMS, hidden

    start = jnp.zeros((blocks, BLOCK), bool)
    _, hidden = lax.while_loop(lambda state: state[0] < items.total, of_items, (jnp.int64(0), start))
    return jnp.zeros(n, bool).at[strips.order.reshape(-1)].set(hidden.reshape(-1), mode="drop")


def _coordinates(
    textures: Textures, opposite: list[Array], triangle: Int[Array, " p"], heights: list[Array]
) -> tuple[Float[Array, "p b 2"], Float[Array, "p b"] | None]:
    """The texture coordinates of the triangles' points that hide points at these heights above the edges' planes, and
    the mean alpha if corners have one.

    Along a ray from the light, the three heights change by one common factor. At the triangle, they are therefore
    proportional to the barycentric coordinates of the opposite corners, times these corners' heights.
    """
    pairs = zip(heights, opposite, strict=True)
    c, a, b = (safe_divide(height, take(whole, triangle)[:, None]) for height, whole in pairs)
    total = a + b + c
    alpha = textures.corner_alpha

    def mean(values: Array) -> Array:
        of_corners = take(values, triangle)[:, None]
        return jnp.asarray(sum(weight[..., None] * of_corners[:, :, k] for k, weight in enumerate((a, b, c))))

    uv = safe_divide(mean(textures.uv), total[..., None])
    return uv, None if alpha is None else safe_divide(mean(alpha[..., None])[..., 0], total)


def _height(plane: list[Array], x: Array, y: Array, z: Array) -> Array:
    """The height of points above planes."""
    return plane[0] * x + plane[1] * y + (plane[2] * z + plane[3])


def _boxes(places: list[Float[Array, "sb p"]], strips: Strips) -> tuple[list[Array], list[Array]]:
    """The centre and half the size of the box of each strip's points, one (s,) for each axis."""
    by_strip = [place.reshape(strips.low.shape[0], -1) for place in places]
    ends = [(jnp.nanmin(at, axis=1), jnp.nanmax(at, axis=1)) for at in by_strip]
    return [(high + low) / 2 for low, high in ends], [(high - low) / 2 for low, high in ends]


def _reaches(plane: list[Array], boxes: tuple[list[Array], list[Array]], strip: Array, tiny: Array) -> Array:
    """Whether a strip may have points behind a triangle's plane."""
    middle, half = ([take(values, strip) for values in part] for part in boxes)
    nearest = _height(plane, *middle) - sum(jnp.abs(n) * h for n, h in zip(plane[:3], half, strict=True))
    return nearest < tiny


def _extent(outlines: Outlines, owner: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """The x range of each triangle between y `low` and `high`, (n,) each."""
    xs, ys = ([take(values, owner) for values in part] for part in (outlines.x, outlines.y))
    left, right, cut = (take(values, owner) for values in (outlines.left, outlines.right, outlines.cut))
    least, most = extent(xs, ys, low - 2 * _MARGIN, high + 2 * _MARGIN)
    least, most = least - _MARGIN, most + _MARGIN
    return jnp.where(cut, jnp.maximum(left, least), left), jnp.where(cut, jnp.minimum(right, most), right)
