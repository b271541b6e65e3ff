"""Kernels: that a filter can be written with public names alone."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import apply, lookups_at, map_of

from diffshadow.shadow import AbstractFilter, HardCompare, PercentageCloser, SoftCompare, Tent
from diffshadow.shadow.kernels import (
    AbstractRow,
    Footprint,
    SeparableRow,
    Span,
    Tap,
    sum_over_rows,
    weight_between,
)

HALF_PLANE = np.where(np.arange(16) < 8, 0.2, 1.0)[None].repeat(16, axis=0)
RADIUS = 3.0


class Gaussian(AbstractFilter):
    """Percentage-closer filtering under a Gaussian that ends at three standard deviations."""

    radius: jax.Array

    def __call__(self, shadow_map, lookup, compare):
        return sum_over_rows(SeparableRow(RADIUS, self.radius, "gaussian"), shadow_map, compare, lookup)


class Comb(AbstractRow):
    """The texel of a look-up and the ones two to its left and right, in its own row alone."""

    weight: jax.Array

    @property
    def texels(self):
        return 5

    def footprint(self, lookup, step):
        column, row = jnp.floor(lookup.x) - 2, jnp.floor(lookup.y) - 2
        columns = [Span(weight) for weight in (self.weight, 0.0, 1 - 2 * self.weight, 0.0, self.weight)]
        return Footprint(column, row, columns, [Span(jnp.where(step == 2, 1.0, 0.0))], step)

    def reach(self, lookup, steps):
        return jnp.asarray(2.5)


class CombFilter(AbstractFilter):
    weight: jax.Array

    def __call__(self, shadow_map, lookup, compare):
        return sum_over_rows(Comb(self.weight), shadow_map, compare, lookup)


def test_gaussian_of_half_plane_is_the_error_function():
    x = np.linspace(4, 12, 41)
    for radius in (1.5, 3.0):
        found = apply(Gaussian(jnp.float32(radius)), map_of(HALF_PLANE), lookups_at(x, 8.3), HardCompare())
        u = np.clip((x - 8) / radius, -1, 1) * 3 / math.sqrt(2)
        expected = 0.5 + np.array([math.erf(value) for value in u]) / (2 * math.erf(3 / math.sqrt(2)))
        np.testing.assert_allclose(np.ravel(found), expected, atol=3e-6)


def test_numbers_of_a_kernel_have_derivatives_of_central_differences():
    with jax.enable_x64(True):
        shadow_map, lookup = map_of(np.where(HALF_PLANE < 1, 0.45, 1.0)), lookups_at(np.linspace(5, 11, 13), 8.3)
        of = lambda weight: CombFilter(weight)(shadow_map, lookup, SoftCompare(1.0))

        @jax.jit
        def all_of(weight):
            return jax.jvp(of, (weight,), (jnp.ones(()),)), jax.grad(lambda weight: jnp.sum(of(weight)))(weight)

        (value, slope), reverse = all_of(np.asarray(0.2))
        step = 1e-6
        (high, _), _ = all_of(np.asarray(0.2 + step))
        (low, _), _ = all_of(np.asarray(0.2 - step))
        expected = (np.asarray(high) - np.asarray(low)) / (2 * step)
    assert np.ptp(np.asarray(value)) > 0.2
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(slope, expected, atol=1e-8)
    assert float(reverse) == pytest.approx(float(np.sum(np.asarray(slope))), rel=1e-10)


@pytest.mark.parametrize("shape", ["box", "tent", "gaussian"])
def test_weights_of_texels_sum_to_one(shape):
    edges = jnp.arange(-5.0, 6.0) + 0.3
    for radius in (0.0, 0.4, 2.2, 4.0):
        weights = weight_between(shape, jnp.float32(radius), edges[:-1], edges[1:])
        assert float(weights.sum()) == pytest.approx(1, abs=1e-6)
        assert float(weights.min()) >= 0


@pytest.mark.parametrize("shape", ["box", "tent", "gaussian"])
def test_weights_whose_texels_end_with_the_kernel_have_the_slopes_of_a_smaller_one(shape):
    """Their sum does not change, and differences from a slightly smaller kernel agree."""
    with jax.enable_x64(True):
        edges = jnp.arange(-3.5, 4.0)
        weights = jax.jit(lambda radius: weight_between(shape, radius, edges[:-1], edges[1:]))
        slopes = jax.jit(jax.jacfwd(weights))(jnp.asarray(2.5))
        smaller = (weights(jnp.asarray(2.5)) - weights(jnp.asarray(2.5 - 1e-6))) / 1e-6
        assert float(jnp.sum(slopes)) == pytest.approx(0, abs=1e-12)
        assert float(jnp.abs(smaller).max()) > 0.01
        np.testing.assert_allclose(slopes, smaller, atol=1e-5)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kernel", [PercentageCloser, Tent])
def test_a_radius_at_its_greatest_has_the_slope_of_a_smaller_one(kernel):
    with jax.enable_x64(True):
        shadow_map, lookup = map_of(np.where(HALF_PLANE < 1, 0.45, 1.0)), lookups_at(np.linspace(6, 10, 9), 8.3)
        of = lambda radius, most: jnp.sum(kernel(radius, most)(shadow_map, lookup, SoftCompare(1.0)) ** 2)
        slope = jax.jit(jax.grad(of), static_argnums=1)
        assert abs(float(slope(2.5, 4.0))) > 1e-3
        assert float(slope(2.5, 2.5)) == pytest.approx(float(slope(2.5, 4.0)), rel=1e-9)


def test_a_tap_may_reach_further_along_one_axis_than_along_the_other():
    lookup = lookups_at(np.array([6.5]), 8.5)
    radii, offset = jnp.array([3.0, 0.75]), jnp.array([1.0, -1.0])
    read = Tap("nearest", tuple(radii)).footprint(lookup, tuple(offset))
    assert (float(read.column[0, 0]), float(read.row[0, 0])) == (9, 7)
