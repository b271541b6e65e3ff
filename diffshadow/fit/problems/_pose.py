"""Fits of lights and meshes. The map is drawn again at every step, and also the surface if necessary."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arithmetic import as_float
from ..._types import Scalar, Visibility
from ...geometry import AbstractCamera, AbstractLight, Edges, Mesh, Scene, merge
from ...raster import PixelPoints, Surface, draw_surface, points_within_pixels
from ...reference import Reference
from ...settings.fit import BLUR
from ...shadow import MapSettings, Overflow, ShadowMap, ShadowMapping
from .._arrangement import Arrangement
from .._own_loss import Seen
from ._arranged import ArrangedProblem, points_for, points_of, weighted_difference, with_silhouettes


class PoseProblem(ArrangedProblem):
    """An arrangement, its target under one of its lights, and everything that the fit does not change.

    - `arrangement`: whose numbers are fitted.
    - `scene`: the meshes, the camera and one light, before the arrangement moves them.
    - `index`: the number of this light in the arrangement.
    - `reference`: (h, w), visibility in [0, 1], times `cone_fraction`.
    - `weight`: (h, w), the weight of each pixel: 0 or 1, or in between if the pixel is a mean over several.
    - `settings`: how the map is drawn. Derivatives see the shadow's outline move only with silhouettes.
    - `surface`: the surface that the camera sees; `None` to draw it again at every step. This is necessary if visible
      meshes move.
    - `crossings`: as for `draw_shadow_map`; `planned` finds it.
    - `edges`: edges of the casters. `planned` finds them if the settings ask for silhouettes.
    - `blur`: standard deviation, in pixels, of the Gaussian under which differences are compared; 0 for none. The blur
        should cover a texel of the map, as seen by the camera.
    - `shift`: (2,), a shift of the map's grid of texels, as for `draw_shadow_map`; `None` for no shift. Maps with a
        warp, with pages or with cascades of several sizes have no such grid, and are not shifted.
    - `shadow_points`: the number of points within each pixel. Visibility is the mean over these points. The constructor
      `of` chooses more points if pixels are wide in texels of the map. If an outline is narrower than a pixel, most
      pixels along it have no derivative at their centre.

    !!! Example

        ```python
        problem = fit.PoseProblem.of(scene, technique, truth)
        azimuth = fit.Parameter("lights.0.azimuth", 50.0, 0.0, 90.0, unit="degrees")
        ```
    """

    arrangement: Arrangement
    scene: Scene
    index: int = eqx.field(static=True)
    reference: Visibility
    weight: Float[Array, "h w"]
    settings: MapSettings = eqx.field(static=True, default=MapSettings(silhouettes=True))
    surface: Surface | None = None
    crossings: int | None = eqx.field(static=True, default=None)
    edges: Edges | None = None
    blur: Scalar = eqx.field(converter=as_float, default=BLUR)
    shift: Float[Array, "2"] | None = None
    shadow_points: int = eqx.field(static=True, default=1)

    @classmethod
    def of(
        cls,
        scene: Scene,
        technique: ShadowMapping,
        truth: Reference,
        *,
        light: int = 0,
        arrangement: Arrangement | None = None,
        surface: Surface | None = None,
        points: int | None = None,
    ) -> "PoseProblem":
        """A problem that compares a scene under one of its lights with the light's reference.

        **Arguments:**

        - `technique`: its `map` defines how the map is drawn. It has silhouettes unless it sets them to `False`.
        - `truth`: the reference of `scene.lit_by(light)`. A traced reference is multiplied by `cone_fraction`, because
          rays ignore the cone of a spot light.
        - `light`: the index of the light in the scene.
        - `arrangement`: the start; by default `technique` with the lights and meshes of the scene.
        - `surface`: the surface that the camera sees, if no visible mesh moves. Otherwise it is drawn again at every
          step.
        - `points`: `shadow_points`; by default chosen from the width of a texel.
        """
        lit = scene.lit_by(light)
        reference = as_float(truth.visibility)
        if truth.samples:
            seen = draw_surface(scene.mesh, scene.camera) if surface is None else surface
            reference = reference * cone_fraction(lit.light, seen)
        return cls(
            arrangement=Arrangement.of(technique, scene.lights, scene.meshes) if arrangement is None else arrangement,
            scene=lit,
            index=light,
            reference=reference,
            weight=jnp.asarray(truth.mask, reference.dtype),
            settings=with_silhouettes(technique.map),
            surface=surface,
            shadow_points=points_for(lit, technique) if points is None else points,
        )

    @property
    def count(self) -> Scalar:
        """How many pixels count."""
        return jnp.sum(self.weight)

    def image(self, shadow_map: ShadowMap, surface: Surface, technique: ShadowMapping) -> Visibility:
        """The image that is compared with the reference, (h, w): visibility times the cone's fraction."""
        points = _points_of(surface, self.scene.camera, self.shadow_points)
        visibility = technique.visibility(shadow_map, points.surface)
        return _mean_over(points, visibility, shadow_map.light)

    def difference(self, subject: Arrangement) -> Float[Array, "h w"]:
        """Visibility minus reference, times the square root of the pixel's weight."""
        return self._difference(subject, *self.draw(subject))

    def difference_and_overflow(self, subject: Arrangement) -> tuple[Float[Array, "h w"], Overflow | None]:
        """The difference, and a flag that replaces an error: whether silhouettes are missing from the map."""
        shadow_map, surface = self.draw(subject, raises=False)
        return self._difference(subject, shadow_map, surface), shadow_map.overflow

    def seen(self, subject: Arrangement) -> tuple[Seen, Overflow | None]:
        """The image that a user's loss compares, and a flag that replaces an error: whether silhouettes are missing
        from the map."""
        shadow_map, surface = self.draw(subject, raises=False)
        image = self.image(shadow_map, surface, subject.technique)
        return _seen(image, self.reference, self.weight), shadow_map.overflow

    def draw(self, arrangement: Arrangement, *, raises: bool = True) -> tuple[ShadowMap, Surface]:
        """The map and the surface of an arrangement.

        **Arguments:** `raises` as for `draw_shadow_map`.
        """
        casters, light, every = _arranged(self.scene, arrangement, self.index)
        surface = draw_surface(every, self.scene.camera) if self.surface is None else self.surface
        technique, camera = arrangement.technique, self.scene.camera
        return self.draw_map(casters, light, camera, technique, surface, self.crossings, raises=raises), surface

    def planned(self) -> "PoseProblem":
        """This problem with memory for several times the silhouettes of its arrangement, and at least as much as
        before."""
        edges, camera = self.edges_of_casters(), self.scene.camera
        if edges is None:
            return self
        casters, light, every = _arranged(self.scene, self.arrangement, self.index)
        surface = self.surface
        if self.arrangement.technique.layout.needs_surface and surface is None:
            surface = draw_surface(every, camera)
        crossings = self.planned_crossings(casters, light, camera, surface, self.crossings)
        return dataclasses.replace(self, crossings=crossings, edges=edges)

    def with_memory_of(self, other: "PoseProblem") -> "PoseProblem":
        """This problem with as much memory for silhouettes as `other`."""
        return dataclasses.replace(self, crossings=other.crossings, edges=other.edges)

    def padded(self) -> "PoseProblem":
        """This problem with its meshes padded to a few sizes, so that problems of similar size share compiled
        programs."""
        own, meshes = self.scene.meshes, self.padded_meshes()
        scene = dataclasses.replace(self.scene, meshes=meshes)
        if self.edges is None:
            return dataclasses.replace(self, scene=scene)
        casts = self.scene.casts or [True] * len(own)
        sizes = lambda of: [(len(of(a)), len(of(b))) for a, b, c in zip(own, meshes, casts, strict=True) if c]
        # The indices of the casters' own vertices and faces among the padded ones.
        places = lambda of: np.flatnonzero(np.concatenate([np.arange(full) < some for some, full in sizes(of)]))
        edges = self.edges.renumbered(places(lambda mesh: mesh.vertices), places(lambda mesh: mesh.faces))
        return dataclasses.replace(self, scene=scene, edges=edges.padded(len(scene.casters.faces)))

    def _difference(self, subject: Arrangement, shadow_map: ShadowMap, surface: Surface) -> Float[Array, "h w"]:
        image = self.image(shadow_map, surface, subject.technique)
        return weighted_difference(image, self.reference, self.weight)


# These are compiled separately, so that a drawing outside of `jit` shares programs with all others.
@eqx.filter_jit
def _arranged(scene: Scene, arrangement: Arrangement, index: int) -> tuple[Mesh, AbstractLight, Mesh]:
    """The casters, the light, and all meshes, as they are arranged."""
    meshes = [pose.placed(mesh) for pose, mesh in zip(arrangement.meshes, scene.meshes, strict=True)]
    light = scene.light.at(arrangement.lights[index]).refitted(points_of(meshes))
    return dataclasses.replace(scene, meshes=meshes).casters, light, merge(meshes)


@eqx.filter_jit
def _points_of(surface: Surface, camera: AbstractCamera, count: int) -> PixelPoints:
    return points_within_pixels(surface, camera, count)


@eqx.filter_jit
def _mean_over(points: PixelPoints, visibility: Float[Array, "H w"], light: AbstractLight) -> Visibility:
    return points.mean(visibility * cone_fraction(light, points.surface))


@eqx.filter_jit
def _seen(image: Visibility, reference: Visibility, weight: Float[Array, "h w"]) -> Seen:
    return Seen.of(image, reference, weight > 0)


@eqx.filter_jit
def cone_fraction(light: AbstractLight, surface: Surface) -> Float[Array, "h w"]:
    """The fraction of the light that its cone lets through to each pixel, (h, w); 1 where there is no surface."""
    return jnp.where(surface.mask, light.cone_fraction(surface.position), 1)
