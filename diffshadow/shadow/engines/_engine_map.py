"""An engine's map for a light: the casting faces, and the depths in the map."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..._arithmetic import as_array, as_float, concrete, normalize, safe_divide, safe_norm
from ..._types import HostArray, Resolution, Scalar
from ..._words import counted
from ...geometry import AbstractLight, Mesh, PointLight, Scene, Textures, View, merge, perspective
from ...raster import SUBPIXELS, Surface, at_steps, barycentrics, interpolate, rasterize, rasterize_depth
from ...settings.engines import Side

# The smallest step of depths from 1/2 to 1.
_STEP = 2.0**-24


class EngineMap(eqx.Module):
    """The depth that a light sees, and the properties of meshes that an engine's shader reads.

    - `depth`: (h, w), window depth without bias, 1 where the light sees nothing; row 0 is the bottom row. For a point
        light (6, h, w), the faces of a cube map in OpenGL's order and orientation. Babylon.js' maps are mirrored, see
        `map_of`.
    - `light`: the light it was drawn from.
    - `offset`: (f,), the factor of the normal bias for each face of the scene's mesh.
    - `receives`: (f,), whether the face receives shadows.
    - `blurred`: (height, width) of the blurred map that the engine makes from this map; `None` if the engine makes no
        blurred map, or one of the same size.
    - `slope`: for engines that draw casters with a polygon offset: the change of window depth from texel to texel, the
      larger of rows and columns, with the shape of `depth`. Otherwise `None`.
    - `drawn_with`: the number of slopes that `depth` already includes.
    - `corners`: for engines whose receivers move at their vertices. Otherwise `None`.
    - `unit`: the unit of `depth`: window depth; the distance to a point light divided by its far; or reversed depth,
        from 1 at near to 0 at far, and 0 where the light sees nothing.
    """

    depth: Float[Array, "*l h w"]
    light: AbstractLight
    offset: Float[Array, " f"] = eqx.field(converter=as_float)
    receives: Bool[Array, " f"] = eqx.field(converter=as_array)
    blurred: Resolution | None = eqx.field(static=True, default=None)
    slope: Float[Array, "*l h w"] | None = None
    drawn_with: Scalar | None = None
    corners: "Corners | None" = None
    unit: Literal["window", "distance", "reversed"] = eqx.field(static=True, default="window")

    @property
    def resolution(self) -> Resolution:
        """(height, width) in texels."""
        height, width = self.depth.shape[-2:]
        return height, width

    @property
    def view(self) -> View:
        """The projection it was drawn with."""
        return _view_of(self.light)

    @property
    def distances(self) -> tuple[Float[Array, "*l h w"], Scalar, Scalar]:
        """Distances along the axis of the light's view, in world units: the distances of the depths, of the nearest
        near plane, and of the farthest far plane. If the map of a point light stores distances, the first entry has
        these distances."""
        view = self.view
        near, far = (jnp.expand_dims(each, (-2, -1)) if jnp.ndim(each) else each for each in (view.near, view.far))
        if self.unit == "distance":
            distance = self.depth * far
        elif self.unit == "reversed" and view.is_perspective:
            distance = near / jnp.where(self.is_drawn, self.depth, 1)
        else:
            depth = 1 - self.depth if self.unit == "reversed" else self.depth
            distance = dataclasses.replace(view, near=near, far=far).eye_depth(depth)
        least, most = jnp.min(view.near), jnp.max(view.far)
        # The far plane may be at infinity.
        return distance, least, jnp.minimum(most, jnp.max(jnp.where(self.is_drawn, distance, least)))

    @property
    def is_drawn(self) -> Bool[Array, "*l h w"]:
        """Which texels see something."""
        return self.depth > 0 if self.unit == "reversed" else self.depth < 1

    def sloped(self, count: Scalar) -> Float[Array, "*l h w"]:
        """Depth with `count` slopes added, where `count` is the factor of a polygon offset. If `drawn_with` is the
        same, the result is the drawn depth to the bit."""
        if self.slope is None or self.drawn_with is None:
            return self.depth
        moved = self.depth + (count - self.drawn_with) * self.slope
        return jnp.where(self.depth < 1, jnp.clip(moved, 0, 1), 1)

    def of_pixels(self, surface: Surface) -> tuple[Float[Array, "h w 1"], Bool[Array, "h w"]]:
        """The factor of the normal bias at each pixel, (h, w, 1), and whether it sees a receiver, (h, w)."""
        face = jnp.maximum(surface.face, 0)
        return self.offset[face][..., None], surface.mask & self.receives[face]


class Corners(eqx.Module):
    """The corners of each face of a scene's mesh: their `positions` and unit `normals`, (f, 3, 3)."""

    positions: Float[Array, "f 3 3"]
    normals: Float[Array, "f 3 3"]

    @classmethod
    def of(cls, mesh: Mesh) -> "Corners":
        return cls(as_float(mesh.vertices)[mesh.faces], normalize(as_float(mesh.corner_normals)))

    def interpolated(self, values: Float[Array, "f 3 c"], surface: Surface) -> Float[Array, "h w c"]:
        """`values` of the corners, interpolated at the point that each pixel sees."""
        face = jnp.maximum(surface.face, 0)
        a, b, c = (self.positions[face, k] - surface.position for k in range(3))
        # The ratios of the areas opposite to the corners, with their signs in the face's plane.
        areas = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], axis=-2)
        normal = jnp.sum(areas, axis=-2)
        weights = jnp.sum(areas * normal[..., None, :], axis=-1)
        weights = safe_divide(weights, jnp.sum(weights, axis=-1, keepdims=True), 1 / 3)
        return jnp.sum(weights[..., None] * values[face], axis=-2)


class Casters(NamedTuple):
    """The triangles that an engine draws into a map: `vertices` (v, 3) and `faces` (f, 3), all with their front towards
    the light, and the textures that cut them out, if there are any."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    alpha_test: Textures | None = None

    @classmethod
    def of(cls, every: Sequence[Mesh], casting: Sequence[Side | None]) -> "Casters":
        """The casting faces of each mesh by its entry in `casting`. A mesh that does not cast has none."""
        chosen = [(mesh, side) for mesh, side in zip(every, casting, strict=True) if side is not None]
        meshes, sides = zip(*chosen, strict=True)
        whole = merge(meshes).padded()
        mesh = merge(meshes)
        faces = np.asarray(mesh.faces)
        side = np.repeat(sides, [mesh.faces.shape[0] for mesh in meshes])
        # A back face becomes a front face if its corners are reversed.
        drawn = np.concatenate([faces[side != "back"], faces[side != "front"][:, ::-1]])
        padding = np.zeros((-len(drawn) % len(whole.faces), 3), faces.dtype)
        alpha_test = mesh.alpha_test
        if alpha_test is not None:
            turned = alpha_test.for_faces(side != "front").turned()
            alpha_test = alpha_test.for_faces(side != "back").followed_by(turned).padded(len(drawn) + len(padding))
        return cls(whole.vertices, as_array(np.concatenate([drawn, padding])), alpha_test)


def each_of(values: Any, meshes: Sequence[Mesh], what: str) -> tuple[Any, ...]:
    """The value of each of `meshes`; `what` names them in errors.

    **Raises** `ValueError` unless there is one value for all meshes, or one for each.
    """
    if not isinstance(values, tuple):
        return (values,) * len(meshes)
    if len(values) != len(meshes):
        raise ValueError(
            f"{what} has {counted(len(values), 'entry')}, and the scene has {counted(len(meshes), 'mesh')}; "
            "expected one for all, or one each"
        )
    return values


def per_face(values: Sequence[float | bool], scene: Scene) -> HostArray:
    """`values` of the scene's meshes, repeated for each of their faces."""
    return np.repeat(values, [mesh.faces.shape[0] for mesh in scene.meshes])


def map_of(
    casters: Casters,
    light: AbstractLight,
    resolution: Resolution,
    subpixels: int,
    is_mirrored: bool = False,
    push: Scalar | float = 0.0,
) -> Float[Array, "*l h w"]:
    """The depth that `light` sees.

    **Arguments:**

    - `subpixels`: steps per texel. The rasterizer places vertices at whole steps before it computes depth.
    - `is_mirrored`: draws the view of a left-handed camera. The map is mirrored along x, and a cube map along the
      world's y.
    - `push`: the shift of casters away from the light for clipping at the near and far planes, in clip depth from -1 to
      1. Stored depths do not include it.

    **Raises** `ValueError` for a point light's map that is not square.
    """
    if isinstance(light, PointLight) and resolution[0] != resolution[1]:
        raise ValueError(
            f"the map of the point light has {resolution} texels, (height, width); expected a square one, for the "
            "faces of a cube: make them equal"
        )
    view = cube_view(light, is_mirrored) if isinstance(light, PointLight) else light.view()
    flip = is_mirrored and not isinstance(light, PointLight)
    push = as_float(push)
    clip = _snapped(view, casters.vertices, resolution, subpixels, flip, push)
    # In a mirror image, corners are reversed.
    faces, alpha_test = casters.faces, casters.alpha_test
    if is_mirrored:
        faces, alpha_test = faces[:, ::-1], None if alpha_test is None else alpha_test.turned()
    depth = rasterize_depth(clip, faces, resolution, cull="back", alpha_test=alpha_test)
    return _without_push(depth, push)


class SlopedMap(NamedTuple):
    """The depth that a light sees, with a polygon offset, and the slopes; both as in `EngineMap`."""

    depth: Float[Array, "*l h w"]
    slope: Float[Array, "*l h w"]


def sloped_map_of(
    casters: Casters,
    clip: Float[Array, "*l v 4"],
    resolution: Resolution,
    subpixels: int,
    factor: Scalar,
    units: Scalar,
) -> SlopedMap:
    """The depth of `casters` whose vertices have `clip` coordinates, drawn with a polygon offset of `factor` slopes and
    `units` smallest steps of depth. Other arguments are as for `map_of`."""
    clip = at_steps(clip, resolution, subpixels)
    offset = (concrete(factor), concrete(units))
    drawn = rasterize(
        clip, casters.faces, resolution, cull="back", polygon_offset=offset, alpha_test=casters.alpha_test
    )
    return SlopedMap(*_on_planes(clip, casters.faces, drawn.face, drawn.depth, resolution, factor, units))


@eqx.filter_jit
def _on_planes(
    clip: Float[Array, "*l v 4"],
    faces: Int[Array, "f 3"],
    seen: Int[Array, "*l h w"],
    drawn: Float[Array, "*l h w"],
    resolution: Resolution,
    factor: Scalar,
    units: Scalar,
) -> tuple[Float[Array, "*l h w"], Float[Array, "*l h w"]]:
    """The depth of the face that each texel sees, and its slope: the larger of its changes along a row and along a
    column.

    Uses the order of operations of Chromium's software rasterizer. Its last bits matter where a light's near plane is
    so close that depths are nearly 1. Faces that reach behind the light keep the `drawn` depth.
    """
    height, width = resolution

    def one(view: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        clip, seen, drawn = view
        w = clip[:, 3]
        per = 1 / jnp.where(w > 0, w, 1)
        x, y = ((rounded(clip[:, k] * per) + 1) * (size / 2) for k, size in ((0, width), (1, height)))
        z = rounded(rounded(clip[:, 2] * per) * 0.5) + 0.5
        corners = faces[jnp.maximum(seen, 0)]
        (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = ([each[corners[..., k]] for k in range(3)] for each in (x, y, z))
        x1, x2, y1, y2, z1, z2 = x1 - x0, x2 - x0, y1 - y0, y2 - y0, z1 - z0, z2 - z0
        inverse = safe_divide(jnp.ones_like(x1), rounded(x1 * y2) - rounded(x2 * y1))
        a = inverse * (rounded(y2 * z1) - rounded(y1 * z2))
        b = inverse * (rounded(x1 * z2) - rounded(x2 * z1))
        is_ahead = (w[corners] > 0).all(axis=-1)
        slope = jnp.where(is_ahead, jnp.maximum(jnp.abs(a), jnp.abs(b)), _steepness(clip[corners], resolution))
        up = jnp.arange(height, dtype=x.dtype)[:, None] + 0.5 - y0
        across = jnp.arange(width, dtype=x.dtype) + 0.5 - x0
        offset = rounded(slope * factor) + units * _STEP
        depth = ((z0 + rounded(up * b)) + rounded(across * a)) + offset
        depth = jnp.where(is_ahead, jnp.clip(depth, 0, 1), drawn)
        return jnp.where(seen >= 0, depth, 1), jnp.where(seen >= 0, slope, 0)

    views = (clip, seen, drawn)
    return lax.map(one, views) if seen.ndim > 2 else one(views)


def reversed_map_of(
    casters: Casters, clip: Float[Array, "*l v 4"], resolution: Resolution, subpixels: int, is_flattened: bool
) -> Float[Array, "*l h w"]:
    """The reversed depth that a light sees: from 1 at near to 0 at far, and 0 where it sees nothing.

    **Arguments:**

    - `clip`: the vertices' clip coordinates, with depth over w reversed.
    - `is_flattened`: whether, under a directional light, surfaces in front of the near plane have depth 1; otherwise
        they are clipped.
    """
    clip = clip if subpixels == SUBPIXELS else at_steps(clip, resolution, subpixels)
    forward = _forward(clip, jnp.asarray(is_flattened))
    seen = rasterize(forward, casters.faces, resolution, cull="back", alpha_test=casters.alpha_test).face
    return _reversed_on_faces(clip, casters.faces, seen)


@eqx.filter_jit
def _forward(clip: Float[Array, "*l v 4"], is_flattened: Bool[Array, ""]) -> Float[Array, "*l v 4"]:
    """OpenGL's clip coordinates, from clip coordinates with reversed depth. In a parallel view, with space for all
    geometry that `is_flattened`."""
    z, w = clip[..., 2], clip[..., 3]
    nearest = jnp.where(is_flattened, jnp.maximum(jnp.max(z, axis=-1, keepdims=True), 1), 1)
    return clip.at[..., 2].set(jnp.where(is_flattened, 1 - 2 * z / nearest, w - 2 * z))


@eqx.filter_jit
def _reversed_on_faces(
    clip: Float[Array, "*l v 4"], faces: Int[Array, "f 3"], seen: Int[Array, "*l h w"]
) -> Float[Array, "*l h w"]:
    """The reversed depth of the face that each texel sees."""

    def one(view: tuple[Array, Array]) -> Array:
        clip, seen = view
        at = barycentrics(seen, clip, faces)
        z, w = jnp.moveaxis(interpolate(at, clip[:, 2:], faces), -1, 0)
        return jnp.where(at.mask, jnp.clip(safe_divide(z, w), 0, 1), 0)

    return lax.map(one, (clip, seen)) if seen.ndim > 2 else one((clip, seen))


def _steepness(corners: Float[Array, "h w 3 4"], resolution: Resolution) -> Float[Array, "h w"]:
    """The slope of triangles in clip space, which may reach behind the eye: z = a x + b y + c w at all corners."""
    height, width = resolution
    one, two, three = (corners[..., k, :][..., jnp.array([0, 1, 3])] for k in range(3))
    across = jnp.cross(two, three), jnp.cross(three, one), jnp.cross(one, two)
    determinant = jnp.sum(one * across[0], axis=-1)
    plane = corners[..., 0, 2:3] * across[0] + corners[..., 1, 2:3] * across[1] + corners[..., 2, 2:3] * across[2]
    a, b = (jnp.abs(safe_divide(plane[..., k], determinant)) for k in (0, 1))
    return jnp.maximum(a / width, b / height)


def distance_map_of(
    casters: Casters, light: PointLight, resolution: Resolution, subpixels: int
) -> Float[Array, "6 n n"]:
    """The distance from a point light divided by its far distance, as a shader writes it for each texel. It is at most
    1, and 1 where a texel sees nothing. Arguments are as for `map_of`."""
    clip = _snapped(cube_view(light), casters.vertices, resolution, subpixels, False, as_float(0.0))
    seen = rasterize(clip, casters.faces, resolution, cull="back", alpha_test=casters.alpha_test).face
    return _distances_of(clip, seen, casters.vertices, casters.faces, light)


@eqx.filter_jit
def _distances_of(
    clip: Float[Array, "6 v 4"],
    seen: Int[Array, "6 n n"],
    vertices: Float[Array, "v 3"],
    faces: Int[Array, "f 3"],
    light: PointLight,
) -> Float[Array, "6 n n"]:
    def one(view: tuple[Array, Array]) -> Array:
        clip, seen = view
        at = barycentrics(seen, clip, faces)
        distance = safe_norm(interpolate(at, vertices, faces) - light.position)
        return jnp.where(at.mask, distance / light.far, 1)

    return lax.map(one, (clip, seen))


@eqx.filter_jit
def _without_push(depth: Float[Array, "*l h w"], push: Scalar) -> Float[Array, "*l h w"]:
    return jnp.where(depth < 1, depth - push / 2, 1)


@eqx.filter_jit
def _snapped(
    view: View, vertices: Float[Array, "v 3"], resolution: Resolution, subpixels: int, flip: bool, push: Scalar
) -> Float[Array, "*l v 4"]:
    clip = view.clip_vertices(vertices)
    clip = clip.at[..., 2].add(push * clip[..., 3])
    clip = clip * jnp.array([-1.0, 1.0, 1.0, 1.0]) if flip else clip
    return at_steps(clip, resolution, subpixels)


def _view_of(light: AbstractLight) -> View:
    return cube_view(light) if isinstance(light, PointLight) else light.view()


def rounded(product: Array) -> Array:
    """`product`, rounded before anything is added to it. Compilers do not fuse a maximum into a multiply-add."""
    return jnp.maximum(product, -jnp.finfo(product.dtype).max)


# For each face of a cube map, the directions of s, t and the view (OpenGL 4.6, table 8.19).
CUBE = np.array(
    [
        [(0, 0, -1), (0, -1, 0), (1, 0, 0)],
        [(0, 0, 1), (0, -1, 0), (-1, 0, 0)],
        [(1, 0, 0), (0, 0, 1), (0, 1, 0)],
        [(1, 0, 0), (0, 0, -1), (0, -1, 0)],
        [(1, 0, 0), (0, -1, 0), (0, 0, 1)],
        [(-1, 0, 0), (0, -1, 0), (0, 0, -1)],
    ],
    np.float32,
)


@eqx.filter_jit
def cube_view(light: PointLight, is_mirrored: bool = False) -> View:
    """The six views of a cube map, each of exactly 90 degrees. `is_mirrored`: whether the world's y is mirrored."""
    rows = jnp.asarray(CUBE) * jnp.array([1.0, 1.0, -1.0])[:, None]
    rows = rows * jnp.array([1.0, -1.0, 1.0]) if is_mirrored else rows
    moved = -jnp.sum(rows * light.position, axis=-1)
    world_to_eye = jnp.zeros((6, 4, 4)).at[:, :3, :3].set(rows).at[:, :3, 3].set(moved).at[:, 3, 3].set(1)
    sides = jnp.array([-1.0, 1.0])
    return View(world_to_eye, perspective(sides, sides, light.near, light.far), light.near, light.far, True)
