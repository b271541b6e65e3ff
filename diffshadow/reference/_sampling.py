"""Samples of a light: the points that each pixel's shadow rays are aimed at."""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from .._checks import check_arguments
from .._types import HostArray
from ..geometry import Domain
from ..settings.reference import TracedReference as Settings

_ALL = slice(None)


def check_sampling(
    samples: int, sampler: str, supersampling: int = Settings.supersampling, blockers: str = Settings.blockers
) -> None:
    """**Raises** `ValueError` unless the numbers are integers in range, and the sampler and blockers are known."""
    check_arguments(Settings, samples=samples, sampler=sampler, supersampling=supersampling, blockers=blockers)


def concentric_disk(square: Float[HostArray, "*n 2"]) -> Float[HostArray, "*n 2"]:
    """Maps the unit square to the unit disk. Preserves relative areas and neighbourhoods.

    **Arguments:**

    - `square`: (..., 2), in [0, 1].

    **Returns:** (..., 2), of norm at most 1.

    Shirley and Chiu, "A low distortion map between disk and square", Journal of Graphics Tools 2(3), 1997.
    """
    one = square.dtype.type(1)
    a, b = np.moveaxis(2 * square - one, -1, 0)
    # The radius is the coordinate of greater magnitude; the other sweeps a quarter of the circle.
    horizontal = np.abs(a) > np.abs(b)
    radius, other = _exchanged(b, a, horizontal)
    angle = other / (radius + (radius == 0)) * square.dtype.type(math.pi / 4)
    along, across = radius * np.cos(angle), radius * np.sin(angle)
    disk = np.empty_like(square)
    disk[..., 0], disk[..., 1] = _exchanged(across, along, horizontal)
    return disk


def _exchanged(
    a: Float[HostArray, "*n"], b: Float[HostArray, "*n"], chosen: Bool[HostArray, "*n"]
) -> tuple[Float[HostArray, "*n"], Float[HostArray, "*n"]]:
    """`a` and `b`, exchanged where they are `chosen`."""
    # By their bits: `np.where` branches, and takes up to ten times as long if neighbours differ in their choice.
    kind = np.dtype(f"u{a.itemsize}")
    difference = (a.view(kind) ^ b.view(kind)) * chosen
    return (a.view(kind) ^ difference).view(a.dtype), (b.view(kind) ^ difference).view(b.dtype)


def _centred(square: Float[HostArray, "*n 2"]) -> Float[HostArray, "*n 2"]:
    """Maps the unit square to [-1, 1]²."""
    one = square.dtype.type(1)
    return 2 * square - one


_MAPPINGS: dict[Domain, Callable[[HostArray], HostArray]] = {"disk": concentric_disk, "square": _centred}


class LightSampler:
    """Chooses the samples of a light for any range of pixels. A pixel's samples do not depend on the range.

    - `domain`: the domain of the samples, the light's `domain`.
    - `samples`: points per pixel.
    - `sampler`: `"sobol"`, one Owen-scrambled Sobol sequence, shifted for each pixel by a random vector modulo 1
      (Cranley and Patterson, "Randomization of number theoretic methods for multiple integration", SIAM Journal on
      Numerical Analysis 13(6), 1976); or `"stratified"`, one random point in each cell of the most nearly square grid
      with `samples` cells.
    - `seed`: seed of all random choices.

    Both halves of a pixel's points cover the domain equally well, so their difference estimates the error.
    """

    def __init__(self, domain: Domain, samples: int, sampler: str, seed: int):
        check_sampling(samples, sampler)
        self._map = _MAPPINGS[domain]
        self.samples = int(samples)
        self.seed = seed
        if sampler == "sobol":
            # Drawn in powers of two, for which the sequence is balanced, and truncated.
            from scipy.stats import qmc  # here, since it takes long to load

            sequence = qmc.Sobol(2, scramble=True, rng=np.random.default_rng((seed, 0)))
            points = sequence.random_base2(max(self.samples - 1, 0).bit_length())[: self.samples]
            points, self._cell = points.astype(np.float32), None
        else:
            points, self._cell = _grid(self.samples)
        self._points = np.ascontiguousarray(points.T)

    def points(
        self, first: int, count: int, chosen: Int[HostArray, " n"] | slice = _ALL
    ) -> Float32[HostArray, "n s 2"]:
        """The samples of pixels `first` to `first + count - 1`, or only of the `chosen` pixels among them, (n, samples,
        2)."""
        numbers = 1 if self._cell is None else self.samples
        offset = _uniform(self.seed, first, (count, numbers, 2))[chosen]
        # All x followed by all y: NumPy is slow along an axis of two.
        offset = np.ascontiguousarray(np.moveaxis(offset, -1, 0))
        if self._cell is None:
            square = self._points[:, None] + offset
            square -= square >= 1
        else:
            square = self._points[:, None] + offset * self._cell[:, None, None]
        return self._map(np.moveaxis(square, 0, -1))


def _grid(samples: int) -> tuple[Float32[HostArray, "s 2"], Float32[HostArray, "2"]]:
    """The lower corners of the grid's cells, in checkerboard order (one colour first), and the size of a cell."""
    rows = next(n for n in range(math.isqrt(samples), 0, -1) if samples % n == 0)
    columns = samples // rows
    row, column = np.divmod(np.arange(samples), columns)
    order = np.argsort((row + column) % 2, kind="stable")
    corners = np.stack([column / columns, row / rows], axis=-1)[order]
    return corners.astype(np.float32), np.array([1 / columns, 1 / rows], dtype=np.float32)


def _uniform(seed: int, first: int, shape: tuple[int, int, int]) -> Float32[HostArray, "n s 2"]:
    """Uniform numbers in [0, 1) for pixels from `first` on; a pixel's numbers depend on `seed` and its index alone."""
    count, samples, _ = shape
    # One 64-bit draw holds a pair of 32-bit numbers; Philox makes four draws per step.
    draws = first * samples
    step, skip = divmod(draws, 4)
    generator = np.random.Philox(key=np.random.SeedSequence((seed, 1)).generate_state(2, np.uint64))
    generator.advance(step)
    bits = generator.random_raw(skip + count * samples)[skip:].view(np.uint32)
    # A float32 in [0, 1) holds 24 bits.
    return ((bits >> 8).astype(np.float32) * np.float32(2.0**-24)).reshape(shape)
