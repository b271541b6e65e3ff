"""What fits of arrangements share: lights and meshes move, and images are compared under a blur."""

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

# The last phase's blur, in texels as the camera sees them, and the least in pixels: of suns and point lights over real
# meshes, an image under it tells best where they are (`docs/experiments.md`).
_LAST_BLUR = 0.7
_MIN_BLUR = 1.0
# There is memory for so many times the silhouettes' crossings at the start. If others need more, phases are repeated.
_MORE_CROSSINGS = 4
# So many shadow points there may be within a pixel. There is one where texels are wider than two pixels, and else about
# so many to a row of texels along a side of the pixel.
_FIBONACCI = 1, 2, 3, 5, 8, 13, 21
_PER_ROW, _WIDE = 4, 2.0


class ArrangedProblem(AbstractProblem):
    """A problem whose subject is an `Arrangement`: what moves is drawn again at every step.

    - `arrangement`: whose numbers are fitted.
    - `scene`: meshes, camera and lights before the arrangement moves them.
    - `weight`: (h, w), how much each pixel counts: 0 or 1, or in between if the pixel is a mean over several.
    - `settings`: how maps are drawn. Only with silhouettes do derivatives see the shadow's outline move.
    - `edges`: edges of the casters. `planned` finds them if the settings ask for silhouettes.
    - `blur`: standard deviation, in pixels, of the Gaussian under which differences are compared; 0 for none. The blur
        should cover a texel of the map, as seen by the camera.
    - `shift`: (2,), how far the maps' grids of texels are moved, as for `draw_shadow_map`; none to leave them in place.
        Maps with a warp, with pages or with cascades of several sizes have no such grid, and are not shifted.
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
        """The problem itself: maps are drawn at every step."""
        return self

    @abc.abstractmethod
    def with_memory_of(self, other: Any) -> "ArrangedProblem":
        """The same problem with as much memory for silhouettes as `other`, a problem of the same kind."""

    @property
    def sharpest(self) -> "ArrangedProblem":
        """The same problem with the blur that locates lights and meshes best once these are nearly in place. It is no
        wider than the problem's own blur.

        A narrower blur does not cancel the error that a texel makes in an outline; a wider one mixes outlines that move
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
        """Memory for several times the silhouettes of a map, and no less than `before`."""
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
        """The scene's meshes padded to few sizes, so that problems of like size share compiled programs.

        A mesh whose vertices are fitted one by one is not padded: the padding would not move with them.
        """
        pairs = zip(self.scene.meshes, self.arrangement.meshes, strict=True)
        return [mesh if pose.vertices else mesh.padded() for mesh, pose in pairs]


def with_silhouettes(settings: MapSettings) -> MapSettings:
    """The settings with silhouettes, unless they rule silhouettes out."""
    return dataclasses.replace(settings, silhouettes=settings.silhouettes is not False)


@eqx.filter_jit
def weighted_difference(
    image: Float[Array, "*n h w"], reference: Float[Array, "*n h w"], weight: Float[Array, "h w"]
) -> Float[Array, "*n h w"]:
    """The image minus the reference, times the square root of each pixel's weight; 0 where the weight is 0."""
    counts = weight > 0
    root = jnp.sqrt(jnp.where(counts, weight, 1))
    return jnp.where(counts, (image - reference) * root, 0)


def points_of(meshes: Sequence[Mesh]) -> Float[Array, "n 3"]:
    """The vertices of all meshes."""
    return jnp.concatenate([mesh.vertices for mesh in meshes])


def points_for(scene: Scene, technique: ShadowMapping) -> int:
    """How many shadow points there are within each pixel: more if a pixel is wide in texels of the map, but at most
    `MOST_SHADOW_POINTS` in all."""
    height, width = scene.camera.resolution
    texel = widest_texel(scene, technique.map.resolution)
    needed = 1 if texel >= _WIDE else _PER_ROW / texel
    allowed = [count for count in _FIBONACCI if count * height * width <= MOST_SHADOW_POINTS] or [1]
    return next((count for count in allowed if count >= needed), allowed[-1])


def widest_texel(scene: Scene, resolution: Resolution) -> float:
    """The width of a texel, in pixels, that half of the scene's vertices reach or exceed, under the light with the
    widest texels."""
    points = points_of(scene.meshes)
    return max(float(_texel_in_pixels(light, scene.camera, points, resolution)) for light in scene.lights)


@eqx.filter_jit
def _texel_in_pixels(
    light: AbstractLight, camera: AbstractCamera, points: Float[Array, "n 3"], resolution: Resolution
) -> Scalar:
    """How many pixels wide a map's texel is at half of the points, or more."""

    def width(view: View, resolution: Resolution) -> Float[Array, " n"]:
        distance = view.distance(points)
        return view.texel_size(jnp.maximum(distance, view.near) if view.is_perspective else distance, resolution)

    from_light = light.view().facing(light.layer(points))
    return jnp.median(width(from_light, resolution) / width(camera.view(), camera.resolution))
