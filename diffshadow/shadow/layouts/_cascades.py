"""Cascaded shadow maps (Engel, "Cascaded Shadow Maps", ShaderX5, 2006), also called parallel-split shadow maps (Zhang,
Sun, Xu & Lun, "Parallel-split shadow maps for large-scale virtual environments", VRCIA 2006)."""

import math
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_float, as_number, as_numbers, concrete
from ..._types import AsOptional, AsOptionalScalars, AsScalar, Resolution, Scalar
from ..._words import counted
from ...geometry import AbstractCamera, AbstractLight, View
from ...raster import SUBPIXELS, Surface
from ...settings.quantities import MAX_TEXELS
from ...settings.techniques import CascadeFit, CascadeSelection, DepthRange
from ...settings.techniques import Cascades as Settings
from .._shader import Constant, ShaderPart, number, numbers, text_of
from ._abstract import Choice
from ._cascaded_light import MIN_BLEND, CascadedLight
from ._figures import LayerFigure, MapFigure
from ._fitted import AbstractFittedLayout, check_depths, margin_of
from ._frustum import ViewFrustum, depths_of

# The minimum size of a cascade, as a fraction of the light's own map, for slices that see no part of this map.
_MIN_SIZE = 1e-3
# Relative rounding error of shares: a thousandth of a texel in the largest maps.
_ROUNDING = 1e-6


class Cascades(AbstractFittedLayout):
    """Cascades for a directional light. The camera's view is split by depth into slices, and each slice has its own
    layer of the shadow map.

    Maps near the camera show a smaller region, in smaller texels. With a camera's depths from n to f and λ =
    `logarithmic`, slice i of N ends at `λ n (f/n)^(i/N) + (1 - λ) (n + (f - n) i/N)` (the practical split scheme of
    Zhang et al. 2006). Logarithmic slices give all cascades the same worst aliasing. Uniform slices suit scenes with
    little near the camera.

    - `count`: the number of cascades.
    - `logarithmic`: λ, from 0 for slices of equal depth to 1 for slices with equal ratios of depths.
    - `distances`: the end of each slice along the camera's axis, in world units; instead of `count` and `logarithmic`.
        The last distance is the shadow distance.
    - `shares`: for each cascade a number greater than 0, its number of texels relative to the other cascades. A map of
      R² texels for each of N cascades has N R² texels in total. The side of cascade i is `R sqrt(N share_i / Σ share)`,
      rounded down. All layers have the size of the largest cascade. Smaller cascades fill the lower left square of
      their layer. By default, all cascades fill their layers. A map with shares is square, and has no silhouettes.
    - `max_share`: the greatest fraction of all texels that a cascade may get, in (0, 1], for which memory is reserved;
        defaults to the largest of `shares`.
    - `depths`: the depths n and f that are split. `"camera"`: the camera's near and far. `"surface"`: the minimum and
      maximum depth of the visible surface (sample distribution shadow maps, Lauritzen, Salvi & Lefohn 2011).
    - `shadow_distance`: the depth, in world units, beyond which nothing is shadowed; by default f.
    - `fit`: the content of each cascade. `"cascade"`: its slice. `"scene"`: everything up to the end of the slice. This
      spends texels on surfaces that finer cascades already show.
    - `stabilize`: whether texels stay in place on the scene's surfaces when the camera moves. Each cascade then
      contains the smallest sphere around its slice. The size of the sphere does not change when the camera turns, and
      the cascade moves by whole texels. Otherwise it contains the box of its slice, clipped to the light's own map.
      Texels stay in place only if slices do: with `depths="camera"`, and a camera with constant near and far.
    - `select`: the cascade in which a receiver is looked up. `"interval"`: by its depth. `"map"`: the first cascade
        whose map contains the receiver, which uses more of the finer maps.
    - `blend`: the fraction of a slice, at its end, over which its cascade fades into the next; 0 for a sharp change.
        With `select="map"`, the fraction of the map's half width, at its border.
    - `max_blend`: the greatest `blend` that a fit may reach, for which maps reserve space; defaults to `blend`.
    - `fade`: the fraction of the last slice, at its end, over which shadows fade out if there is a shadow distance.
    - `margin`: the margin of the maps beyond their slices, in texels, so that filters read no texels beyond the border:
      at least the maximum radius of the filter, plus half a texel if its look-ups are bilinear, plus any normal offset.

    **Raises** `ValueError` for distances that do not increase.
    """

    settings: ClassVar = Settings

    count: int = eqx.field(static=True, default=Settings.count)
    logarithmic: AsScalar = eqx.field(converter=as_number, default=Settings.logarithmic)
    distances: AsOptionalScalars = eqx.field(converter=as_numbers, default=Settings.distances, kw_only=True)
    shares: AsOptionalScalars = eqx.field(converter=as_numbers, default=Settings.shares, kw_only=True)
    max_share: float | Any = eqx.field(static=True, default=None, kw_only=True)
    depths: DepthRange = eqx.field(static=True, default=Settings.depths, kw_only=True)
    shadow_distance: AsOptional = eqx.field(converter=as_number, default=Settings.shadow_distance, kw_only=True)
    fit: CascadeFit = eqx.field(static=True, default=Settings.fit, kw_only=True)
    stabilize: bool = eqx.field(static=True, default=Settings.stabilize, kw_only=True)
    select: CascadeSelection = eqx.field(static=True, default=Settings.select, kw_only=True)
    blend: AsScalar = eqx.field(converter=as_number, default=Settings.blend, kw_only=True)
    max_blend: float | Any = eqx.field(static=True, default=Settings.max_blend, kw_only=True)
    fade: float = eqx.field(static=True, default=Settings.fade, kw_only=True)
    margin: float = eqx.field(static=True, converter=margin_of, default=Settings.margin, kw_only=True)

    def __post_init__(self):
        distances, shares, blend = as_numbers(self.distances), as_numbers(self.shares), as_number(self.blend)
        self.count = len(distances) if isinstance(distances, tuple) else self.count
        if self.max_share is None:
            self.max_share = _greatest(shares)
        if self.max_blend is None:
            self.max_blend = float(blend) if eqx.is_array(blend) and blend.ndim == 0 else 1.0

    def _check_rules(self):
        if self.distances is not None:
            self._check_distances(self.distances)
        if self.shares is not None:
            self._check_shares(self.shares)

    def _check_distances(self, distances: tuple[Scalar, ...]) -> None:
        if self.shadow_distance is not None or self.depths != "camera":
            raise ValueError(
                f"the cascades have distances, and also shadow_distance = {self.shadow_distance} or depths = "
                f"{self.depths!r}; expected the last distance as the shadow distance: remove the others"
            )
        known = [concrete(each) for each in distances]
        if not any(each is None for each in known) and not (np.diff(np.array(known, float)) > 0).all():
            raise ValueError(
                f"the cascades' distances are {[float(each) for each in distances]}; expected each to be greater than "
                "the one before: sort them, and remove duplicates"
            )

    def _check_shares(self, shares: tuple[Scalar, ...]) -> None:
        known = [concrete(each) for each in shares]
        given = None if any(each is None for each in known) else np.array(known, float)
        if len(shares) != self.count:
            raise ValueError(
                f"the cascades have {counted(len(shares), 'share')}, and their count is {self.count}; expected the "
                "same number: give one share for each cascade"
            )
        if not 0 < self.max_share <= 1:
            raise ValueError(f"the cascades' max_share is {self.max_share}; expected more than 0, and at most 1")
        if given is None:
            return
        greatest = given.max() / given.sum()
        if greatest > self.max_share * (1 + _ROUNDING):
            raise ValueError(
                f"the cascades' shares are {given.tolist()}, the greatest {greatest:.3g} of all texels, and max_share "
                f"is {self.max_share:.3g}; expected at most that: lower the share, or raise max_share"
            )

    @property
    def differentiable(self) -> tuple[str, ...]:
        return ("blend",)

    def layer_resolution(self, resolution: Resolution) -> Resolution:
        """(height, width) of a layer in texels. With shares, it is as large as the largest cascade that `max_share`
        allows.

        **Raises** `ValueError` for shares of a map that is not square, or for a layer that is too large to draw.
        """
        if self.shares is None:
            return resolution
        if resolution[0] != resolution[1]:
            raise ValueError(
                f"the cascades have shares, and maps of {resolution} texels, (height, width); expected square maps: "
                "make height and width equal, or leave shares out"
            )
        side = _side(resolution[0], self.count * self.max_share)
        if side > MAX_TEXELS:
            raise ValueError(
                f"the cascades' max_share is {self.max_share:.3g}: if {self.count} maps have {resolution[0]}² texels "
                f"on average, the largest has {side}²; expected at most {MAX_TEXELS}²: lower the resolution, or the "
                "greatest share"
            )
        return side, side

    def sides(self, resolution: Resolution) -> Int[Array, "l 2"]:
        """Width and height of each cascade in texels, (count, 2), for a map of `resolution`."""
        height, width = self.layer_resolution(resolution)
        if self.shares is None:
            return jnp.broadcast_to(jnp.array([width, height], jnp.int32), (self.count, 2))
        shares = jnp.stack(self.shares)
        sides = jnp.minimum(_side(resolution[0], self.count * shares / jnp.sum(shares)), width)
        return jnp.stack([sides, sides], axis=-1)

    def _least_resolution(self, resolution: Resolution) -> Resolution:
        """(height, width) of the smallest cascade, or `resolution` if shares are not known yet."""
        sides = None if self.shares is None else concrete(self.sides(resolution))
        return resolution if sides is None else (int(sides.min()), int(sides.min()))

    def splits(self, near: Scalar, far: Scalar) -> Float[Array, " k"]:
        """The boundaries of the slices of depths from `near` to `far`, (count + 1,), in world units."""
        if self.distances is not None:
            return jnp.stack([near, *self.distances])
        fraction = np.arange(1, self.count) / self.count
        uniform = near + (far - near) * fraction
        # Only where it matters, because an orthographic camera's near may be negative.
        ratio = jnp.where(self.logarithmic > 0, far / jnp.where(self.logarithmic > 0, near, 1), 1)
        between = uniform + self.logarithmic * (near * ratio**fraction - uniform)
        return jnp.concatenate([near[None], between, far[None]])

    @property
    def needs_surface(self) -> bool:
        return self.depths == "surface"

    def light(
        self,
        light: AbstractLight,
        camera: AbstractCamera,
        resolution: Resolution,
        surface: Surface | None = None,
    ) -> CascadedLight:
        """`light` with the views of the cascades; see `AbstractLayout.light`.

        The views follow the light's direction, but the placement of the cascades has no gradient with respect to it.

        **Raises** `ValueError` for a light that is not directional, a map too small for the margin, a shadow distance
        beyond the camera's far plane, or distances outside of the camera's range; for logarithmic slices of a camera
        whose near distance is not positive; and for the errors of `layer_resolution`.
        """
        self.check(light, camera, self._least_resolution(resolution), surface)
        if self.distances is not None:
            check_depths("distances are", self.distances, camera)
        near, share = concrete(camera.near), concrete(self.logarithmic)
        starts_at_near = self.distances is None and self.depths == "camera"
        if starts_at_near and near is not None and not near > 0 and share is not None and share > 0:
            raise ValueError(
                f"the cascades' logarithmic is {float(share):g}, and the camera's near is {float(near):g}; expected a "
                "positive near for logarithmic slices: set logarithmic to 0, or move the camera's near"
            )
        return _cascaded_light(self, light, camera, resolution, surface if self.needs_surface else None)

    def choose(self, light: AbstractLight, points: Float[Array, "h w 3"]) -> Choice:
        assert isinstance(light, CascadedLight)
        return light.choose(points, None if self.max_blend == 0 else self.blend, self.fade if self._ends else None)

    def shader(self, light: AbstractLight) -> ShaderPart:
        assert isinstance(light, CascadedLight)
        begins = jnp.concatenate([light.begins[:1], light.ends[:-1]])
        sides = jnp.zeros(light.count) if light.sides is None else light.sides
        fade = max(self.fade, _ROUNDING) * number(light.ends[-1] - begins[-1])
        constants = (
            Constant("BEGINS", numbers(begins), "of each cascade's slice, distance along the camera's axis"),
            Constant("ENDS", numbers(light.ends), "of each slice; both change with the camera's near and far"),
            Constant("SIDES", numbers(sides), "of each cascade in texels; 0 where it fills its layer"),
            Constant("CASCADE_MARGIN", float(self.margin), "within which a cascade is not selected by map, in texels"),
            Constant("SELECTS_BY_MAP", light.select == "map", "whether the first cascade that contains a point is its"),
            Constant("BLENDS", self.max_blend != 0, "whether a cascade fades into the next"),
            Constant("BLEND", max(number(self.blend), MIN_BLEND), "over which part of a slice, or of a half width"),
            Constant("ENDS_SHADOWS", self._ends, "whether there are no shadows beyond the last slice"),
            Constant("FADE", fade, "over which depth shadows fade out there, in world units"),
        )
        return ShaderPart(constants, text_of("layouts/_cascades.glsl"))

    @property
    def _ends(self) -> bool:
        """Whether there are no shadows beyond the last slice."""
        return self.shadow_distance is not None or self.distances is not None

    def remarks(self, light: AbstractLight) -> tuple[str, ...]:
        """Remarks that stabilized cascades are not stable, if their slices move."""
        if not (self.stabilize and self.depths == "surface"):
            return ()
        return (
            "has cascades that are not stable, although stabilize is true: with depths = surface, slices follow the "
            "camera's view, so cascades change size and texels move on surfaces when the camera moves; set depths to "
            "camera for stable cascades, or stabilize to false for finer texels",
        )

    def map_figure(self, light: AbstractLight) -> MapFigure:
        assert isinstance(light, CascadedLight)
        return MapFigure("Cascades", light.names, light.count)

    def layer_figure(self, light: AbstractLight, surface: Surface) -> LayerFigure:
        assert isinstance(light, CascadedLight)
        layer, other, weight, strength = self.choose(light, surface.position)
        assert layer is not None
        return LayerFigure(
            "cascades",
            "Cascades",
            "depths along the camera's axis, in world units",
            {i: f"{i + 1}: {name}" for i, name in enumerate(light.names)},
            layer,
            other,
            weight,
            None,
            surface.mask if strength is None else surface.mask & (strength > 0),
        )


@eqx.filter_jit
def _cascaded_light(
    layout: Cascades,
    light: AbstractLight,
    camera: AbstractCamera,
    resolution: Resolution,
    surface: Surface | None,
) -> CascadedLight:
    # A map's texels have no derivative with respect to its position.
    from_camera, from_light = camera.view(), lax.stop_gradient(light.view())
    near, far = depths_of(from_camera, surface, layout.shadow_distance)
    splits = layout.splits(near, far)
    lengths = splits[1:] - splits[:-1]
    ends = splits[1:]
    begins = jnp.concatenate([splits[:1], ends[:-1] - layout.max_blend * lengths[:-1]])
    # Always data, with or without shares, so that both are computed in the same way.
    sides = lax.optimization_barrier(layout.sides(resolution))
    texels, frustum = as_float(sides), ViewFrustum.of(from_camera)
    firsts = jnp.broadcast_to(splits[0], ends.shape) if layout.fit == "scene" else begins
    if layout.stabilize:
        scale, offset = _around_spheres(from_light, *frustum.spheres(firsts, ends), texels, layout.margin)
        steps = texels * (SUBPIXELS / 2)
    else:
        corners = jnp.concatenate([frustum.corners_at(firsts), frustum.corners_at(ends)], axis=1)
        scale, offset, steps = *_around_points(from_light, corners, texels, layout.margin), None
    margin, own_sides = 2 * layout.margin / texels, None if layout.shares is None else sides[:, 0]
    return CascadedLight(light, from_camera, begins, ends, scale, offset, margin, layout.select, steps, own_sides)


def _greatest(shares: Any) -> float:
    """The largest fraction of all texels that one of `shares` takes; 1 if shares are invalid or missing."""
    numbers = [share for share in shares or () if eqx.is_array(share)]
    return float(max(numbers)) / (float(sum(numbers)) or 1.0) if numbers else 1.0


def _side(resolution: int, part: Any) -> Any:
    """The side of a square of `part` times `resolution`² texels, rounded down. A whole side stays whole despite
    rounding errors of `part`."""
    if isinstance(part, float):
        return math.floor(resolution * math.sqrt(part) * (1 + _ROUNDING))
    return jnp.floor(resolution * jnp.sqrt(part) * (1 + _ROUNDING)).astype(jnp.int32)


def _around_spheres(
    light: View, centre: Float[Array, "l 3"], radius: Float[Array, " l"], texels: Float[Array, "l 2"], margin: float
) -> tuple[Float[Array, "l 2"], Float[Array, "l 2"]]:
    """Scale and offset of windows around spheres. The windows move by whole texels."""
    per_unit = jnp.stack([light.eye_to_clip[0, 0], light.eye_to_clip[1, 1]])
    # One texel more than the sphere, because its centre may be half a texel from the window's.
    width = 2 * radius[:, None] * per_unit * (texels / (texels - 1 - 2 * margin))
    moved = jnp.round(light.clip(centre)[:, :2] * texels / width)
    return 2 / width, -2 * moved / texels


def _around_points(
    light: View, points: Float[Array, "l k 3"], texels: Float[Array, "l 2"], margin: float
) -> tuple[Float[Array, "l 2"], Float[Array, "l 2"]]:
    """Scale and offset of windows around points, within the light's own window."""
    at = light.clip(points)[..., :2]
    low, high = at.min(axis=1), at.max(axis=1)
    beyond = (high - low) * (margin / (texels - 2 * margin))
    low, high = jnp.clip(low - beyond, -1, 1), jnp.clip(high + beyond, -1, 1)
    half = jnp.maximum((high - low) / 2, _MIN_SIZE)
    return 1 / half, -(low + high) / 2 / half
