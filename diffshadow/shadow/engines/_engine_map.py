"""What an engine draws from a light: which faces cast, and the depths that they leave in the map."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..._arithmetic import as_array, as_float
from ..._types import HostArray, Resolution, Scalar
from ..._words import counted
from ...geometry import AbstractLight, Mesh, PointLight, Scene, Textures, View, merge, perspective
from ...raster import Surface, at_steps, rasterize_depth
from ...settings.engines import Side


class EngineMap(eqx.Module):
    """The depth that a light sees, and what an engine knows of the meshes.

    - `depth`: (h, w), window depth without bias, 1 where the light sees nothing; row 0 is the bottom row. Of a point
        light (6, h, w), the faces of a cube map in OpenGL's order and orientation. Babylon.js' maps are mirrored, see
        `map_of`.
    - `light`: the light it was drawn from.
    - `offset`: (f,), for each face of the scene's mesh, the factor of its normal bias.
    - `receives`: (f,), whether the face receives shadows.
    - `blurred`: (height, width) of the blurred map that the engine makes of this one; None if it makes none, or one of
        the same size.
    """

    depth: Float[Array, "*l h w"]
    light: AbstractLight
    offset: Float[Array, " f"] = eqx.field(converter=as_float)
    receives: Bool[Array, " f"] = eqx.field(converter=as_array)
    blurred: Resolution | None = eqx.field(static=True, default=None)

    @property
    def resolution(self) -> Resolution:
        """(height, width) in texels."""
        height, width = self.depth.shape[-2:]
        return height, width

    @property
    def view(self) -> View:
        """The projection it was drawn with."""
        return _view_of(self.light)

    def of_pixels(self, surface: Surface) -> tuple[Float[Array, "h w 1"], Bool[Array, "h w"]]:
        """The factor of the normal bias at each pixel, (h, w, 1), and whether it sees a receiver, (h, w)."""
        face = jnp.maximum(surface.face, 0)
        return self.offset[face][..., None], surface.mask & self.receives[face]


class Casters(NamedTuple):
    """The triangles that an engine draws into a map: `vertices` (v, 3) and `faces` (f, 3), all to be seen in front, and
    the textures that cut them out, if any."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    alpha_test: Textures | None = None

    @classmethod
    def of(cls, meshes: Sequence[Mesh], sides: Sequence[Side]) -> "Casters":
        """Those faces of each of `meshes` that its entry of `sides` names."""
        whole = merge(meshes).padded()
        mesh = merge(meshes)
        faces = np.asarray(mesh.faces)
        side = np.repeat(sides, [mesh.faces.shape[0] for mesh in meshes])
        # A back face becomes a front face if its corners go the other way round.
        drawn = np.concatenate([faces[side != "back"], faces[side != "front"][:, ::-1]])
        padding = np.zeros((-len(drawn) % len(whole.faces), 3), faces.dtype)
        alpha_test = mesh.alpha_test
        if alpha_test is not None:
            turned = alpha_test.for_faces(side != "front").turned()
            alpha_test = alpha_test.for_faces(side != "back").followed_by(turned).padded(len(drawn) + len(padding))
        return cls(whole.vertices, as_array(np.concatenate([drawn, padding])), alpha_test)


def each_of(values: Any, meshes: Sequence[Mesh], what: str) -> tuple[Any, ...]:
    """The value of each of `meshes`; `what` names them in errors.

    **Raises** `ValueError` unless there is one for all, or one for each.
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

    - `subpixels`: steps to a texel; the rasterizer places vertices at whole steps before it computes depth.
    - `is_mirrored`: draws what a left-handed camera sees: x runs the other way, and in a cube map the world's y does.
    - `push`: how far casters are pushed away from the light when the near and far planes clip them, in clip depth from
        -1 to 1. Depths are those without it.

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
    # In a mirror, corners go the other way round.
    faces, alpha_test = casters.faces, casters.alpha_test
    if is_mirrored:
        faces, alpha_test = faces[:, ::-1], None if alpha_test is None else alpha_test.turned()
    depth = rasterize_depth(clip, faces, resolution, cull="back", alpha_test=alpha_test)
    return _without_push(depth, push)


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
    """The six views of a cube map, each of exactly 90 degrees; `is_mirrored`: with the world's y turned over."""
    rows = jnp.asarray(CUBE) * jnp.array([1.0, 1.0, -1.0])[:, None]
    rows = rows * jnp.array([1.0, -1.0, 1.0]) if is_mirrored else rows
    moved = -jnp.sum(rows * light.position, axis=-1)
    world_to_eye = jnp.zeros((6, 4, 4)).at[:, :3, :3].set(rows).at[:, :3, 3].set(moved).at[:, 3, 3].set(1)
    sides = jnp.array([-1.0, 1.0])
    return View(world_to_eye, perspective(sides, sides, light.near, light.far), light.near, light.far, True)
