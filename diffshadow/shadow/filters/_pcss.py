"""Percentage-closer soft shadows (Fernando, "Percentage-Closer Soft Shadows", SIGGRAPH 2005 sketches)."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._arithmetic import as_number, safe_sqrt
from ..._types import AsOptional, AsScalar, DepthMap, Mask, Resolution, Scalar, TexelMap, Visibility
from ...geometry import AbstractLight, View
from ...settings.filters import PercentageCloserSoft as Settings
from .._compare import AbstractCompare
from .._lookup import Lookup
from .._map import ShadowMap
from .._shader import Constant, ShaderPart, number, text_of
from ..kernels import mean_of_taps
from ..patterns import Pattern, stratified
from ._abstract import AbstractFilter
from ._random_disk import constants_of_pattern

# Up to this fraction, blockers count as none. It exceeds rounding errors.
_FEW = 1e-5


class PercentageCloserSoft(AbstractFilter):
    """The mean of bilinear taps over a disk as wide as the receiver's penumbra.

    The disk is round in the world. If texels are not square, it is an ellipse in the map. The blocker search taps the
    part of the map that can hide the light. Its radius is the light's radius, projected through the receiver onto the
    near plane: `light_size · (z_r - near) / near`. The mean depth z_b of the blockers gives the half width of the
    penumbra, `light_size · (z_r - z_b) / z_b`, which is the radius of the filter taps. For a directional light of
    angular radius a, they are `(z_r - near) tan a` and `(z_r - z_b) tan a`. Depths are distances from the light here.
    Receivers without blockers are lit.

    The search is wide. It mistakes a slanted receiver for its own blocker unless the bias follows the receiver's plane.
    Use a `ReceiverPlane`, best with `deepening=0`. A soft compare weights each blocker by the light that it blocks, and
    makes visibility differentiable with respect to bias. The mean is over window depths. A perspective light's penumbra
    is linear in window depth, so the result is the mean of the blockers' penumbrae.

    - `light_size`: overrides the light's own size, so that it can be fitted: half the angle in degrees for a
        directional light, otherwise the radius of its disk or sphere in world units. Defaults to the light's size; a
        rectangle counts as the disk of equal area.
    - `search`: pattern of the blocker search; by default stratified points. If all its taps miss a blocker, the shadow
      has a hole.
    - `pattern`: pattern of the filter taps; by default stratified points.
    - `min_radius`, `max_radius`: bounds on the penumbra's half width, in texels; `max_radius` bounds the search too.

    **Raises** `ValueError` if `min_radius` is above `max_radius`, and when called without `light_size` for a light that
    has no size.
    """

    settings: ClassVar = Settings

    light_size: AsOptional = eqx.field(converter=as_number, default=Settings.light_size)
    search: Pattern = eqx.field(default_factory=lambda: stratified(Settings.search_samples, seed=1))
    pattern: Pattern = eqx.field(default_factory=stratified)
    min_radius: AsScalar = eqx.field(converter=as_number, default=Settings.min_radius)
    max_radius: AsScalar = eqx.field(converter=as_number, default=Settings.max_radius)

    def __call__(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> Visibility:
        found = self.find_blockers(shadow_map, lookup, compare)
        some = found.some
        lit = mean_of_taps(shadow_map, lookup, compare, found.radius, self.pattern, "bilinear", active=some)
        return jnp.where(some, lit, 1)

    def shader(self) -> ShaderPart:
        constants = (
            Constant("MIN_RADIUS", number(self.min_radius), "the penumbra's least half width, in texels"),
            Constant("MAX_RADIUS", number(self.max_radius), "its greatest, in texels"),
            *constants_of_pattern(self.search, "SEARCH_"),
            *constants_of_pattern(self.pattern, ""),
        )
        files = "kernels/_taps.glsl", "_patterns.glsl", "filters/_distance.glsl", "filters/_pcss.glsl"
        return ShaderPart(constants, text_of(*files))

    def find_blockers(self, shadow_map: ShadowMap, lookup: Lookup, compare: AbstractCompare) -> "BlockerSearch":
        """The result of the blocker search."""
        penumbra = _Penumbra.of(shadow_map, lookup, self.light_size)
        x, y = (jnp.minimum(width, self.max_radius) for width in penumbra.reach)
        mean = lambda value, active: mean_of_taps(
            shadow_map, lookup, value, (x, y), self.search, "bilinear", active=active
        )
        fraction = mean(_Blocking(compare), None)
        some = fraction > _FEW
        depth = mean(_BlockingDepth(compare), some)
        blocker = jnp.where(some, depth / jnp.where(some, fraction, 1), lookup.depth)
        along_x, along_y = penumbra.half_width(blocker)
        bounded = lambda width: jnp.clip(width, self.min_radius, self.max_radius)
        return BlockerSearch(fraction, blocker, (bounded(along_x), bounded(along_y)))


class BlockerSearch(eqx.Module):
    """The result of the blocker search of percentage-closer soft shadows.

    - `fraction`: (h, w), the fraction of taps that found a blocker.
    - `depth`: (h, w), the blockers' mean window depth; the receiver's own if there are none.
    - `radius`: (h, w) each, half widths of the penumbra along the map's x and y, within the filter's bounds, in texels.
    """

    fraction: DepthMap
    depth: DepthMap
    radius: tuple[DepthMap, DepthMap]

    @property
    def some(self) -> Mask:
        """Whether there are any blockers, (h, w)."""
        return self.fraction > _FEW


class _Blocking(AbstractCompare):
    """The fraction of the light that a stored depth blocks."""

    compare: AbstractCompare

    @property
    def has_depth_derivative(self) -> bool:
        return self.compare.has_depth_derivative

    def __call__(self, stored, receiver, depth_per_texel):
        return 1 - self.compare(stored, receiver, depth_per_texel)


class _BlockingDepth(AbstractCompare):
    """A stored depth, weighted by the fraction of the light that it blocks."""

    compare: AbstractCompare

    def __call__(self, stored, receiver, depth_per_texel):
        # Empty texels are stored as a very large depth, and have weight 0.
        return (1 - self.compare(stored, receiver, depth_per_texel)) * jnp.minimum(stored, 1)


class _Penumbra(eqx.Module):
    """The width of penumbrae at the receivers, in texels along the map's x and y.

    - `view`: the view, which converts window depth to distance.
    - `resolution`: resolution of the map.
    - `texel`: (h, w, 2), positions of receivers in the map.
    - `distance`: (h, w), distance of receivers along the light's axis, in world units.
    - `light_size`: half the light's width in world units; for a directional light, at distance 1.
    """

    view: View
    resolution: Resolution = eqx.field(static=True)
    texel: TexelMap
    distance: Float[Array, "h w"]
    light_size: Scalar

    @classmethod
    def of(cls, shadow_map: ShadowMap, lookup: Lookup, light_size: Scalar | None) -> "_Penumbra":
        view = shadow_map.view.facing(lookup.layer)
        distance = view.eye_depth(jnp.clip(lookup.depth, 0, 1))
        light_size = half_width_of(shadow_map.light, light_size)
        return cls(view, shadow_map.resolution, lookup.texel, distance, light_size)

    @property
    def reach(self) -> tuple[DepthMap, DepthMap]:
        """Radius of the blocker search. Nothing beyond it can hide the light from the receiver."""
        return self._between(self.view.near)

    def half_width(self, blocker: DepthMap) -> tuple[DepthMap, DepthMap]:
        """Half width of the penumbra of a blocker at this window depth."""
        return self._between(self.view.eye_depth(jnp.clip(blocker, 0, 1)))

    def _between(self, blocker: Float[Array, "..."]) -> tuple[DepthMap, DepthMap]:
        width = jnp.maximum(self.distance - blocker, 0) * self.light_size
        if self.view.is_perspective:
            width = width / blocker
        extent = self.view.texel_extent(self.distance, self.resolution, self.texel)
        return width / extent[..., 0], width / extent[..., 1]


def half_width_of(light: AbstractLight, size: Scalar | None) -> Scalar:
    """Half the width of `light` in world units; for a directional light, at distance 1.

    **Arguments:**

    - `size`: overrides the light's own size: degrees for a directional light, otherwise world units. Without it, a
      directional light must have an `angular_radius`, and any other light a `radius` or a `size` (2,). Its rectangle
      then counts as the disk of equal area.

    **Raises** `ValueError` if `size` is left out and the light has none of these.
    """
    if size is None:
        size = getattr(light, "angular_radius" if light.is_directional else "radius", None)
    if size is not None:
        return jnp.tan(jnp.deg2rad(size)) if light.is_directional else size
    sides = getattr(light, "size", None)
    if sides is None:
        raise ValueError(f"{type(light).__name__} has no radius; set the light's radius or pass light_size")
    return safe_sqrt(jnp.prod(sides) / jnp.pi)
