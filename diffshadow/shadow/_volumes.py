"""Shadow volumes (Crow 1977): the space that casters hide from a light, and a test for surfaces inside it.

Every caster's silhouette is extruded away from the light to infinity. A surface is shadowed if a view ray enters more
volumes than it leaves before it hits the surface; a stencil buffer counts them (Heidmann 1991). No map is sampled, so
the shadows are exact up to the rounding of the rasterizer.

In a solid (closed, with the light outside), the faces towards the light count. In any other mesh (open,
self-intersecting or non-manifold), every face away from the light is flipped. Edges of faces with opposite winding
cancel, and each remaining edge is extruded once for each time that it remains (Kim, Kim & Hong 2008, "A shadow volume
algorithm for opaque and transparent non-manifold casters").
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import as_float, dot, in_float64, normalize
from .._types import ClipVertices, DepthMap, FaceMap, Faces, Mask, Scalar, Vec3, Visibility
from ..geometry import (
    AbstractCamera,
    AbstractLight,
    Edges,
    Mesh,
    Scene,
    View,
    infinite_far,
    merge,
    transform_vectors,
)
from ..raster import (
    Surface,
    barycentrics,
    count_fragments,
    drawn_view,
    interpolate_depth,
    light_sides,
    rasterize,
    silhouettes_by_adjacency,
)
from ..settings.techniques import ShadowVolumes as Settings
from ..settings.techniques import VolumeMethod
from ._technique import AbstractTechnique
from ._whole_faces import check_whole_faces

# Surfaces are moved closer by this distance, in window depth, so that coplanar caps are behind them despite rounding.
# It is thousands of times the rounding error of float64, and 1/65,000 of float32's.
_BEFORE = 2.0**-40
# A parallel projection cannot show points at infinity, so volumes end at this many far distances.
_NEARLY_INFINITE = 2.0**20
# The light counts as outside a solid that subtends less than this fraction of the sphere of directions around it.
_OUTSIDE = 0.25


class VolumeScene(eqx.Module):
    """The input of shadow volumes.

    - `casters`: visible surfaces that cast shadows. Volumes are watertight if coincident vertices are bitwise equal.
    - `light`, `camera`: the light that extrudes the volumes, and the camera that sees them.
    - `edges`: edges of `casters`.
    - `receivers`: surfaces that are visible but cast no shadow, or `None`.
    """

    casters: Mesh
    light: AbstractLight
    camera: AbstractCamera
    edges: Edges
    receivers: Mesh | None = None


class Volumes(eqx.Module):
    """The faces of shadow volumes, in the camera's clip space.

    - `clip`: (v, 4), vertices: first the casters' own, then those at infinity.
    - `faces`: (t, 3), anticlockwise seen from outside if the weight is positive, clockwise if it is negative.
    - `weights`: (t,), the multiplicity of each face; 0 for faces that are not part of a volume.
    """

    clip: ClipVertices
    faces: Faces
    weights: Int[Array, " t"]


class ShadowVolumes(AbstractTechnique):
    """Hard shadows by counting the shadow volumes around each visible surface point.

    - `method`: the faces of volumes that are counted. `"z_fail"`: faces at or behind the surface, with volumes capped
      at both ends (Bilodeau & Songy 1999; Carmack 2000). It is correct for every position of the eye. `"z_pass"`: faces
      in front of the surface, without caps. It is cheaper, but wrong if the eye is inside a volume or the near plane
      cuts a volume.

    Every light counts as a point light or a directional light. The cone of a spot light and the size of a light are
    ignored. A mesh that does not cast blocks neither light nor shadow. A caster's shadow falls on such a wall, and
    again on surfaces behind the wall (a "ghost shadow"). Let the wall cast to avoid this.

    The counts are integers and have no gradient.
    """

    settings: ClassVar = Settings

    method: VolumeMethod = eqx.field(static=True, default=Settings.method)

    def prepare(self, scene: Scene, surface: Surface | None = None) -> VolumeScene:
        """The scene's casters with their edges. It does not depend on `surface`, and cannot be used inside `jax.jit`.

        Edges depend only on the mesh. To draw one mesh many times, find them once.

        **Raises** `ValueError` if a mesh has an alpha test, whose cut outlines extrude no volumes.
        """
        check_whole_faces(scene.mesh, "shadow volumes", "use a shadow map")
        casters = scene.casters
        return VolumeScene(casters, scene.light, scene.camera, Edges.of(casters), scene.receivers)

    def counts(self, state: VolumeScene) -> Int[Array, "h w"]:
        """The number of shadow volumes that contain each visible surface point, (h, w). Row 0 is the bottom row.

        For a solid, each face between light and point counts if it faces the light. For an open mesh, each face between
        light and point counts. The count is undefined at pixels without a surface.
        """
        return self._count(state).counts

    def visibility(self, state: VolumeScene, surface: Surface | None = None) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        A point is lit if it lies in no volume and the camera sees the side of its surface that faces the light. Pixels
        without a surface between the camera's near and far distances are lit.

        **Arguments:**

        - `surface`: ignored, because the faces that the state's camera sees are drawn again in double precision.
        """
        found = self._count(state)
        return as_float((found.counts == 0) & found.lit_side | ~found.seen)

    def covered(self, state: VolumeScene, surface: Surface) -> Mask:
        """Every pixel with a surface, (h, w)."""
        return surface.mask

    def _count(self, state: VolumeScene) -> "_SeenCounts":
        # The view is bitwise the view that draws surfaces. The rest is in double precision, because a volume's side may
        # pass closer to a surface than single-precision depths can resolve.
        view = state.camera.view()
        with jax.enable_x64(True):
            given = state.casters, state.light, state.camera.eye, view, state.receivers
            casters, light, eye, view, receivers = in_float64(given)
            drawing = _drawing(casters, light, eye, view, receivers, state.edges, self.method == "z_fail")
            visible = drawing.visible.astype(jnp.float32)
        face = rasterize(visible, drawing.faces, state.camera.resolution).face
        with jax.enable_x64(True):
            at = _behind(face, drawing)
            when, sign = ("fail", -1) if self.method == "z_fail" else ("pass", 1)
            found = drawing.volumes
            counts = count_fragments(found.clip, found.faces, found.weights, at.depth, when)
            return _SeenCounts(sign * counts, at.lit_side, at.seen)


def shadow_volumes(
    casters: Mesh, light: AbstractLight, camera: AbstractCamera, edges: Edges, *, caps: bool = True
) -> Volumes:
    """The shadow volumes of `casters` under `light`, as `camera` sees them with its far plane at infinity.

    **Arguments:**

    - `edges`: edges of `casters`.
    - `caps`: whether volumes are capped, by the casters' faces and by the same faces at infinity.
    """
    view = _endless(camera.view())
    return _volumes(view.clip(casters.vertices), casters, light, view, edges, caps)


class _Drawing(eqx.Module):
    """The drawn geometry, in float64: the visible meshes, (v, 4) and (f, 3), and the volumes.

    - `visible`: (v, 4), the visible meshes in `drawn_view`. Their window depths may differ from the volumes'.
    - `lit_side`: (f,), whether camera and light see the same side of a face.
    - `farthest`: window depth of the camera's own far plane.
    """

    clip: ClipVertices
    visible: ClipVertices
    faces: Faces
    volumes: Volumes
    lit_side: Bool[Array, " f"]
    farthest: Scalar


class _Seen(eqx.Module):
    """The surface at each pixel, all (h, w): its depth in float64; whether the camera sees its lit side; and whether
    there is a surface in front of the far plane."""

    depth: DepthMap
    lit_side: Mask
    seen: Mask


class _SeenCounts(eqx.Module):
    """Like `_Seen`, with the number of volumes instead of the depth."""

    counts: Int[Array, "h w"]
    lit_side: Mask
    seen: Mask


@eqx.filter_jit
def _drawing(
    casters: Mesh, light: AbstractLight, eye: Vec3, view: View, receivers: Mesh | None, edges: Edges, caps: bool
) -> _Drawing:
    scene = casters if receivers is None else merge([casters, receivers])
    drawn = drawn_view(view, scene)
    if caps:
        # Only fragments behind the surface count, so the near plane may be moved towards it.
        view = drawn
    farthest = 1 - view.near / view.far if view.is_perspective else as_float(1)
    clip, visible = (_endless(each).clip(scene.vertices) for each in (view, drawn))
    view = _endless(view)
    volumes = _volumes(clip[: casters.vertices.shape[0]], casters, light, view, edges, caps)
    return _Drawing(clip, visible, scene.faces, volumes, _lit_side(scene, light, eye, view), farthest)


@eqx.filter_jit
def _behind(face: FaceMap, drawing: _Drawing) -> _Seen:
    """The surface at each pixel, from its face (h, w)."""
    at = barycentrics(face, drawing.clip, drawing.faces)
    depth = interpolate_depth(at, drawing.clip, drawing.faces)
    return _Seen(depth - _BEFORE, drawing.lit_side[at.face], at.mask & (depth <= drawing.farthest))


def _endless(view: View) -> View:
    """The view with its far plane at infinity. A parallel view is returned unchanged."""
    if not view.is_perspective:
        return view
    return eqx.tree_at(lambda view: view.eye_to_clip, view, infinite_far(view.eye_to_clip, view.near))


def _volumes(clip: ClipVertices, casters: Mesh, light: AbstractLight, view: View, edges: Edges, caps: bool) -> Volumes:
    orientation = _orientation(casters, light, edges)
    outline = silhouettes_by_adjacency(edges, orientation)
    a, b = outline.vertices.T
    count = casters.vertices.shape[0]
    away = -light.towards(casters.vertices)
    if light.is_directional and view.is_perspective:
        # All sides meet at one point at infinity, so volumes need no back cap.
        ends = _at_infinity(view, away[:1])
        sides = [jnp.stack([b, a, jnp.full_like(a, count)], axis=1)]
        back = []
    else:
        ends = _at_infinity(view, away) if view.is_perspective else _far_away(clip, view, away)
        sides = [jnp.stack([b, a, a + count], axis=1), jnp.stack([b, a + count, b + count], axis=1)]
        back = [casters.faces + count]
    weights = [outline.multiplicity] * len(sides)
    if caps:
        # Caps keep the faces' vertex order in any orientation, so that their depths equal the visible faces'.
        sides += [casters.faces, *back]
        weights += [orientation, -orientation][: 1 + len(back)]
    return Volumes(jnp.concatenate([clip, ends]), jnp.concatenate(sides), jnp.concatenate(weights))


def _orientation(casters: Mesh, light: AbstractLight, edges: Edges) -> Int[Array, " f"]:
    """The weight of each face. For solids, 1 if it faces the light and 0 otherwise; for other meshes, -1 if it must be
    flipped."""
    sides = light_sides(casters, light)
    is_solid = edges.solid
    if not light.is_directional:
        is_solid = is_solid & ~_surrounds(casters, light, edges)
    return jnp.where(is_solid[edges.component], jnp.maximum(sides, 0), sides)


def _surrounds(casters: Mesh, light: AbstractLight, edges: Edges) -> Bool[Array, " c"]:
    """Whether the light is inside each component, from the component's solid angle as seen from the light.

    Van Oosterom & Strackee 1983, "The solid angle of a plane triangle".
    """
    from_light = -light.towards(casters.vertices)
    a, b, c = (from_light[casters.faces[:, k]] for k in range(3))
    la, lb, lc = (jnp.sqrt(dot(v, v)) for v in (a, b, c))
    angle = 2 * jnp.arctan2(dot(a, jnp.cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)
    fraction = jax.ops.segment_sum(angle, edges.component, edges.solid.shape[0]) / (4 * jnp.pi)
    return jnp.abs(fraction) > _OUTSIDE


def _at_infinity(view: View, directions: Float[Array, "n 3"]) -> Float[Array, "n 4"]:
    """Clip coordinates of the points at infinity along `directions` (n, 3)."""
    eye = transform_vectors(view.world_to_eye, directions)
    columns = view.eye_to_clip.T
    return eye[:, 0:1] * columns[0] + eye[:, 1:2] * columns[1] + eye[:, 2:3] * columns[2]


def _far_away(clip: ClipVertices, view: View, directions: Float[Array, "v 3"]) -> Float[Array, "v 4"]:
    """Clip coordinates of the vertices at `clip` (v, 4), moved very far along `directions` (v, 3)."""
    reach = jnp.maximum(jnp.abs(view.near), jnp.abs(view.far))
    return clip / _NEARLY_INFINITE + _at_infinity(view, reach * normalize(directions))


def _lit_side(scene: Mesh, light: AbstractLight, eye: Vec3, view: View) -> Bool[Array, " f"]:
    """Whether the camera at `eye` sees the same side of each face as the light."""
    a, b, c = (scene.vertices[scene.faces[:, k]] for k in range(3))
    to_camera = eye - (a + b + c) / 3 if view.is_perspective else view.world_to_eye[2, :3]
    front = dot(jnp.cross(b - a, c - b), to_camera) >= 0
    return jnp.where(front, 1, -1) == light_sides(scene, light)
