"""Common code of the engines' shadows."""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._arithmetic import as_float, concrete, dot, normalize
from ..._checks import check_instance, check_value
from ..._types import Mask, Resolution, Scalar
from ...geometry import (
    WORLD,
    AbstractLight,
    Origin,
    PointLight,
    Scene,
    View,
)
from ...raster import Surface
from ...settings import maps
from ...settings.engines import Engine, Side
from .._compare import AbstractCompare, HardCompare
from .._technique import AbstractTechnique
from ._cameras import EngineCameras, quarter_of
from ._convert import LightFrame, PlainBias, light_frame
from ._engine_map import Casters, EngineMap, map_of, per_face
from ._light import EngineLight
from ._taps import Compared


class Place(eqx.Module):
    """The positions of receivers in the light's window.

    - `u`, `v`, `z`: (h, w), window coordinates from 0 to 1; z is the depth. u increases to the left if the map is
      mirrored.
    - `ahead`: (h, w), whether receivers are in front of the light. Elsewhere, the other fields are meaningless.
    - `depth_per_texel`: (h, w), window depth per width of a texel, the unit of a soft compare.
    """

    u: Float[Array, "h w"]
    v: Float[Array, "h w"]
    z: Float[Array, "h w"]
    ahead: Bool[Array, "h w"]
    depth_per_texel: Float[Array, "h w"]

    @classmethod
    def of(
        cls, points: Float[Array, "h w 3"], view: View, resolution: Resolution, is_mirrored: bool = False
    ) -> "Place":
        """The window positions of `points` (h, w, 3), world units."""
        clip = view.clip(points)
        ahead = clip[..., 3] > 0
        w = jnp.where(ahead, clip[..., 3], 1)
        across = -0.5 if is_mirrored else 0.5
        u, v, z = (clip[..., k] / w * half + 0.5 for k, half in enumerate((across, 0.5, 0.5)))
        distance = jnp.maximum(view.distance(points), view.near) if view.is_perspective else view.distance(points)
        per_texel = view.texel_size(distance, resolution) * view.depth_slope(distance)
        return cls(u, v, z, ahead, per_texel)

    @property
    def in_window(self) -> Bool[Array, "h w"]:
        """Whether u and v are from 0 to 1, for receivers in front of the light."""
        return self.ahead & (self.u >= 0) & (self.u <= 1) & (self.v >= 0) & (self.v <= 1)


class AbstractEngineShadows(AbstractTechnique):
    """Shadows as in a real-time engine.

    - `compare`: how depths are compared; the hard compare is the engine's own.
    - `resolution`: resolution of the map, (height, width) in texels.
    - `has_layers`: whether cascades are separate layers instead of parts of one texture.
    - `subpixels`: steps per texel. The engine's rasterizer places vertices at whole steps. Most graphics hardware has
      256, and Chromium's software rasterizer 16.
    """

    compare: eqx.AbstractVar[AbstractCompare]
    resolution: eqx.AbstractVar[Resolution]
    subpixels: eqx.AbstractVar[int]
    has_layers: ClassVar[bool] = False
    settings: ClassVar[type[Engine]]  # pyright: ignore[reportIncompatibleVariableOverride]

    def _check_rules(self):
        check_value(f"{type(self).__name__}.resolution", self.resolution, maps.ShadowMap.each()["resolution"])
        if self.settings.has_square_maps and self.resolution[0] != self.resolution[1]:
            raise ValueError(f"{type(self).__name__}.resolution is {self.resolution}; expected a square map")
        check_instance("the compare", self.compare, AbstractCompare, "a compare, such as HardCompare()")

    def lays_out(self, name: str) -> bool:
        """Whether the number at the dotted path `name` changes the map."""
        return False

    def compared(self, receiver: Array, per_texel: Array, is_strict: bool = False) -> Compared:
        """The result of the compare of a stored value with the `receiver`'s value.

        The hard compare is the engine's own: equal values are lit, or shadowed if `is_strict`. `per_texel` is the unit
        of a soft compare.
        """
        compare = self.compare
        if isinstance(compare, HardCompare):
            compare = HardCompare("less" if is_strict else "less_equal")
        return lambda stored: compare(stored, receiver, per_texel)

    def casters(self, scene: Scene) -> Casters:
        """The geometry that is drawn into the map of a light of `scene`."""
        return Casters.of(scene.meshes, self.casting_sides(scene))

    def drawn(
        self,
        scene: Scene,
        light: AbstractLight,
        sides: Sequence[Side | None],
        offset: Sequence[float],
        is_mirrored: bool = False,
        push: Scalar | float = 0.0,
    ) -> EngineMap:
        """The map of `light`.

        **Arguments:**

        - `light`: the result of `engine_light`.
        - `sides`: for each mesh, the faces that cast; the result of `casting_sides`.
        - `offset`: for each mesh, the factor of its normal bias.
        - `is_mirrored`, `push`: see `map_of`.
        """
        depth = map_of(Casters.of(scene.meshes, sides), light, self.resolution, self.subpixels, is_mirrored, push)
        return self.with_depth(depth, scene, light, offset)

    @abc.abstractmethod
    def from_map(self, stored: Any, scene: Scene) -> EngineMap:
        """The result of `prepare`, with the engine's map instead of this package's.

        **Arguments:**

        - `stored`: (h, w), the content of the engine's map, as read back, with its bottom row first; for a point light
          (6, h, w), its faces in OpenGL's order.
        - `scene`: the scene with the engine's light and meshes. The meshes define which surfaces receive shadows.

        The settings must be the ones that the map was drawn with, because their effect on depths is undone. The state
        can then be used with other biases and radii.

        **Raises** `ValueError` for another shape, for numbers that a map cannot contain, and the errors of `prepare`.
        """

    def with_depth(
        self, depth: Float[Array, "*l h w"], scene: Scene, light: AbstractLight, offset: Sequence[float]
    ) -> EngineMap:
        """The map that stores `depth`. The other arguments are as for `drawn`."""
        receives = [True] * len(scene.meshes) if scene.receives is None else scene.receives
        return EngineMap(depth, light, per_face(offset, scene), per_face(receives, scene))

    def checked_map(self, stored: Any, light: AbstractLight, *, is_depth: bool) -> Float[Array, "*l h w"]:
        """`stored` as an array.

        **Raises** `ValueError` unless it has the shape of a map of `light`, with finite numbers, from 0 to 1 if it
        `is_depth`.
        """
        found = as_float(stored)
        layers = light.count if isinstance(light, EngineCameras) and self.has_layers else 1
        expected = (6, *self.resolution) if isinstance(light, PointLight) else self.resolution
        expected = expected if layers == 1 else (layers, *self.resolution)
        if found.shape != expected:
            raise ValueError(
                f"the engine's map has shape {found.shape}; expected {expected}, by the light and the technique's "
                "resolution: read one channel, and set the resolution"
            )
        known = concrete(found)
        if known is not None:
            least, most = float(known.min()), float(known.max())
            if not np.isfinite([least, most]).all() or (is_depth and not (least >= 0 and most <= 1)):
                expected = "depths from 0 to 1" if is_depth else "finite numbers"
                raise ValueError(
                    f"the engine's map has values from {least:.6g} to {most:.6g}; expected {expected}: read floats"
                )
        return found

    # --- Its settings in other units ---

    def cameras_of(self, scene: Scene) -> AbstractLight:
        """The light of `scene` with the cameras that the engine gives it."""
        return scene.light

    def frame(self, scene: Scene, distance: float) -> LightFrame:
        """The engine's camera for the light of `scene`, with values at the `distance` along its axis, in world units.
        If there are several cascades, the value is for the first cascade.

        **Raises** the errors of `light_frame` and `cameras_of`.
        """
        light = self.cameras_of(scene)
        count = light.count if isinstance(light, EngineCameras) and not self.has_layers else 1
        return light_frame(light, quarter_of(self.resolution, count), distance)

    def bounds(self, lights: Sequence[tuple[LightFrame, float]]) -> dict[str, tuple[float, float, float]]:
        """For each fitted number of the engine's shadows: its start, its lower and its upper bound.

        **Arguments:**

        - `lights`: for each light, its camera, and the distance of its receivers along the axis, in world units.
        """
        raise NotImplementedError

    def as_wide(self, radius: float, frame: LightFrame) -> "AbstractEngineShadows":
        """The same shadows with the engine's filter whose width is closest to a disk with a radius of `radius`
        texels."""
        settings = self.settings
        names = settings.point_filters if frame.kind == "point" else settings.filters
        every = [dataclasses.replace(self, **{settings.filter_key: name}) for name in names]
        width = lambda each: each.plain(frame, 1.0).radius
        return min((each for each in every if width(each) is not None), key=lambda each: abs(width(each) - radius))

    @abc.abstractmethod
    def plain(self, frame: LightFrame, distance: float) -> PlainBias:
        """The bias and the filter without an engine's unit; arguments are as for `frame`."""

    @abc.abstractmethod
    def biased(self, frame: LightFrame, shift: float, offset: float, distance: float) -> "AbstractEngineShadows":
        """The same shadows with engine biases that equal a `shift` towards the light and an `offset` along normals,
        both in world units. Other arguments are as for `frame`.

        **Raises** `ValueError` if the engine has no such bias.
        """

    @abc.abstractmethod
    def code(self, given: EngineLight, distances: tuple[float, float], origin: Origin = WORLD) -> list[str]:
        """Lines of code in the engine's language that set it; arguments are as for `engine_code`."""

    def covered(self, state: EngineMap, surface: Surface) -> Mask:
        """Pixels that the engine's shadow determines, (h, w). They see a receiver within the light's frustum, on a face
        towards the light. Faces away from the light are dark in the engine's picture, with or without shadow."""
        return _covered(state, surface)


@eqx.filter_jit
def _covered(state: EngineMap, surface: Surface) -> Mask:
    _, receives = state.of_pixels(surface)
    turned = dot(surface.normal, normalize(state.light.towards(surface.position))) > 0
    return receives & turned & within(state, surface)


def within(state: EngineMap, surface: Surface) -> Mask:
    """Pixels whose surface is within the light's frustum, (h, w)."""
    if isinstance(state.light, PointLight):
        along = jnp.max(jnp.abs(surface.position - state.light.position), axis=-1)
        return (along >= state.light.near) & (along <= state.light.far)
    view = state.light.view().facing(state.light.layer(surface.position))
    place = Place.of(surface.position, view, state.resolution)
    inside = place.in_window & (place.z >= 0) & (place.z <= 1)
    return inside & state.light.is_shadowed(surface.position) if isinstance(state.light, EngineCameras) else inside
