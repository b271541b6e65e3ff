"""Residuals where lights or meshes move: the map, and if need be the surface, are drawn anew at every step."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.stats import norm
from jaxtyping import Array, Float

from .._misc import round_up_to_power_of_two, sums_along
from .._types import Mask, Resolution, Scalar, Visibility
from ..geometry import AbstractCamera, AbstractLight, Edges, Mesh, View, merge, transform_points
from ..raster import Capacity, Cull, Overflow, Surface, draw_surface, plan
from ..shadow import ShadowMap, draw_shadow_map, plan_shadow_map
from ._arrangement import Arrangement
from ._parameters import with_values

# The standard deviation, in pixels of any level, of the Gaussian under which images are compared. A shadow that lies
# further off than an outline is wide is otherwise not seen to be there; and outlines are as soft as the map's texels
# here, and sharp in a reference, which sharp differences would take for a light that is elsewhere.
_BLUR = 3.0
REACH_OF_BLUR = 4
"""How far the Gaussian of a blur goes, in standard deviations."""
# The last phase's blur, in texels as the camera sees them, and the least in pixels: of suns and point lights over real
# meshes, an image under it tells best where they are (`docs/experiments.md`).
_LAST_BLUR = 0.7
_LEAST_BLUR = 1.0
# By how much less the map is coarsened than the image: a mesh's silhouettes get lost in texels as wide as its parts.
_FINER_MAP = 2
# What poses elsewhere within the bounds may need beyond the greatest need that was seen.
_HEADROOM = 2
_MORE_SILHOUETTES = 4


class MapSettings(NamedTuple):
    """How a shadow map is drawn; see `draw_shadow_map`. With silhouettes, derivatives see the shadow's outline move."""

    resolution: Resolution = (512, 512)
    layer: Literal["nearest", "midpoint", "second"] = "nearest"
    cull: Cull = "none"
    depth_format: Literal["float32", "unorm24", "unorm16"] = "float32"
    polygon_offset: tuple[float, float] | None = None
    silhouettes: bool = True

    def of_map(self) -> dict[str, Any]:
        """What `draw_shadow_map` takes besides edges and capacities."""
        return {name: value for name, value in self._asdict().items() if name not in ("resolution", "silhouettes")}


class Room(NamedTuple):
    """Capacities that drawing takes: of the map, of its silhouettes, and of the camera's view."""

    from_light: Capacity = Capacity()
    silhouettes: int = 0
    from_camera: Capacity = Capacity()

    def grown_to(self, other: "Room") -> "Room":
        """The least room that holds what either holds."""
        silhouettes = max(self.silhouettes, other.silhouettes)
        from_light = self.from_light.grown_to(other.from_light)
        return Room(from_light, silhouettes, self.from_camera.grown_to(other.from_camera))

    def doubled(self) -> "Room":
        """Twice the room."""
        return Room(_roomy(self.from_light), 2 * self.silhouettes, _roomy(self.from_camera))

    def coarser(self) -> "Room":
        """Room for the same in coarser images."""
        return Room(coarser(self.from_light), self.silhouettes, coarser(self.from_camera))


class _Unplanned(NamedTuple):
    """No room is set: what drawing takes is counted as it goes."""

    from_light: None = None
    silhouettes: None = None
    from_camera: None = None


class PoseProblem(eqx.Module):
    """An arrangement, what it is fitted to under one of its lights, and what stays as it is.

    - `arrangement`: whose numbers are fitted.
    - `meshes`, `casts`: as the arrangement's poses place them, and which of them cast.
    - `light`, `index`: one of the lights as it stands, and which of the arrangement's it is.
    - `camera`: where the image is seen from.
    - `reference`: (h, w), visibility in [0, 1], times the cone's share if the light is a spot light with an
        `inner_angle`.
    - `weight`: (h, w), how much each pixel counts; 0 or 1, or between where it stands for several.
    - `settings`: how the map is drawn.
    - `surface`: what the camera sees; none to draw it anew, which it must be unless what moves is out of sight.
    - `room`: what drawing may take, see `planned`; without it, nothing may be traced.
    - `edges`: of all that casts, which `planned` finds if the settings ask for silhouettes.
    - `blur`: standard deviation, in pixels, of the Gaussian under which differences count; 0 for none. It should
        cover a texel of the map as the camera sees it.
    - `sharpness`: by how much narrower than `blur` the Gaussian is, 1 or more.
    """

    arrangement: Arrangement
    meshes: tuple[Mesh, ...]
    casts: tuple[bool, ...] = eqx.field(static=True)
    light: AbstractLight
    index: int = eqx.field(static=True)
    camera: AbstractCamera
    reference: Visibility
    weight: Float[Array, "h w"]
    settings: MapSettings = eqx.field(static=True, default=MapSettings())
    surface: Surface | None = None
    room: Room | None = eqx.field(static=True, default=None)
    edges: Edges | None = None
    blur: float = eqx.field(static=True, default=_BLUR)
    # A number of the program, so that one program serves phases of any sharpness.
    sharpness: Scalar | float = 1.0

    @property
    def subject(self) -> Arrangement:
        """What is fitted."""
        return self.arrangement

    @property
    def mask(self) -> Mask:
        """Which pixels count."""
        return self.weight > 0

    @property
    def count(self) -> Scalar:
        """How many pixels count."""
        return jnp.sum(self.weight)

    def difference(self, arrangement: Arrangement, overflows: list[Overflow] | None = None) -> Float[Array, "h w"]:
        """Visibility less reference, times the square root of the pixel's weight.

        **Arguments:** `overflows` as for `draw_shadow_map`.
        """
        shadow_map, surface = self.draw(arrangement, overflows)
        visibility = arrangement.technique.visibility(shadow_map, surface) * cone_share(shadow_map.light, surface)
        counts = self.weight > 0
        root = jnp.sqrt(jnp.where(counts, self.weight, 1))
        return jnp.where(counts, (visibility - self.reference) * root, 0)

    def compared(self, difference: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """What counts of a difference: its blur."""
        return _blurred(difference, self.blur, self.sharpness)

    def draw(self, arrangement: Arrangement, overflows: list[Overflow] | None = None) -> tuple[ShadowMap, Surface]:
        """The map and the surface of an arrangement.

        **Arguments:** `overflows` as for `draw_shadow_map`.
        """
        meshes = self._placed(arrangement)
        light = self.light.at(arrangement.lights[self.index]).refitted(_points(meshes))
        room = self.room or _Unplanned()
        shadow_map = draw_shadow_map(
            self._casters(meshes),
            light,
            self.settings.resolution,
            edges=self._edges(),
            capacity=room.from_light,
            silhouette_capacity=room.silhouettes,
            overflows=overflows,
            **self.settings.of_map(),
        )
        if self.surface is not None:
            return shadow_map, self.surface
        return shadow_map, draw_surface(merge(meshes), self.camera, capacity=room.from_camera, overflows=overflows)

    @property
    def sharpest(self) -> float:
        """The sharpness at which differences tell most of where lights and meshes are, once these are nearly there.

        A narrower blur does not cancel what a texel does to an outline; a wider one mixes outlines that move
        differently.
        """
        texel = float(_texel_in_pixels(self.light, self.camera, _points(self.meshes), self.settings.resolution))
        return self.blur / min(max(_LAST_BLUR * texel, _LEAST_BLUR), self.blur) if self.blur else 1.0

    def at_level(self, level: int) -> "PoseProblem":
        """The problem seen with `level` x `level` pixels made one, and a map that is half as much coarser.

        A filter's radius in texels stays, so that it spans as much more of the scene. The reference's pixels are means
        of those that count, and the blur is of as many of these pixels.
        """
        if level == 1:
            return self
        smaller = lambda size, by=level: (size[0] // by, size[1] // by)
        blocks = lambda image: image.reshape(image.shape[0] // level, level, image.shape[1] // level, level)
        mean = lambda image: blocks(image).mean(axis=(1, 3))
        weight = mean(self.weight)
        counted = jnp.where(weight > 0, weight, 1)
        reference = jnp.where(weight > 0, mean(self.weight * self.reference) / counted, 1)
        camera = dataclasses.replace(self.camera, resolution=smaller(self.camera.resolution))
        return dataclasses.replace(
            self,
            camera=camera,
            reference=reference,
            weight=weight,
            settings=self.settings._replace(resolution=smaller(self.settings.resolution, max(1, level // _FINER_MAP))),
            surface=None if self.surface is None else draw_surface(merge(self.meshes), camera),
            room=None if self.room is None else self.room.coarser(),
        )

    def planned(self, paths: Sequence[str], values: Float[Array, "k p"]) -> "PoseProblem":
        """With room for the arrangements that have `values` (k, p) at `paths`, and as much again."""
        from_light, from_camera = _clips(self, tuple(paths), values)
        faces, edges, resolution = self._casters(self.meshes).faces, self._edges(), self.settings.resolution
        room = Room(plan(from_light, faces, resolution, cull=self.settings.cull)).doubled()
        if edges is not None:
            # Silhouettes are lines, whose length in texels varies less than triangles' sizes do: one look is enough.
            meshes = self._placed(self.arrangement)
            light = self.light.at(self.arrangement.lights[self.index]).refitted(_points(meshes))
            here = plan_shadow_map(self._casters(meshes), light, resolution, edges=edges)
            room = room.grown_to(Room(_roomy(here.triangles), _MORE_SILHOUETTES * here.silhouettes))
        if from_camera is not None:
            seen = plan(from_camera, merge(self.meshes).faces, self.camera.resolution)
            room = room._replace(from_camera=_roomy(seen))
        room = room if self.room is None else self.room.grown_to(room)
        return dataclasses.replace(self, room=room, edges=edges)

    @property
    def sides(self) -> tuple[int, ...]:
        """The sides of image and map, in pixels and texels."""
        return (*self.reference.shape, *self.settings.resolution)

    def _casters(self, meshes: Sequence[Mesh]) -> Mesh:
        return merge([mesh for mesh, casts in zip(meshes, self.casts, strict=True) if casts])

    def _edges(self) -> Edges | None:
        if not self.settings.silhouettes:
            return None
        return Edges.of(self._casters(self.meshes)) if self.edges is None else self.edges

    def _placed(self, arrangement: Arrangement) -> list[Mesh]:
        return [pose.placed(mesh) for pose, mesh in zip(arrangement.meshes, self.meshes, strict=True)]


def cone_share(light: AbstractLight, surface: Surface) -> Float[Array, "h w"]:
    """The share of the light that its cone lets through to each pixel, (h, w); 1 where there is no surface."""
    return jnp.where(surface.mask, light.cone_fraction(surface.position), 1)


def _blurred(image: Float[Array, "h w"], widest: float, sharpness: Scalar | float) -> Float[Array, "h w"]:
    """An image under a Gaussian of standard deviation `widest / sharpness` in pixels, and 0 beyond its border."""
    if widest == 0:
        return image
    reach = math.ceil(REACH_OF_BLUR * widest)
    weights = norm.pdf(jnp.arange(-reach, reach + 1), scale=widest / sharpness).astype(image.dtype)
    # Else XLA would work out the first sums anew for each of the second.
    columns = lax.optimization_barrier(sums_along(jnp.pad(image, reach), weights, axis=0))
    return sums_along(columns, weights, axis=1)


def coarser(capacity: Capacity) -> Capacity:
    """Room for the same triangles in a coarser image, where each is at most as large."""
    total, windows = capacity.large, []
    for needed in reversed(capacity.windows):
        total += needed
        windows.append(round_up_to_power_of_two(total) if needed else 0)
    return capacity._replace(windows=tuple(reversed(windows)))


def _roomy(capacity: Capacity) -> Capacity:
    more = lambda needed: _HEADROOM * needed
    return Capacity(
        clipped=more(capacity.clipped),
        windows=tuple(map(more, capacity.windows)),
        large=more(capacity.large),
        candidates=more(capacity.candidates),
        blocks=more(capacity.blocks),
    )


@eqx.filter_jit
def _texel_in_pixels(
    light: AbstractLight, camera: AbstractCamera, points: Float[Array, "n 3"], resolution: Resolution
) -> Scalar:
    """How many pixels wide a map's texel is at half of the points, or more."""

    def width(view: View, resolution: Resolution) -> Float[Array, " n"]:
        distance = -transform_points(view.world_to_eye, points)[..., 2]
        return view.texel_size(jnp.maximum(distance, view.near) if view.is_perspective else distance, resolution)

    layer = light.layer(points)
    from_light = light.view() if layer is None else light.view().facing(layer)
    return jnp.median(width(from_light, resolution) / width(camera.view(), camera.resolution))


@eqx.filter_jit
def _clips(problem: PoseProblem, paths: tuple[str, ...], values: Float[Array, "k p"]) -> tuple[Array, Array | None]:
    """Clip coordinates of what casts, as the light sees it, and of everything as a camera does that sees it move."""

    def of(values: Array) -> tuple[Array, Array | None]:
        arrangement = with_values(problem.arrangement, paths, values)
        meshes = problem._placed(arrangement)
        view = problem.light.at(arrangement.lights[problem.index]).refitted(_points(meshes)).view()
        casters = problem._casters(meshes)
        views = view.world_to_eye.reshape(-1, 4, 4)
        one = lambda matrix: eqx.tree_at(lambda v: v.world_to_eye, view, matrix).clip(casters.vertices)
        from_camera = None if problem.surface is not None else problem.camera.view().clip(merge(meshes).vertices)
        return jax.vmap(one)(views), from_camera

    from_light, from_camera = jax.vmap(of)(values)
    return from_light.reshape(-1, *from_light.shape[-2:]), from_camera


def _points(meshes: Sequence[Mesh]) -> Float[Array, "n 3"]:
    return jnp.concatenate([mesh.vertices for mesh in meshes])
