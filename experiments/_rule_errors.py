"""Errors of many biases in one scene, for each filter."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import _common as common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy import ndimage

from diffshadow import fit, raster, reference, shadow
from diffshadow.config.framing._texels import texels_across

CONSTANT = (0.0, 1.0, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0)
SLOPE = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
OFFSET = (0.0, 0.5, 1.0, 2.0)
"""The biases that are tried, in texels: all combinations."""
LITTLE_CONSTANT, LITTLE_SLOPE = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0), (0.0, 0.5, 1.0, 2.0, 3.0)
"""The biases of filters that take no compares one by one."""

PLANE = ", with a receiver plane"
"""What the names of filters end with that have a bias from the receiver's plane."""
ACNE = 1e-3
"""A scene has acne or leaks if more than this part of the light is wrongly missing, or wrongly there."""
# An error that nobody sees: ratios of smaller ones say nothing.
_NEGLIGIBLE = 2e-3
TAPS = 16


def ratio(error: np.ndarray, best: np.ndarray) -> np.ndarray:
    """An error over the best one."""
    return (error + _NEGLIGIBLE) / (best + _NEGLIGIBLE)


class Filtered(NamedTuple):
    """A filter, and half the width of its kernel in texels."""

    filter: shadow.AbstractFilter
    reach: float


FILTERS: dict[str, Filtered] = {
    "nearest": Filtered(shadow.Nearest(), 0.0),
    "bilinear": Filtered(shadow.Bilinear(), 0.5),
    "pcf, radius 1.5": Filtered(shadow.PercentageCloser(1.5), 1.5),
    "pcf, radius 2.5": Filtered(shadow.PercentageCloser(2.5), 2.5),
    "random_disk, radius 2": Filtered(shadow.RandomDisk(2.0, shadow.vogel(TAPS)), 2.5),
    "random_disk, radius 4": Filtered(shadow.RandomDisk(4.0, shadow.vogel(TAPS)), 4.5),
    "random_disk, radius 8": Filtered(shadow.RandomDisk(8.0, shadow.vogel(TAPS)), 8.5),
}
"""Taps of a disk are bilinear, and reach half a texel further."""
LITTLE: dict[str, Filtered] = {
    "vsm, radius 2.5": Filtered(shadow.VarianceShadowMap(2.5), 3.0),
    "esm, radius 2.5": Filtered(shadow.ExponentialShadowMap(2.5), 3.0),
    "evsm, radius 2.5": Filtered(shadow.ExponentialVarianceShadowMap(2.5), 3.0),
    "msm, radius 2.5": Filtered(shadow.MomentShadowMap(2.5), 3.0),
    "pcss": Filtered(shadow.PercentageCloserSoft(search=shadow.vogel(TAPS), pattern=shadow.vogel(TAPS)), 2.5),
}
"""Filters that take no compares one by one, or whose width depends on the scene."""
WITH_PLANE = ("pcf, radius 2.5", "random_disk, radius 4", "random_disk, radius 8")
"""The filters that are also measured with the bias from the receiver's plane."""


_PATHS = ("bias.constant.value", "bias.slope.value", "bias.normal_offset.value")


class Seen(eqx.Module):
    """The truth of a scene: (h, w).

    - `inside`: the pixels that count; `lit`, `dark`: those that are wholly lit or dark, out of a kernel's reach of
      others.
    """

    truth: jax.Array
    inside: jax.Array
    lit: jax.Array
    dark: jax.Array


def measure(settings: Any) -> dict[str, np.ndarray]:
    """Errors of all biases in one scene, by names of filters.

    **Returns** arrays (biases, 3) of the root mean square error, the share of the light that is wrongly missing (acne)
    and the share that is wrongly there (leaks), each beyond a kernel's reach of a shadow's outline. Biases are in the
    order of `grid_of`. `scene` has the numbers that describe the scene, in the order of `DESCRIBED`.
    """
    case = common.draw(settings)
    plain, shadow_map, covered = plain_map(case)
    pixels = pixels_per_texel(plain, shadow_map, case)
    at = shadow.receiver(shadow_map, case.surface)
    found: dict[str, np.ndarray] = {}
    for name, (chosen, reach) in FILTERS.items():
        seen = seen_by(case.truth, covered, reach * pixels)
        found[name] = grid_errors(technique(chosen), grid_of(name), shadow_map, case.surface, seen)
        if name in WITH_PLANE:
            found[name + PLANE] = grid_errors(
                technique(chosen, plane=True), grid_of(name + PLANE), shadow_map, case.surface, seen
            )
    for name, (chosen, reach) in LITTLE.items():
        seen = seen_by(case.truth, covered, reach * pixels)
        found[name] = grid_errors(technique(chosen), grid_of(name), shadow_map, case.surface, seen)
    found["scene"] = described(case, at, covered, pixels)
    return {name: np.asarray(values, np.float32) for name, values in found.items()}


def plain_map(case: common.Case) -> tuple[shadow.ShadowMapping, shadow.ShadowMap, np.ndarray]:
    """The plain map of a scene, as its configuration sets it, the technique that draws it, and the pixels that count,
    (h, w)."""
    made = shadow.MapSettings(case.settings.shadow_map.resolution)
    plain = shadow.ShadowMapping(shadow.Nearest(), shadow.Bias(), map=made)
    shadow_map = plain.prepare(case.scene, case.surface)
    return plain, shadow_map, np.asarray(plain.covered(shadow_map, case.surface)) & case.truth.mask


def grid_of(name: str) -> np.ndarray:
    """The biases that are tried, (n, 3): constant, slope and normal offset."""
    if name in LITTLE:
        return np.array([(c, s, 0.0) for c in LITTLE_CONSTANT for s in LITTLE_SLOPE], np.float32)
    has_plane = name.endswith(PLANE)
    slopes, offsets = ((0.0,), (0.0,)) if has_plane else (SLOPE, OFFSET)
    return np.array([(c, s, n) for c in CONSTANT for s in slopes for n in offsets], np.float32)


def technique(chosen: shadow.AbstractFilter, *, plane: bool = False, profile: Any = "sine") -> shadow.ShadowMapping:
    offset = shadow.NormalOffset(0.0, profile=profile)
    bias = shadow.Bias(0.0, 0.0, offset, plane=shadow.ReceiverPlane() if plane else None)
    return shadow.ShadowMapping(chosen, bias)


@eqx.filter_jit
def _scores(technique: Any, shadow_map: Any, surface: raster.Surface, seen: Seen) -> jax.Array:
    """Root mean square error, acne and leaks."""
    return scores_of(technique.visibility(shadow_map, surface), seen)


def scores_of(visibility: jax.Array, seen: Seen) -> jax.Array:
    """Root mean square error, acne and leaks of a picture, (3,)."""
    count = jnp.maximum(jnp.sum(seen.inside), 1)
    squares = jnp.where(seen.inside, (visibility - seen.truth) ** 2, 0)
    acne, leaks = jnp.where(seen.lit, 1 - visibility, 0), jnp.where(seen.dark, visibility, 0)
    return jnp.stack([jnp.sqrt(jnp.sum(squares) / count), jnp.sum(acne) / count, jnp.sum(leaks) / count])


@eqx.filter_jit
def _grid_scores(technique: Any, paths: Any, grid: jax.Array, shadow_map: Any, surface: Any, seen: Seen) -> jax.Array:
    one = lambda numbers: _scores(fit.with_values(technique, paths, numbers), shadow_map, surface, seen)
    return lax.map(one, grid)


def grid_errors(
    technique: Any,
    grid: np.ndarray,
    shadow_map: Any,
    surface: raster.Surface,
    seen: Seen,
    paths: Sequence[str] = _PATHS,
) -> np.ndarray:
    """Root mean square error, acne and leaks, (n, 3), with each row of `grid` as the numbers at `paths`."""
    return np.asarray(_grid_scores(technique, tuple(paths), jnp.asarray(grid), shadow_map, surface, seen))


def seen_by(truth: reference.Reference, covered: np.ndarray, footprint: float) -> Seen:
    """Pixels out of a kernel's reach of others, which is `footprint` pixels on the screen."""
    width = 2 * min(max(1, math.ceil(footprint)), 24) + 1
    image = np.asarray(truth.visibility)
    near = lambda region: np.asarray(ndimage.maximum_filter(covered & ~region, size=width, mode="constant"), bool)
    within = lambda region: region & ~near(region)
    lit, dark = within(covered & (image >= 1 - 1e-6)), within(covered & (image <= 1e-6))
    return Seen(jnp.asarray(image), *(jnp.asarray(each) for each in (covered, lit, dark)))


def pixels_per_texel(plain: shadow.ShadowMapping, shadow_map: Any, case: common.Case) -> float:
    """How long nearly all texels are at most on the screen."""
    extents = plain.aliasing(shadow_map, case.surface, case.scene.camera)
    mask = np.asarray(extents.mask)
    return float(np.quantile(np.asarray(extents.extent)[mask], 0.9)) if mask.any() else 1.0


# --- What a scene is like ---

DESCRIBED = ("texels", "pixels_per_texel", "steepness", "elevation", "lit", "perspective", "across", "thin")
"""A map's side; how long a texel is on the screen; the median slope of receivers against the light; the light's height
in degrees; the share of pixels that are lit; whether the light has a position; how many texels a typical caster has
across; the share of casters with less than ten."""
FEW = 10.0


def described(case: common.Case, at: shadow.Receiver, covered: np.ndarray, pixels: float) -> np.ndarray:
    image = np.asarray(case.truth.visibility)
    cosine = np.clip(np.asarray(at.cosine)[covered & (image > 0)], 1e-3, 1)
    steepness = float(np.median(np.sqrt(1 / cosine**2 - 1))) if cosine.size else 0.0
    elevation = float(getattr(case.settings.scene.light, "elevation", None) or 90.0)
    texels, lit = case.settings.shadow_map.resolution[0], float(np.mean(image[covered] > 0.5))
    perspective = 0.0 if case.scene.light.is_directional else 1.0
    each = texels_across(case.settings)
    across, thin = (float(np.median(each)), float(np.mean(each < FEW))) if len(each) else (1e6, 0.0)
    return np.array([texels, pixels, steepness, elevation, lit, perspective, across, thin])
