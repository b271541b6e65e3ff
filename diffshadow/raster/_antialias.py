"""Antialiased surfaces: what a camera sees on both sides of every line along which colours jump.

A `Surface` holds what pixel centres see. Its picture jumps along outlines, so that it has stairs, and no derivative by
where the outlines are. Here each pixel that such a line crosses gets the mean of its parts, whose areas are exact and
carry the derivative (`_boundaries.py`).
"""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import take
from .._checks import check_instance
from .._padding import padded_to, round_up_to_power_of_two
from .._types import ClipVertices, FaceMap, Faces, Resolution, Vec3
from ..geometry import NO_NEIGHBOUR, AbstractCamera, Edges, Mesh, MeshLike, View, as_mesh
from ..settings import maps
from ..settings.maps import Cull
from ._boundaries import Boundaries, Pieces, find_creases
from ._corners import rasterize_with_corners
from ._drawn_view import drawn_view
from ._interpolate import Points
from ._plane_crossings import crossing_faces, plane_crossings
from ._rasterize import NO_FACE
from ._sides import Around, Sides, adjoining
from ._surface import Surface, passes_at_points, surface_at_points
from ._within_pixels import points_within_pixels

# Both sides of a line are shaded so far away from it, in pixels.
_ASIDE = 0.25
# A centre less than this far inside the outline of what it sees, in pixels, has a part of its colour replaced.
_NEAR = 0.3
# Memory for fewer pieces and crossings would save no time, and compile more programs.
_LEAST = 1024, 256


class AntialiasPlan(eqx.Module):
    """What `draw_antialiased` needs inside `jax.jit`: the edges of the mesh, and sizes of arrays.

    - `edges`: the mesh's; `creases`: (n,), which of these are creases.
    - `pieces`: the number of pieces of edges within pixels for which there is memory; `crossings`: the number of pixels
        where two parts of the mesh cross, for which there is memory.
    """

    edges: Edges
    creases: Bool[Array, " n"]
    pieces: int = eqx.field(static=True)
    crossings: int = eqx.field(static=True)


class AntialiasedSurface(eqx.Module):
    """A surface, and the surfaces on both sides of all lines where its colours jump.

    - `surface`: (h + k, w): the pixels' centres, and then k rows of added points. Visibility, colours and other values
        for each of its pixels are images of that size. `resolve` turns such an image into a picture (h, w).
    - `pixel`: (n,), the pixel of each boundary, row · width + column; h · w for no pixel.
    - `area`: (n,), the fraction of the pixel's mean that moves from the left colour to the right colour. It may be
        negative.
    - `nearness`: (n,), the fraction of the centre's colour that the left colour replaces, near the outline of the
        surface that the centre sees.
    - `overflow`: whether there were more pieces than planned, so that the picture is wrong; `None` if this raises an
        error.
    """

    surface: Surface
    pixel: Int[Array, " n"]
    area: Float[Array, " n"]
    nearness: Float[Array, " n"]
    resolution: Resolution = eqx.field(static=True)
    overflow: Bool[Array, ""] | None = None

    @property
    def centres(self) -> Surface:
        """The surface at pixel centres, (h, w)."""
        return jax.tree.map(lambda values: values[: self.resolution[0]], self.surface)

    def extend(self, image: Float[Array, "h w *c"]) -> Float[Array, "H w *c"]:
        """Extends an image from pixel centres to all points of `surface`.

        Each added point takes the value of one of the nine pixels around it: the one whose surface is nearest in the
        world.
        """
        height, width = self.resolution
        pixel = jnp.tile(jnp.minimum(self.pixel, height * width - 1), 2)
        row, column = pixel // width, pixel % width
        others = lambda values: values[height:].reshape(2, -1, *values.shape[2:])[:, : self.pixel.shape[0]]
        positions = lax.stop_gradient(self.surface.position)
        point, known = others(positions).reshape(-1, 3), self.surface.mask[:height].reshape(-1)
        at_centres = positions[:height].reshape(-1, 3)

        def nearer(number: Int[Array, ""], found: tuple[Array, Array]) -> tuple[Array, Array]:
            """The nearest of the first pixels around each, and how far away it is, squared."""
            away, at = found
            beside_row = jnp.clip(row + number // 3 - 1, 0, height - 1)
            index = beside_row * width + jnp.clip(column + number % 3 - 1, 0, width - 1)
            squared = jnp.where(take(known, index), jnp.sum((take(at_centres, index) - point) ** 2, axis=-1), jnp.inf)
            return jnp.minimum(away, squared), jnp.where(squared < away, index, at)

        first = jnp.full(pixel.shape, jnp.inf, positions.dtype), pixel
        _, nearest = lax.fori_loop(0, 9, nearer, first)
        values = take(image.reshape(height * width, *image.shape[2:]), nearest)
        values = values.reshape(2, -1, *image.shape[2:])
        rest = self.surface.mask.shape[0] - height
        filled = jnp.zeros((2, rest * width // 2, *image.shape[2:]), image.dtype).at[:, : values.shape[1]].set(values)
        return jnp.concatenate([image, filled.reshape(rest, width, *image.shape[2:])])

    def with_points_within(self, camera: AbstractCamera, count: int) -> Surface:
        """`surface`, followed by so many points within each pixel (see `points_within_pixels`), which `mean_within`
        averages."""
        within = points_within_pixels(self.centres, camera, count).surface
        return jax.tree.map(lambda *parts: jnp.concatenate(parts), self.surface, within)

    def mean_within(self, values: Float[Array, "y w"], count: int) -> Float[Array, "H w"]:
        """Converts values at the points of `with_points_within` to values at all points of `surface`. The value at a
        pixel's centre is the mean over the pixel, unless the pixel has an outline or a crease."""
        height, width = self.resolution
        own, within = jnp.split(values, [values.shape[0] - count * height])
        mean = jnp.mean(within.reshape(count, height, width), axis=0)
        is_whole = jnp.ones(height * width, bool).at[self.pixel].min(self.area == 0, mode="drop")
        return own.at[:height].set(jnp.where(is_whole.reshape(height, width), mean, own[:height]))

    def resolve(self, image: Float[Array, "H w *c"]) -> Float[Array, "h w *c"]:
        """The mean over each pixel of an image with values for all points of `surface`.

        A smooth surface is seen edge-on at its outline, and its colour changes fast there. A pixel centre on such a
        surface, close to the outline, is not typical of the pixel. So the colour farther inside, on the left of the
        outline, replaces the colour of the centre.
        """
        height, width = self.resolution
        centres, others = image[:height], image[height:]
        left, right = others.reshape(2, -1, *image.shape[2:])[:, : self.area.shape[0]]
        flat = centres.reshape(height * width, *image.shape[2:])
        area, nearness = (each.reshape(-1, *[1] * (left.ndim - 1)) for each in (self.area, self.nearness))
        own = take(flat, jnp.minimum(self.pixel, height * width - 1))
        change = (right - left) * area + nearness * (left - own)
        return flat.at[self.pixel].add(change, mode="drop").reshape(centres.shape)


def plan_antialiasing(
    mesh: MeshLike, camera: AbstractCamera, *, cull: Cull = maps.ShadowMap.cull, margin: float = 1.5
) -> AntialiasPlan:
    """The plan with which `draw_antialiased` draws this mesh and view, and others with similar outlines.

    **Arguments:** `margin`: the memory, as a multiple of the memory that this mesh and view need.

    **Raises** `ValueError` under a trace.
    """
    mesh = as_mesh(mesh)
    edges, creases = _edges_of(mesh)
    seen = _Seen.of(mesh.padded(), camera, edges, creases, cull)
    return AntialiasPlan(edges, creases, *seen.sizes(margin))


def _edges_of(mesh: Mesh) -> tuple[Edges, Bool[Array, " n"]]:
    """The edges of a mesh, padded, and which of these are creases.

    **Raises** `ValueError` under a trace.
    """
    edges = Edges.of(mesh)
    creases = find_creases(mesh, edges)
    edges = edges.padded(mesh.padded().faces.shape[0])
    return edges, jnp.asarray(padded_to(creases, edges.vertices.shape[0]))


class _Seen(eqx.Module):
    """What a camera sees of a mesh, before there is memory for what its pixels have several of.

    - `view`: see `drawn_view`; `clip`: (v, 4), the vertices in it.
    - `centres`: (h, w), the faces at pixel centres; `corners`: (h + 1, w + 1), at the corners.
    - `boundaries`: all of the mesh's in this view; `crossing`: (h, w), see `crossing_faces`.
    - `counts`: (2,), how many pieces of boundaries there are, and how many pixels in which meshes cross.
    """

    view: View
    clip: ClipVertices
    centres: FaceMap
    corners: Int[Array, "H W"]
    boundaries: Boundaries
    crossing: FaceMap
    counts: Int[Array, "2"]

    @classmethod
    def of(cls, mesh: Mesh, camera: AbstractCamera, edges: Edges, creases: Bool[Array, " n"], cull: Cull) -> "_Seen":
        view = drawn_view(camera.view(), mesh)
        clip = view.clip_vertices(mesh.vertices)
        seen = rasterize_with_corners(clip, mesh.faces, camera.resolution, cull=cull, alpha_test=mesh.alpha_test)
        centres, corners = (fragments.face for fragments in seen)
        return cls(view, clip, centres, corners, *_boundaries(clip, mesh.faces, edges, creases, cull, centres, corners))

    def sizes(self, margin: float) -> tuple[int, int]:
        """For how many pieces and crossings to have memory, at least `margin` times as many as there are."""
        needed = (math.ceil(margin * int(count)) for count in np.asarray(self.counts))
        pieces, crossings = (max(round_up_to_power_of_two(n), least) for n, least in zip(needed, _LEAST, strict=True))
        return pieces, crossings


@eqx.filter_jit
def _boundaries(
    clip: ClipVertices,
    faces: Faces,
    edges: Edges,
    creases: Array,
    cull: Cull,
    centres: FaceMap,
    corners: Int[Array, "H W"],
) -> tuple[Boundaries, FaceMap, Int[Array, "2"]]:
    """The last three fields of `_Seen`."""
    height, width = centres.shape
    found = Boundaries.of(clip, faces, edges, creases, cull, (height, width))
    crossing = crossing_faces(centres, corners, clip, faces, edges.component)
    return found, crossing, jnp.stack([found.count, jnp.sum(crossing >= 0, dtype=jnp.int32)])


def draw_antialiased(
    mesh: MeshLike,
    camera: AbstractCamera,
    plan: AntialiasPlan | None = None,
    *,
    cull: Cull = maps.ShadowMap.cull,
    raises: bool = True,
) -> AntialiasedSurface:
    """The surface of `mesh` that `camera` sees at pixel centres and on both sides of outlines and creases.

    The outlines of an alpha test are not edges: they are jagged, and have no derivative.

    **Arguments:**

    - `plan`: from `plan_antialiasing`; required under a trace.
    - `cull`: as for `rasterize`.
    - `raises`: whether more pieces than planned are an error. Otherwise `overflow` says whether there are more pieces.
        If so, draw again with a larger plan.

    **Raises** `ValueError` without a plan under a trace, and a runtime error if there are more pieces than planned.

    !!! Example

        ```python
        seen = raster.draw_antialiased(scene.mesh, camera)
        seen.resolve(seen.surface.albedo).shape  # (32, 32, 3)
        ```
    """
    check_instance("the camera", camera, AbstractCamera, "a camera, such as a PinholeCamera")
    mesh = as_mesh(mesh)
    edges, creases = _edges_of(mesh) if plan is None else (plan.edges, plan.creases)
    mesh = mesh.padded()
    seen = _Seen.of(mesh, camera, edges, creases, cull)
    pieces, crossings = seen.sizes(1.0) if plan is None else (plan.pieces, plan.crossings)
    drawn, has_all_parts = _antialiased(mesh, camera.eye, seen, edges, pieces, crossings)
    overflow = (seen.counts[0] > pieces) | (seen.counts[1] > crossings) | ~has_all_parts
    if not raises:
        return dataclasses.replace(drawn, overflow=overflow)
    return eqx.error_if(
        drawn,
        overflow,
        f"the picture has memory for {pieces} pieces of outlines and creases and for {crossings} pixels in which "
        "meshes cross, and there are more; expected memory for all: pass a plan with a greater margin",
    )


@eqx.filter_jit
def _antialiased(
    mesh: Mesh, eye: Vec3, seen: _Seen, edges: Edges, most: int, most_crossings: int
) -> tuple[AntialiasedSurface, Bool[Array, ""]]:
    """The surface, with memory for so many pieces and crossings, and whether it has all parts of pieces."""
    view, clip, centres = seen.view, seen.clip, seen.centres
    height, width = centres.shape
    found = seen.boundaries.with_crossings(plane_crossings(seen.crossing, centres, clip, mesh.faces, most_crossings))
    # Which pieces there are, and what lies beside them, has no derivative.
    fixed, fixed_view, fixed_clip = lax.stop_gradient((found, view, clip))
    behind = adjoining(fixed_view, fixed.segments.depth[:, 0], (height, width))
    pieces = Pieces.of(found, (height, width), most + max(most_crossings, 1), behind)
    fixed_pieces = lax.stop_gradient(pieces)
    around = Around.of(fixed_pieces, fixed, fixed_view, fixed_clip, mesh.faces, edges, centres, seen.corners)
    sides = Sides.of(fixed_pieces, fixed, around, centres.size)
    # Both sides, in whole rows.
    count = pieces.pixel.shape[0]
    in_rows = lambda values, fill: jnp.stack(
        [jnp.pad(side, (0, -count % width), constant_values=fill).reshape(-1, width) for side in values]
    ).reshape(-1, width)
    # Within each side rather than on the line, where a shadow may begin.
    aside = _ASIDE * fixed_pieces.right
    sides_at = [(pieces.nearest + by) * (2 / np.array([width, height])) - 1 for by in (-aside, aside)]
    points = Points(*(in_rows([at[:, k] for at in sides_at], 0) for k in range(2)))
    of_sides = in_rows([sides.left, sides.right], NO_FACE)
    everywhere = jax.tree.map(
        lambda *parts: jnp.concatenate(parts), Points.centres((height, width), clip.dtype), points
    )
    surface = surface_at_points(mesh, eye, view, jnp.concatenate([centres, of_sides]), clip, everywhere)
    in_sight = sides.in_sight
    if mesh.alpha_test is not None:
        # No line is seen where the alpha test cuts out a face beside it.
        left, right = passes_at_points(mesh, of_sides, clip, points).reshape(2, -1)[:, :count]
        in_sight = in_sight & left & right
    area = jnp.where(in_sight, pieces.beyond + sides.correction, 0)
    own = take(centres.reshape(-1), jnp.minimum(pieces.pixel, height * width - 1))
    is_own = _are_neighbours(mesh.faces, own, sides.left) & (lax.stop_gradient(area) > 0)
    is_own = is_own & (take(fixed.right, pieces.segment) == NO_NEIGHBOUR)
    nearness = _nearness(fixed_pieces, is_own, (height, width))
    return AntialiasedSurface(surface, pieces.pixel, area, nearness, (height, width)), pieces.is_whole


def _are_neighbours(faces: Faces, first: Int[Array, " n"], second: Int[Array, " n"]) -> Bool[Array, " n"]:
    """Whether two faces are one, or share a vertex."""
    one, other = (take(faces, jnp.maximum(face, 0)) for face in (first, second))
    share = jnp.any(one[:, :, None] == other[:, None, :], axis=(1, 2))
    return share & (first != NO_FACE) & (second != NO_FACE)


def _nearness(pieces: Pieces, is_own: Bool[Array, " n"], resolution: Resolution) -> Float[Array, " n"]:
    """See `AntialiasedSurface`, given which pieces are silhouettes of what the centre sees.

    All pieces of a pixel together replace no more than the whole colour.
    """
    height, width = resolution
    middle = jnp.stack([pieces.pixel % width, pieces.pixel // width], axis=1) + 0.5
    distance = jnp.sqrt(jnp.sum((pieces.nearest - middle) ** 2, axis=1))
    near = jnp.where(is_own, jnp.clip(1 - distance / _NEAR, 0, 1), 0)
    total = jnp.zeros(height * width + 1, near.dtype).at[pieces.pixel].add(near)[pieces.pixel]
    return near / jnp.maximum(total, 1)
