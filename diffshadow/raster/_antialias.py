"""Antialiased surfaces: what a camera sees on both sides of every line along which colours jump.

A `Surface` holds what pixel centres see. Its picture jumps along outlines, so that it has stairs, and no derivative by
where the outlines are. Here each pixel that such a line crosses gets the mean of its parts, whose areas are exact and
carry the derivative (`_boundaries.py`).
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._checks import check_instance
from .._padding import padded_to, round_up_to_power_of_two
from .._types import ClipVertices, FaceMap, Faces, Resolution, Vec3
from ..geometry import AbstractCamera, Edges, Mesh, MeshLike, View, as_mesh
from ..settings import maps
from ..settings.maps import Cull
from ._boundaries import Boundaries, Pieces, find_creases
from ._corners import rasterize_with_corners
from ._interpolate import Points
from ._plane_crossings import mixed_pixels, plane_crossings
from ._rasterize import NO_FACE
from ._sides import Sides, adjoining
from ._surface import Surface, passes_at_points, surface_at_centres, surface_at_points


class AntialiasPlan(eqx.Module):
    """What `draw_antialiased` must know of a mesh and a view before it draws inside `jax.jit`.

    - `edges`: the mesh's; `creases`: (n,), which of these are creases.
    - `pieces`: for how many pieces of edges within pixels there is memory; `mixed`: for how many pixels that see two
        parts of the mesh, which may cross each other.
    """

    edges: Edges
    creases: Bool[Array, " n"]
    pieces: int = eqx.field(static=True)
    mixed: int = eqx.field(static=True)


class AntialiasedSurface(eqx.Module):
    """A surface, and what is seen on both sides of the lines along which its colours jump.

    - `surface`: (h + k, w): the pixels' centres, and then k rows of further points. What is computed for each of its
        pixels, such as visibility and colours, is an image of that size; `resolve` makes a picture (h, w) of it.
    - `pixel`: (n,), the pixel that each boundary is in, row · width + column; h · w for none.
    - `area`: (n,), how much of the pixel's mean it moves from its left colour to its right one. It may be negative.
    - `overflow`: whether there were more pieces than planned, so that the picture is wrong; none if that is an error.
    """

    surface: Surface
    pixel: Int[Array, " n"]
    area: Float[Array, " n"]
    resolution: Resolution = eqx.field(static=True)
    overflow: Bool[Array, ""] | None = None

    @property
    def centres(self) -> Surface:
        """The surface at pixel centres, (h, w)."""
        return jax.tree.map(lambda values: values[: self.resolution[0]], self.surface)

    def extend(self, image: Float[Array, "h w *c"]) -> Float[Array, "H w *c"]:
        """An image known at pixel centres only, at all points of `surface`.

        Each further point takes the value of that of the nine pixels around it whose surface is nearest in the world.
        """
        height, width = self.resolution
        pixel = jnp.minimum(self.pixel, height * width - 1)
        row, column = (jnp.tile(at, 2)[:, None] for at in (pixel // width, pixel % width))
        offset = np.arange(9, dtype=np.int32)
        rows, columns = jnp.clip(row + offset // 3 - 1, 0, height - 1), jnp.clip(column + offset % 3 - 1, 0, width - 1)
        others = lambda values: values[height:].reshape(2, -1, *values.shape[2:])[:, : self.pixel.shape[0]]
        point = others(self.surface.position).reshape(-1, 1, 3)
        away = jnp.sum((self.surface.position[rows, columns] - point) ** 2, axis=-1)
        nearest = jnp.argmin(jnp.where(self.surface.mask[rows, columns], away, jnp.inf), axis=1)[:, None]
        at = (jnp.take_along_axis(index, nearest, axis=1)[:, 0] for index in (rows, columns))
        values = image[tuple(at)].reshape(2, -1, *image.shape[2:])
        rest = self.surface.mask.shape[0] - height
        filled = jnp.zeros((2, rest * width // 2, *image.shape[2:]), image.dtype).at[:, : values.shape[1]].set(values)
        return jnp.concatenate([image, filled.reshape(rest, width, *image.shape[2:])])

    def resolve(self, image: Float[Array, "H w *c"]) -> Float[Array, "h w *c"]:
        """The mean over each pixel of an image with values for all points of `surface`."""
        height, width = self.resolution
        centres, others = image[:height], image[height:]
        left, right = others.reshape(2, -1, *image.shape[2:])[:, : self.area.shape[0]]
        flat = centres.reshape(height * width, *image.shape[2:])
        change = (right - left) * self.area.reshape(-1, *[1] * (left.ndim - 1))
        return flat.at[self.pixel].add(change, mode="drop").reshape(centres.shape)


def plan_antialiasing(
    mesh: MeshLike, camera: AbstractCamera, *, cull: Cull = maps.ShadowMap.cull, margin: float = 1.5
) -> AntialiasPlan:
    """The plan with which `draw_antialiased` draws this mesh and view, and others of like outlines.

    **Arguments:** `margin`: for how many times as many pieces as these there is memory, at least.

    **Raises** `ValueError` under a trace.
    """
    mesh = as_mesh(mesh)
    edges = Edges.of(mesh)
    creases = find_creases(mesh, edges)
    mesh = mesh.padded()
    edges = edges.padded(mesh.faces.shape[0])
    creases = jnp.asarray(padded_to(creases, edges.vertices.shape[0]))
    clip = camera.view().clip_vertices(mesh.vertices)
    centres, corners = rasterize_with_corners(
        clip, mesh.faces, camera.resolution, cull=cull, alpha_test=mesh.alpha_test
    )
    needed = _count(clip, mesh.faces, edges, creases, cull, centres.face, corners.face)
    return AntialiasPlan(edges, creases, *(round_up_to_power_of_two(int(margin * int(count))) for count in needed))


@eqx.filter_jit
def _count(
    clip: ClipVertices,
    faces: Faces,
    edges: Edges,
    creases: Array,
    cull: Cull,
    centres: FaceMap,
    corners: Int[Array, "H W"],
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """How many pieces of edges there are, and pixels that see two parts of the mesh."""
    height, width = centres.shape
    pieces = Boundaries.of(clip, faces, edges, creases, cull, (height, width)).count
    return pieces, jnp.sum(mixed_pixels(centres, corners, edges.component))


def draw_antialiased(
    mesh: MeshLike,
    camera: AbstractCamera,
    plan: AntialiasPlan | None = None,
    *,
    cull: Cull = maps.ShadowMap.cull,
    raises: bool = True,
) -> AntialiasedSurface:
    """The surface of `mesh` that `camera` sees at pixel centres and on both sides of outlines and creases.

    The outlines that an alpha test cuts are no edges: they have stairs, and no derivative.

    **Arguments:**

    - `plan`: from `plan_antialiasing`; required under a trace.
    - `cull`: as for `rasterize`.
    - `raises`: whether more pieces than planned are an error. Otherwise `overflow` says whether there are more: throw
        such a surface away, and draw again with a larger plan.

    **Raises** `ValueError` without a plan under a trace, and a runtime error if there are more pieces than planned.

    !!! Example

        ```python
        seen = raster.draw_antialiased(scene.mesh, camera)
        seen.resolve(seen.surface.albedo).shape  # (32, 32, 3)
        ```
    """
    check_instance("the camera", camera, AbstractCamera, "a camera, such as a PinholeCamera")
    mesh = as_mesh(mesh)
    if plan is None:
        plan = plan_antialiasing(mesh, camera, cull=cull)
    mesh = mesh.padded()
    view, resolution = camera.view(), camera.resolution
    clip = view.clip_vertices(mesh.vertices)
    centres, corners = rasterize_with_corners(clip, mesh.faces, resolution, cull=cull, alpha_test=mesh.alpha_test)
    drawn, pieces, mixed = _antialiased(mesh, camera.eye, view, centres.face, corners.face, clip, plan, cull)
    overflow = (pieces > plan.pieces) | (mixed > plan.mixed)
    if not raises:
        return dataclasses.replace(drawn, overflow=overflow)
    return eqx.error_if(
        drawn,
        overflow,
        f"the picture has memory for {plan.pieces} pieces of outlines and creases and for {plan.mixed} pixels that see "
        "two parts of the mesh, and there are more; expected memory for all: pass a plan with a greater margin",
    )


@eqx.filter_jit
def _antialiased(
    mesh: Mesh,
    eye: Vec3,
    view: View,
    centres: FaceMap,
    corners: Int[Array, "H W"],
    clip: ClipVertices,
    plan: AntialiasPlan,
    cull: Cull,
) -> tuple[AntialiasedSurface, Int[Array, ""], Int[Array, ""]]:
    height, width = centres.shape
    edges = Boundaries.of(clip, mesh.faces, plan.edges, plan.creases, cull, (height, width))
    component = plan.edges.component
    mixed = mixed_pixels(centres, corners, component)
    found = edges.with_crossings(plane_crossings(mixed, centres, corners, clip, mesh.faces, component, plan.mixed))
    behind = lax.stop_gradient(adjoining(view, found.segments.depth[:, 0], (height, width)))
    pieces = Pieces.of(found, (height, width), plan.pieces + max(plan.mixed, 1), behind)
    sides = lax.stop_gradient(Sides.of(pieces, found, view, clip, mesh.faces, plan.edges, centres, corners))
    # Both sides, in whole rows.
    count = pieces.pixel.shape[0]
    in_rows = lambda values, fill: jnp.stack(
        [jnp.pad(side, (0, -count % width), constant_values=fill).reshape(-1, width) for side in values]
    ).reshape(-1, width)
    at = pieces.nearest * (2 / np.array([width, height])) - 1
    points = Points(*(in_rows([at[:, k]] * 2, 0) for k in range(2)))
    of_sides = in_rows([sides.left, sides.right], NO_FACE)
    beside = surface_at_points(mesh, eye, view, of_sides, clip, points)
    surface = jax.tree.map(
        lambda *parts: jnp.concatenate(parts), surface_at_centres(mesh, eye, view, centres, clip), beside
    )
    in_sight = sides.in_sight
    if mesh.alpha_test is not None:
        # No line is seen where the alpha test cuts out a face beside it.
        left, right = passes_at_points(mesh, of_sides, clip, points).reshape(2, -1)[:, :count]
        in_sight = in_sight & left & right
    area = jnp.where(in_sight, pieces.beyond + sides.correction, 0)
    return AntialiasedSurface(surface, pieces.pixel, area, (height, width)), edges.count, jnp.sum(mixed)
