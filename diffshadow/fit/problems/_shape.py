"""Fits of all vertices of a mesh to images of its shadows."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from ..._arithmetic import as_array, as_float
from ..._padding import round_up_to_power_of_two
from ..._types import Faces, HostArray, Resolution, Scalar, Vertices, Visibility
from ...geometry import AbstractLight, Edges, LightPose, Mesh, as_mesh, share_vertices
from ...raster import Surface
from ...reference import occluded
from ...shadow import Bilinear, ConstantBias, MapSettings, ShadowMapping, SingleMap
from ._aligned import Receivers
from ._blur import blurred
from ._pose import cone_fraction

# The maximum distance between a mirrored vertex and its partner, as a fraction of the mesh's longest side.
_SAME_PLACE = 1e-5
# The maximum number of texel sides that silhouettes cross, as a multiple of the map's height and width. Only tangled
# meshes exceed it.
_CROSSINGS_PER_SIDE = 8


class ShapeView(eqx.Module):
    """A shadow of a shape: the light, the surface that receives the shadow, and the desired image there.

    - `light`: its shadow map must contain the shape during the whole fit, because its frustum does not move.
    - `moves`: whether the light's position and direction are fitted too. Some of the views' lights should be fixed. A
      shape and all of its lights can be rotated and stretched together without a change of the shadows.
    - `surface`: (h, w), the receiver. It does not move, and casts no shadow itself.
    - `reference`: (h, w), visibility in [0, 1]: 1 lit, 0 shadowed.
    - `weight`: (h, w), the weight of each pixel, 0 or more.
    """

    light: AbstractLight
    surface: Surface
    reference: Visibility
    weight: Float[Array, "h w"]
    moves: Bool[Array, ""]

    def __init__(
        self, light: AbstractLight, surface: Surface, reference: Any, weight: Any = None, *, moves: Any = False
    ):
        """**Arguments:** `weight`: by default 1 for pixels with a surface. Other pixels never count.

        **Raises** `ValueError` for a reference or a weight that is not finite or has another size than the surface; for
        a reference without a shadow in the pixels that count; and if no pixel counts.
        """
        mask = np.asarray(surface.mask)
        image = np.asarray(reference, float)
        own = np.ones(mask.shape) if weight is None else np.asarray(weight, float)
        for name, given in (("reference", image), ("weight", own)):
            if given.shape != mask.shape:
                raise ValueError(
                    f"the view's {name} has shape {given.shape}, and its surface {mask.shape}; expected the same "
                    "height and width: scale the image, or draw the surface with its resolution"
                )
            if not np.isfinite(given).all() or given.min() < 0:
                raise ValueError(f"the view's {name} has negative or infinite pixels, or NaN; expected 0 or more")
        own = np.where(mask, own, 0)
        if not own.any():
            raise ValueError("no pixel of the view counts; expected a surface in sight, and a weight above 0 there")
        if image.max() > 1:
            raise ValueError(f"the view's reference is {image.max():.4g} at a pixel; expected visibility, at most 1")
        if not (image[own > 0] < 0.5).any():
            raise ValueError(
                "the view's reference is lit wherever pixels count; expected a shadow, 0, on a lit ground, 1: check "
                "the image, or whether it is inverted"
            )
        self.light, self.surface = light, surface
        self.reference, self.weight = as_float(image), as_float(own)
        if np.asarray(moves) and not jax.tree.leaves(light.pose()):
            raise ValueError(
                f"moves is true for a {type(light).__name__}, whose pose cannot be fitted; expected a directional, "
                "spot or point light: leave moves out, or change the light"
            )
        self.moves = as_array(np.asarray(moves))


class ShapeProblem(eqx.Module):
    """A mesh whose vertices are fitted to bring its shadows close to several images.

    - `mesh`: the start: all casters, closed or open. Vertices at the same position must be merged into one.
    - `views`: its shadows.
    - `free`: (v,), whether each vertex moves; by default all. Fixed vertices may be a pinned base, or other casters.
    - `symmetry`: (a, b, c, d), a plane a x + b y + c z = d. The shape remains symmetric across this plane. The start
      must be symmetric too.
    - `technique`: how shadows are drawn. Its map has silhouettes, which give vertices their derivatives. By default, an
      image's pixel is the mean over one texel of a map with the first reference's size.

    **Raises** `ValueError` if there is no view, if vertices have the same position, if no vertex is free, if the mesh
    is not symmetric, or for a technique whose layout is not a single map.
    """

    mesh: Mesh
    views: tuple[ShapeView, ...]
    free: Bool[Array, " v"]
    technique: ShadowMapping
    symmetry: tuple[float, ...] | None = eqx.field(static=True, default=None)

    def __init__(
        self,
        mesh: Any,
        views: Sequence[ShapeView],
        *,
        free: Any = None,
        symmetry: Sequence[float | int] | None = None,
        technique: ShadowMapping | None = None,
    ):
        self.mesh, self.views = as_mesh(mesh), tuple(views)
        if not self.views:
            raise ValueError("got no view of the shape; expected one or more: make a fit.ShapeView of each image")
        count = len(self.mesh.vertices)
        moves = np.ones(count, bool) if free is None else np.asarray(free)
        if moves.shape != (count,) or moves.dtype != bool or not moves.any():
            raise ValueError(
                f"free is an array of shape {moves.shape} and type {moves.dtype}, and the mesh has {count} "
                "vertices; expected a bool for each, True for at least one"
            )
        self.free = as_array(moves)
        self.symmetry = None if symmetry is None else tuple(float(number) for number in symmetry)
        height, width = self.views[0].reference.shape
        self.technique = default_technique((height, width)) if technique is None else technique
        _check_technique(self.technique)
        if not np.array_equal(share_vertices(self.mesh), np.asarray(self.mesh.faces)):
            raise ValueError(
                "several of the mesh's vertices are at the same position, and would move apart; expected one vertex "
                "at each position: "
                "call geometry.weld on its vertices and faces"
            )
        if self.symmetry is not None:
            mirror_partners(np.asarray(self.mesh.vertices, float), self.symmetry)


def default_technique(resolution: Resolution) -> ShadowMapping:
    """Exact coverage of each texel of a map of this `resolution`. Receivers cast no shadow, so there is no bias."""
    height, width = resolution
    return ShadowMapping(Bilinear(), ConstantBias(0.0), map=MapSettings((height, width), silhouettes=True))


def _check_technique(technique: ShadowMapping) -> None:
    if not technique.map.silhouettes:
        raise ValueError(
            "the technique's map has no silhouettes, so vertices have no derivative; expected "
            "MapSettings(..., silhouettes=True)"
        )
    if not isinstance(technique.layout, SingleMap):
        kind = type(technique.layout).__name__
        raise ValueError(f"the technique's layout is {kind}, which follows a camera; expected SingleMap()")


def mirror_partners(vertices: Float[HostArray, "v 3"], plane: tuple[float | int, ...]) -> Int[HostArray, " v"]:
    """(v,), the vertex at each vertex's mirror image.

    **Raises** `ValueError` if a vertex has none.
    """
    normal, offset = np.asarray(plane[:3]), plane[3]
    if not np.linalg.norm(normal) > 0:
        raise ValueError(
            f"symmetry is {list(plane)}; expected a plane [a, b, c, d] with a normal [a, b, c] that is not 0"
        )
    query: Any = KDTree(vertices).query
    far, partner = query(mirrored(vertices, plane))
    size = np.ptp(vertices, axis=0).max()
    if far.max() > _SAME_PLACE * size or not np.array_equal(partner[partner], np.arange(len(vertices))):
        raise ValueError(
            f"the mesh is not symmetric across {normal.tolist()} · x = {offset:g}: vertex {far.argmax()} is "
            f"{far.max():.3g} world units from its partner's position; expected a start with this symmetry, such as a "
            "sphere about a point of the plane"
        )
    return partner


def mirrored(vertices: Float[HostArray, "v 3"], plane: tuple[float | int, ...]) -> Float[HostArray, "v 3"]:
    """The mirror images of points."""
    normal = np.asarray(plane[:3]) / np.dot(plane[:3], plane[:3])
    return vertices - 2 * (vertices @ np.asarray(plane[:3]) - plane[3])[:, None] * normal


class Evaluation(NamedTuple):
    """The loss of a shape, and additional values for a fit.

    - `loss`: the mean over all views of their mean square differences under the blur.
    - `gradient`: (v, 3), with respect to the vertices; `by_lights`: for each group of views, with respect to the poses
      of their lights, along a first axis; `None` if no light moves.
    - `images`: for each group of views, (n, h, w), their visibilities.
    - `crossings`: the maximum number of texel sides that the silhouettes in a map cross. If there are more crossings
      than memory, all of these results are wrong.
    """

    loss: Scalar
    gradient: Vertices
    by_lights: list[LightPose] | None
    images: list[Float[Array, "n h w"]]
    crossings: Int[Array, ""]


@eqx.filter_jit
def evaluate(
    vertices: Vertices,
    faces: Faces,
    edges: Edges,
    groups: list[ShapeView],
    receivers: list[Receivers | None],
    poses: list[LightPose] | None,
    technique: ShadowMapping,
    blur: Scalar,
    crossings: int,
) -> Evaluation:
    """The loss of a mesh.

    **Arguments:**

    - `groups`: views of one structure, with a leading axis. The views are scanned, each with its own reverse pass. A
      group therefore needs the program and the memory of a single view.
    - `receivers`: the receivers of groups whose pixels coincide with their maps' texels.
    - `poses`: the poses of their lights, also with a leading axis; `None` if no light moves.
    - `crossings`: the memory for crossings of silhouettes with the sides of texels, as a number of crossings.
    """
    count = sum(group.reference.shape[0] for group in groups)

    def loss_of(
        at: tuple[Vertices, LightPose | None], view: ShapeView, aligned: Receivers | None
    ) -> tuple[Scalar, Any]:
        vertices, pose = at
        mesh, light = _mesh(vertices, faces), view.light if pose is None else view.light.at(pose)
        drawn = technique.map.draw(mesh, light, edges=edges, crossings=crossings, raises=False)
        seen = technique.visibility(drawn, view.surface) if aligned is None else aligned.seen(drawn)
        image = seen * cone_fraction(light, view.surface)
        difference = blurred((image - view.reference) * jnp.sqrt(view.weight), blur)
        return jnp.sum(difference**2) / (jnp.sum(view.weight) * count), (image, drawn.crossings)

    def add(total: Any, each: tuple[ShapeView, Receivers | None, LightPose | None]) -> tuple[Any, Any]:
        view, aligned, pose = each
        (loss, seen), (gradient, by_light) = jax.value_and_grad(loss_of, has_aux=True)((vertices, pose), view, aligned)
        return (total[0] + loss, total[1] + gradient), (*seen, by_light)

    total, images, needed, by_lights = (jnp.zeros((), vertices.dtype), jnp.zeros_like(vertices)), [], [], []
    for group in zip(groups, receivers, [None] * len(groups) if poses is None else poses, strict=True):
        total, (image, of_group, by_light) = jax.lax.scan(add, total, group)
        images.append(image)
        needed.append(jnp.max(of_group))
        by_lights.append(by_light)
    gradient = None if poses is None else by_lights
    return Evaluation(total[0], total[1], gradient, images, jnp.max(jnp.stack(needed)))


def _mesh(vertices: Vertices, faces: Faces) -> Mesh:
    """A mesh whose normals and albedo are 0, because shadows do not depend on them."""
    none = jnp.zeros((faces.shape[0], 3, 3), vertices.dtype)
    return Mesh(vertices, faces, none, none[:, 0])


class Sight(NamedTuple):
    """The pixels of a view's screen that its light sees. Arrays have a first axis for several views.

    - `reached`: (h, w), pixels that count, are in the light's map, and face the light.
    - `towards`: (h, w, 3), vectors to the light.
    - `receivers`: the pixels in the light's map.
    """

    reached: Any
    towards: Any
    receivers: Receivers


@eqx.filter_jit
def sights(groups: list[ShapeView]) -> list[Sight]:
    """The sight of each view, in each group along a first axis."""

    def of_view(view: ShapeView) -> Sight:
        surface = view.surface
        towards = view.light.towards(surface.position)
        clip = view.light.view().facing(view.light.layer(surface.position)).clip(surface.position)
        inside = jnp.all(jnp.abs(clip[..., :3]) <= clip[..., 3:], axis=-1)
        is_turned = jnp.sum(towards * surface.normal, axis=-1) > 0
        reached = (view.weight > 0) & surface.mask & inside & is_turned
        return Sight(reached, towards, Receivers.of(clip, surface.mask, is_turned))

    return [jax.lax.map(of_view, group) for group in groups]


def casts_shadow(mesh: Mesh, view: ShapeView, sight: Sight) -> bool:
    """Whether a mesh hides the light from the centre of a pixel that counts."""
    reached = np.asarray(sight.reached)
    points, towards = np.asarray(view.surface.position)[reached], np.asarray(sight.towards)[reached]
    return bool(occluded(mesh, points, towards, np.inf if view.light.is_directional else 1.0).any())


def crossings_for(resolution: Resolution) -> int:
    """Memory for the crossings of most shapes, so that all of them share a program."""
    return round_up_to_power_of_two(_CROSSINGS_PER_SIDE * sum(resolution))
