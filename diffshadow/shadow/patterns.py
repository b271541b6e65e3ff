"""Sampling patterns, the positions of taps on a disk. A pattern is a function that returns a `Pattern`."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from .._arithmetic import as_float
from .._checks import check_arguments, check_value
from .._types import HostArray
from ..settings.patterns import MAX_PATTERN_TAPS, DiskMapping, PatternSamples
from ..settings.patterns import Pattern as Settings
from ..settings.patterns import Vogel as VogelSettings

EARLY_SAMPLES = 8
"""The number of first samples that an early-out takes."""
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""In radians: the smaller part of a full turn divided by the golden ratio."""
# Squared minimum distance of Poisson-disk points, as a fraction of the area per point. Random dart throwing saturates
# near 0.7.
_TIGHTNESS = 0.6
_ROUNDS = 30
# Points in the square that sets are cut from: the minimum, and the number per sample, so that the square contains a
# disk.
_MIN_POINTS, _POINTS_A_SAMPLE = 1024, 4
_BITS = 32


class Pattern(eqx.Module):
    """A set of points in the unit disk for each pixel.

    - `offsets`: (n, p, p, 2), `n` points for each pixel of a tile of `p` by `p` pixels, which repeats over the image.
        They carry no gradient. An early-out takes the first 8, which are near the rim and in all directions.
    - `rotated`: whether each pixel rotates its set by its own angle, from interleaved gradient noise (Jimenez, "Next
        Generation Post Processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014).

    **Raises** `ValueError` if the offsets have another shape.
    """

    offsets: Float[Array, "n p p 2"]
    rotated: bool = eqx.field(static=True, default=Settings.rotated)

    def __check_init__(self):
        shape = self.offsets.shape
        if len(shape) != 4 or min(shape) < 1 or shape[1] != shape[2] or shape[3] != 2:
            raise ValueError(f"the pattern's offsets have shape {shape}; expected (n, p, p, 2), none of them 0")

    @property
    def samples(self) -> int:
        """Number of points per pixel."""
        return self.offsets.shape[0]


def interleaved_gradient_noise(shape: tuple[int, ...], first: float = 0.0) -> Float[Array, "h w"]:
    """Noise in [0, 1) for the pixels of an image of `shape` (h, w), evenly spread over any 3 x 3 pixels.

    After Jimenez (2014), as cited for `Pattern`. `first` is the value of both coordinates of the lower left pixel: 0.5
    if coordinates are at pixel centres.
    """
    height, width = shape
    x, y = (jnp.arange(size, dtype=jnp.float32) + first for size in (width, height))
    y = y[:, None]
    fraction = lambda t: t - jnp.floor(t)
    return fraction(52.9829189 * fraction(0.06711056 * x + 0.00583715 * y))


def uniform(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
) -> Pattern:
    """Uniform, independent points over the disk, with a different set for each pixel of a tile: plain Monte Carlo
    (Cook, Porter & Carpenter, "Distributed Ray Tracing", SIGGRAPH 1984).

    The error of their mean falls as n^(-1/2) for every caster. Point (u, v) of the unit square lies at radius √v and
    angle 2πu.

    **Arguments:**

    - `samples`: points of each set.
    - `pattern_size`: pixels on a side of the tile.
    - `rotated`: as in `Pattern`.

    **Raises** `ValueError` if a number is out of its range.
    """
    _check_counts(samples, pattern_size)
    points = np.random.default_rng(seed).random((pattern_size, pattern_size, samples, 2))
    return _pattern_of(to_disk(points, "polar"), rotated)


def stratified(
    samples: int | tuple[int, int] = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
) -> Pattern:
    """Stratified jittered points, with a different set for each pixel of a tile. With 4 by 8 strata it is the classic
    offset table (Uralsky, "Efficient Soft-Edged Shadows Using Pixel Shader Branching", GPU Gems 2, 2005).

    **Arguments:**

    - `samples`: (angles, rings), the strata of each set. Or the total number of strata: the grid is then as square as
        possible, and the outer rings have one more stratum if the number does not divide evenly.

    **Returns:** a pattern with one point per stratum, from the outer ring inwards. Strata have equal areas. If rings
    have more than 8 strata, the outermost point of each octant comes first. Point (u, v) of the jittered unit square
    lies at radius √v and angle 2πu.

    Other arguments, and errors, are as for `uniform`.
    """
    _check_counts(samples, pattern_size)
    angles = _angles_of_rings(samples)
    count, ring = int(angles.sum()), np.repeat(np.arange(angles.size), angles)
    # Rings are numbered inwards; the width of a ring in v is proportional to its number of strata.
    inner = 1 - np.cumsum(angles) / count
    sector = np.arange(count) - np.repeat(np.cumsum(angles) - angles, angles)
    jitter = np.random.default_rng(seed).random((pattern_size, pattern_size, count, 2))
    u = (sector + jitter[..., 0]) / angles[ring]
    v = np.maximum(inner[ring], 0) + jitter[..., 1] * angles[ring] / count
    points = to_disk(np.stack([u, v], axis=-1), "polar")
    if angles[0] > EARLY_SAMPLES:
        # Otherwise, the first samples would all be on one side of the ring.
        points = _outer_first(points)
    return Pattern(as_float(np.moveaxis(points, 2, 0)), rotated)


def _angles_of_rings(samples: int | tuple[int, int]) -> np.ndarray:
    """Strata of each ring, from the outer one inwards."""
    if not isinstance(samples, int):
        angles, rings = samples
        return np.full(rings, angles)
    rings = max(1, math.isqrt(samples))
    return samples // rings + (np.arange(rings) < samples % rings)


def vogel(
    samples: int = VogelSettings.samples,
    pattern_size: int = VogelSettings.pattern_size,
    seed: int = 0,
    rotated: bool = VogelSettings.rotated,
) -> Pattern:
    """Points along the sunflower spiral, evenly spread for any number of them (Vogel, "A Better Way to Construct the
    Sunflower Head", Mathematical Biosciences 44, 1979).

    Point i of n lies at radius √((i + ½) / n) and angle i · 2.39996 + φ, with a random φ for each pixel of a tile. By
    default the tile is one pixel, and interleaved gradient noise rotates the set.

    Arguments and errors are as for `uniform`.
    """
    _check_counts(samples, pattern_size)
    i = np.arange(samples)
    turn = 2 * np.pi * np.random.default_rng(seed).random((pattern_size, pattern_size, 1))
    radius = np.broadcast_to(np.sqrt((i + 0.5) / samples), (pattern_size, pattern_size, samples))
    return _pattern_of(_on_rays(radius, i * GOLDEN_ANGLE + turn), rotated)


def halton(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
    mapping: DiskMapping = "concentric",
) -> Pattern:
    """The first points of Halton's sequence in bases 2 and 3, scrambled independently for each pixel of a tile.

    Digits are permuted at random (Owen, "A Randomized Halton Algorithm in R", 2017). Each point is uniform, and the set
    has low discrepancy for any number of samples.

    **Arguments:** `mapping`: `"concentric"` or `"polar"`, from the square to the disk. Others are as for `uniform`.

    **Raises** `ValueError` as `uniform`, and if `mapping` is unknown.
    """
    _check_counts(samples, pattern_size)
    rng = np.random.default_rng(seed)
    from scipy.stats import qmc  # Imported here, because it is slow to load.

    sets = [qmc.Halton(2, scramble=True, rng=rng).random(samples) for _ in range(pattern_size**2)]
    points = np.reshape(sets, (pattern_size, pattern_size, samples, 2))
    return _pattern_of(to_disk(points, mapping), rotated)


def sobol(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
    mapping: DiskMapping = "concentric",
) -> Pattern:
    """The first points of Sobol's sequence in two dimensions, scrambled independently for each pixel of a tile.

    Owen scrambling (Owen, "Randomly Permuted (t, m, s)-Nets and (t, s)-Sequences", 1995) flips each bit of a coordinate
    at random, depending on the bits above it. Each point is uniform, and the set keeps its stratification. It is
    implemented by hashing (Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020). A power of two of samples
    has the lowest discrepancy.

    **Arguments:** `mapping`: `"concentric"` or `"polar"`, from the square to the disk. Others are as for `uniform`.

    **Raises** `ValueError` as `uniform`, and if `mapping` is unknown.
    """
    _check_counts(samples, pattern_size)
    rng = np.random.default_rng(seed)
    from scipy.stats import qmc  # Imported here, because it is slow to load.

    plain = qmc.Sobol(2, scramble=False, bits=_BITS).random_base2(math.ceil(math.log2(samples)))[:samples]
    seeds = rng.integers(1 << _BITS, size=(pattern_size, pattern_size, 1, 2), dtype=np.uint32)
    digits = _owen_scrambled((plain * 2.0**_BITS).astype(np.uint32), seeds)
    # Random bits below the last scrambled one.
    points = (digits + rng.random(digits.shape)) / 2.0**_BITS
    return _pattern_of(to_disk(points, mapping), rotated)


def _owen_scrambled(x: HostArray, seed: HostArray) -> HostArray:
    """32-bit fractions `x`; each bit is flipped or not depending on `seed` and the bits above it."""
    x = _reversed_bits(x) + seed
    # With bits reversed, multiplying by an even number lets a bit affect only the bits above it (Laine & Karras 2011).
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        x = x ^ (x * np.uint32(factor))
    return _reversed_bits(x)


def _reversed_bits(x: HostArray) -> HostArray:
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0x0000FFFF)):
        shift, mask = np.uint32(shift), np.uint32(mask)
        x = (x >> shift & mask) | ((x & mask) << shift)
    return x


def poisson_disk(
    samples: int = Settings.samples,
    pattern_size: int = Settings.pattern_size,
    seed: int = 0,
    rotated: bool = Settings.rotated,
) -> Pattern:
    """Random points with a minimum distance between them, with a different set for each pixel of a tile (Cook,
    "Stochastic Sampling in Computer Graphics", ACM Transactions on Graphics 5(1), 1986).

    Darts are thrown at a periodic square, and darts too close to an earlier dart are dropped. Each set consists of the
    `samples` darts nearest to a random point. Scaled to the unit disk, they are at least about 1.3 / √n apart.

    Arguments and errors are as for `uniform`.
    """
    _check_counts(samples, pattern_size)
    rng = np.random.default_rng(seed)
    darts = _throw_darts(max(_MIN_POINTS, _POINTS_A_SAMPLE * samples), rng)
    centers = rng.random((pattern_size**2, 1, 2))
    distance, nearest = map(np.asarray, KDTree(darts, boxsize=1).query(centers[:, 0], samples + 1))
    aside = darts[nearest[:, :-1]] - centers
    # The disk's rim is midway between the last point inside and the first point outside.
    radius = distance[:, -2:].mean(axis=1)[:, None, None]
    points = (aside - np.round(aside)) / radius
    return _pattern_of(points.reshape(pattern_size, pattern_size, samples, 2), rotated)


def _throw_darts(number: int, rng: np.random.Generator) -> HostArray:
    """About `number` points (n, 2) in the unit square, a minimum distance apart, also across its borders."""
    apart = np.sqrt(_TIGHTNESS / number)
    darts = np.empty((0, 2))
    for _ in range(_ROUNDS):
        thrown = rng.random((number, 2))
        if len(darts):
            thrown = thrown[KDTree(darts, boxsize=1).query(thrown)[0] >= apart]
        close = KDTree(thrown, boxsize=1).query_pairs(apart, output_type="ndarray")
        darts = np.concatenate([darts, np.delete(thrown, close.max(axis=1, initial=0), axis=0)])
    return darts


def to_disk(points: HostArray, mapping: DiskMapping) -> HostArray:
    """Maps points (..., 2) of the unit square to the unit disk.

    - `"polar"`: (u, v) goes to radius √v and angle 2πu.
    - `"concentric"`: squares around the centre become circles (Shirley & Chiu, "A Low Distortion Map Between Disk and
        Square", Journal of Graphics Tools 2(3), 1997).

    **Raises** `ValueError` if `mapping` is unknown.
    """
    check_value("the mapping to the disk", mapping, DiskMapping)
    if mapping == "polar":
        return _on_rays(np.sqrt(points[..., 1]), 2 * np.pi * points[..., 0])
    a, b = 2 * points[..., 0] - 1, 2 * points[..., 1] - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    # Avoids 0 / 0 at the centre, where the angle does not matter.
    ratio = np.where(wide, b, a) / np.where(radius == 0, 1, radius)
    angle = np.where(wide, np.pi / 4 * ratio, np.pi / 2 - np.pi / 4 * ratio)
    return _on_rays(radius, angle)


def _on_rays(radius: HostArray, angle: HostArray) -> HostArray:
    """Points (..., 2) at these polar coordinates."""
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def _check_counts(samples: int | tuple[int, int], pattern_size: int) -> None:
    """**Raises** `ValueError` if a number is out of its range, or there are too many taps in a tile."""
    for count in samples if isinstance(samples, tuple) else (samples,):
        check_value("the pattern's samples", count, PatternSamples)
    check_arguments(Settings, pattern_size=pattern_size)
    taps = math.prod(np.atleast_1d(samples).tolist()) * pattern_size**2
    if taps > MAX_PATTERN_TAPS:
        raise ValueError(
            f"the pattern has samples {samples} and pattern_size {pattern_size}, which makes {taps:,} taps per tile; "
            f"expected at most {MAX_PATTERN_TAPS:,}: lower one of them"
        )


def _pattern_of(points: HostArray, rotated: bool) -> Pattern:
    """The pattern of `points` (p, p, n, 2), a set for each pixel, ordered for an early-out."""
    return Pattern(as_float(np.moveaxis(_outer_first(points), 2, 0)), rotated)


def _outer_first(points: HostArray) -> HostArray:
    """Reorders sets (..., n, 2): first the outermost point of each of 8 sectors, then all others, inwards."""
    x, y = points[..., 0], points[..., 1]
    radius = np.hypot(x, y)
    sector = np.floor(np.arctan2(y, x) / (2 * np.pi) * EARLY_SAMPLES) % EARLY_SAMPLES
    leads = np.zeros(radius.shape, bool)
    for k in range(EARLY_SAMPLES):
        own = np.where(sector == k, radius, -1)
        outermost = np.argmax(own, axis=-1)[..., None]
        exists = np.take_along_axis(own, outermost, -1) >= 0
        np.put_along_axis(leads, outermost, np.take_along_axis(leads, outermost, -1) | exists, -1)
    # Radii are at most 1, so adding 2 puts leading points before all others.
    order = np.argsort(-(radius + 2 * leads), axis=-1, kind="stable")
    return np.take_along_axis(points, order[..., None], -2)
