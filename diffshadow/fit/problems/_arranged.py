"""Shared code of fits of arrangements, in which lights and meshes move and images are compared under a blur."""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import Resolution, Scalar
from ...geometry import AbstractCamera, AbstractLight, Edges, Mesh, Scene, View
from ...raster import Surface
from ...settings.fit import MOST_SHADOW_POINTS
from ...shadow import MapSettings, ShadowMap, ShadowMapping, plan_crossings
from .._arrangement import Arrangement
from ._abstract import AbstractProblem
from ._blur import blurred

# The last phase's blur, in texels as the camera sees them, and its minimum in pixels. For suns and point lights over
# real meshes, this blur locates lights and meshes best (`docs/experiments.md`).
_LAST_BLUR = 0.7
_MIN_BLUR = 1.0
# The initial memory for silhouettes' crossings, as a multiple of the crossings at the start. If more are needed, phases
# are repeated.
_MORE_CROSSINGS = 4
# The maximum number of shadow points in a pixel. There is one point if texels are wider than two pixels. Otherwise
# there are about this many for each texel along a side of the pixel.
_FIBONACCI = 1, 2, 3, 5, 8, 13, 21
_PER_ROW, _WIDE = 4, 2.0


class ArrangedProblem(AbstractProblem):
    """A problem whose subject is an `Arrangement`. Moving objects are drawn again at every step.

    - `arrangement`: the arrangement whose numbers are fitted.
    - `scene`: meshes, camera and lights before the arrangement moves them.
    - `weight`: (h, w), the weight of each pixel: 0 or 1, or in between if the pixel is a mean over several.
    - `settings`: how maps are drawn. Derivatives see the shadow's outline move only with silhouettes.
    - `edges`: edges of the casters. `planned` finds them if the settings ask for silhouettes.
    - `blur`: standard deviation, in pixels, of the Gaussian under which differences are compared; 0 for none. The blur
      should cover a texel of the map, as seen by the camera.
    - `shift`: (2,), a shift of the maps' grids of texels, as for `draw_shadow_map`; `None` for no shift. Maps with a
      warp, with pages or with cascades of several sizes have no such grid, and are not shifted.
    """

    arrangement: eqx.AbstractVar[Arrangement]
    scene: eqx.AbstractVar[Scene]
    weight: eqx.AbstractVar[Float[Array, "h w"]]
    settings: eqx.AbstractVar[MapSettings]
    edges: eqx.AbstractVar[Edges | None]
    blur: eqx.AbstractVar[Scalar]
    shift: eqx.AbstractVar[Float[Array, "2"] | None]

    @property
    def moves(self) -> bool:
        """True."""
        return True

    @property
    def subject(self) -> Arrangement:
        """What is fitted."""
        return self.arrangement

    def technique_of(self, subject: Arrangement) -> ShadowMapping:
        """The arrangement's technique."""
        return subject.technique

    @property
    def shape(self) -> Resolution:
        """Height and width of its images, in pixels."""
        height, width = self.weight.shape
        return height, width

    @property
    def blur_in_pixels(self) -> float:
        """Standard deviation of the Gaussian under which differences are compared, in pixels."""
        return float(self.blur)

    def compared(self, differences: Float[Array, "n h w"]) -> Float[Array, "n h w"]:
        """The blur of each difference."""
        return blurred(differences, self.blur)

    def laid_out(self, subject: Arrangement) -> "ArrangedProblem":
        """The problem itself, because maps are drawn at every step."""
        return self

    @abc.abstractmethod
    def with_memory_of(self, other: Any) -> "ArrangedProblem":
        """This problem with as much memory for silhouettes as `other`, a problem of the same kind."""

    @property
    def sharpest(self) -> "ArrangedProblem":
        """This problem with the blur that locates lights and meshes best once they are nearly in place. It is no wider
        than the problem's own blur.

        A narrower blur does not cancel the error of an outline within a texel. A wider blur mixes outlines that move
        differently.
        """
        texel = widest_texel(self.scene, self.settings.resolution)
        return dataclasses.replace(self, blur=min(max(_LAST_BLUR * texel, _MIN_BLUR), self.blur_in_pixels))

    def draw_map(
        self,
        casters: Mesh,
        light: AbstractLight,
        camera: AbstractCamera,
        technique: ShadowMapping,
        surface: Surface | None,
        crossings: int | None,
        *,
        raises: bool,
    ) -> ShadowMap:
        """The map of `casters` under an arranged `light`.

        **Arguments:** `camera`, `surface`: the view that a layout fits maps to; `crossings`, `raises`: as for
        `draw_shadow_map`.
        """
        light = technique.layout.light(light, camera, self.settings.resolution, surface)
        how: dict[str, Any] = {"edges": self.edges_of_casters(), "crossings": crossings, "raises": raises}
        if self.shift is not None and light.view().has_even_texels:
            how["shift"] = self.shift
        return self.settings.draw(casters, light, **how)

    def planned_crossings(
        self, casters: Mesh, light: AbstractLight, camera: AbstractCamera, surface: Surface | None, before: int | None
    ) -> int:
        """Memory for several times the silhouettes of a map, and at least `before`."""
        edges, layout = self.edges_of_casters(), self.arrangement.technique.layout
        assert edges is not None
        light = layout.light(light, camera, self.settings.resolution, surface)
        needed = _MORE_CROSSINGS * plan_crossings(casters, light, self.settings.resolution, edges)
        return max(needed, before or 0)

    def edges_of_casters(self) -> Edges | None:
        """The casters' edges if maps have silhouettes."""
        if not self.settings.silhouettes:
            return None
        return Edges.of(self.scene.casters) if self.edges is None else self.edges

    def padded_meshes(self) -> list[Mesh]:
        """The scene's meshes padded to a few sizes, so that problems of similar size share compiled programs.

        A mesh with individually fitted vertices is not padded, because the padding would not move with them.
        """
        pairs = zip(self.scene.meshes, self.arrangement.meshes, strict=True)
        return [mesh if pose.vertices else mesh.padded() for mesh, pose in pairs]


def with_silhouettes(settings: MapSettings) -> MapSettings:
    """The settings with silhouettes, unless silhouettes are disabled."""
    return dataclasses.replace(settings, silhouettes=settings.silhouettes is not False)


@eqx.filter_jit
def weighted_difference(
    image: Float[Array, "*n h w"], reference: Float[Array, "*n h w"], weight: Float[Array, "h w"]
) -> Float[Array, "*n h w"]:
    """The image minus the reference, times the square root of each pixel's weight; 0 if the weight is 0."""
    counts = weight > 0
    root = jnp.sqrt(jnp.where(counts, weight, 1))
    return jnp.where(counts, (image - reference) * root, 0)


def points_of(meshes: Sequence[Mesh]) -> Float[Array, "n 3"]:
    """The vertices of all meshes."""
    return jnp.concatenate([mesh.vertices for mesh in meshes])


def points_for(scene: Scene, technique: ShadowMapping) -> int:
    """The number of shadow points in each pixel. Pixels that are wide in texels of the map have more, but at most
    `MOST_SHADOW_POINTS` in total."""
    height, width = scene.camera.resolution
    texel = widest_texel(scene, technique.map.resolution)
    needed = 1 if texel >= _WIDE else _PER_ROW / texel
    allowed = [count for count in _FIBONACCI if count * height * width <= MOST_SHADOW_POINTS] or [1]
    return next((count for count in allowed if count >= needed), allowed[-1])


def widest_texel(scene: Scene, resolution: Resolution) -> float:
    """The median width of texels at the scene's vertices, in pixels, under the light with the widest texels."""
    points = points_of(scene.meshes)
    return max(float(_texel_in_pixels(light, scene.camera, points, resolution)) for light in scene.lights)


@eqx.filter_jit
def _texel_in_pixels(
    light: AbstractLight, camera: AbstractCamera, points: Float[Array, "n 3"], resolution: Resolution
) -> Scalar:
    """The median width of a map's texels at the points, in pixels."""

    def width(view: View, resolution: Resolution) -> Float[Array, " n"]:
        distance = view.distance(points)
        return view.texel_size(jnp.maximum(distance, view.near) if view.is_perspective else distance, resolution)

    from_light = light.view().facing(light.layer(points))
    return jnp.median(width(from_light, resolution) / width(camera.view(), camera.resolution))
