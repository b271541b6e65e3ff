"""Gradients of visibility: against central differences in magnitude, and against plain automatic differentiation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import problem, random_lookups, random_map, technique

from diffshadow.fit import with_values
from diffshadow.shadow import (
    Bilinear,
    ExponentialShadowMap,
    ExponentialVarianceShadowMap,
    FourTap,
    HardCompare,
    Lookup,
    MomentShadowMap,
    PercentageCloser,
    PercentageCloserSoft,
    RandomDisk,
    ShadowMap,
    SoftCompare,
    Tent,
    VarianceShadowMap,
    stratified,
)
from diffshadow.shadow.filters._pcf import _Row
from diffshadow.shadow.kernels import Tap, mean_of_taps, pad, sum_over
from diffshadow.shadow.kernels._sum import _Plain
from diffshadow.shadow.kernels._terms import _sum

NAMES = ("bias.constant", "bias.slope", "bias.normal_offset", "filter.radius")
VALUES = (0.9, 0.6, 0.4, 1.7)


KERNELS = {
    "bilinear": lambda radius: Tap("bilinear", radius),
    "nearest": lambda radius: Tap("nearest", radius),
    "pcf": lambda radius: _Row(1.0, radius),
}


def sum_arguments(seed, name):
    """What `sum_over` takes, at random, with look-ups whose planes are followed."""
    rng = np.random.default_rng(seed)
    shadow_map, lookup = random_map(rng, (9, 9)), random_lookups(rng, (6, 7), (9, 9))
    slope = jnp.stack([jnp.asarray(rng.normal(scale=0.05, size=(6, 7))) for _ in range(2)], axis=-1)
    radius = jnp.asarray(rng.uniform(0.1, 1.0 if name == "pcf" else 2.5, (6, 7)))
    deepest = lookup.depth + jnp.asarray(rng.uniform(0, 0.1, (6, 7)))
    lookup = Lookup(lookup.texel, lookup.depth, lookup.depth_per_texel, lookup.inside, slope, deepest=deepest)
    kernel = KERNELS[name](radius)
    steps = jnp.arange(kernel.texels) if name == "pcf" else tuple(jnp.asarray(rng.uniform(-1, 1, (2, 3, 1, 1))))
    return kernel, pad(shadow_map, 6), SoftCompare(1.3), lookup, steps


def moving(function, arguments):
    """`function` of a sum's arguments as one of all that it may be differentiated by, and those."""
    kernel, padded, compare, lookup, steps = arguments
    primals = (padded.depth, compare.width, lookup.x, lookup.y, lookup.depth, lookup.depth_per_texel, *lookup.slope)
    primals += (lookup.deepest, kernel.radius)

    def moved(depth, width, x, y, receiver, unit, slope_x, slope_y, deepest, radius):
        new = eqx.tree_at(lambda p: p.depth, padded, depth)
        at = Lookup(jnp.stack([x, y], axis=-1), receiver, unit, lookup.inside, deepest=deepest)
        at = eqx.tree_at(lambda lookup: lookup.slope, at, (slope_x, slope_y), is_leaf=lambda x: x is None)
        sized = eqx.tree_at(lambda kernel: kernel.radius, kernel, radius)
        return function(sized, new, eqx.tree_at(lambda c: c.width, compare, width), at, steps)

    return moved, primals


@eqx.filter_jit
def derivatives(arguments, tangents, weight):
    """Values and derivatives of a sum along `tangents`, by the package and by plain automatic differentiation; and
    the gradient of the sum weighed."""
    function, primals = moving(sum_over, arguments)
    plain = lambda kernel, padded, compare, at, steps: _sum(_Plain(), padded, compare, (kernel, at), steps, None)
    plain, _ = moving(plain, arguments)
    gradients = jax.grad(lambda p: jnp.sum(weight * function(*p)))(primals)
    return jax.jvp(function, primals, tangents), jax.jvp(plain, primals, tangents), gradients


def test_a_sum_counts_each_step_once_however_many_there_are():
    """Some are written out in each turn of a loop, and what is left after it."""
    kernel, _, _, lookup, _ = sum_arguments(0, "nearest")
    numbers = (1, 7, 23, 25, 37, 64)
    total = lambda n: _Plain().add_up(
        lambda at, step: 0 * at[1].x + step, None, HardCompare(), (kernel, lookup), jnp.arange(n)
    )
    found = jax.jit(lambda: [total(n)[0, 0] for n in numbers])()
    np.testing.assert_array_equal(found, [n * (n - 1) / 2 for n in numbers])


PREFILTERED = (VarianceShadowMap, ExponentialShadowMap, ExponentialVarianceShadowMap, MomentShadowMap)


@eqx.filter_jit
def all_slopes(shadow_map, lookup, radius, width):
    """Derivatives of every filter by all that has one; the radius among them, where there is one."""
    taps = stratified((2, 2), 4)
    makers = [(lambda r: RandomDisk(r, taps), kernel) for kernel in ("logistic", "linear", "exponential")]
    makers += [(lambda r: PercentageCloser(r, 4.0), "gaussian"), (lambda _: Bilinear(), "logistic")]
    makers += [
        (lambda r: Tent(r, 4.0), "logistic"),
        (lambda r: PercentageCloserSoft(r, taps, taps, 0.0, 4.0), "linear"),
    ]
    makers += [(lambda r, kind=kind: kind(r, 4.0, "tent"), "logistic") for kind in PREFILTERED]
    found = []
    for make, kernel in makers:

        def total(arguments, make=make, kernel=kernel):
            depth, lookup, radius, width = arguments
            return jnp.sum(make(radius)(ShadowMap(depth, shadow_map.light), lookup, SoftCompare(width, kernel)))

        found.append(eqx.filter_grad(total)((shadow_map.depth, lookup, radius, width)))
    return found


@pytest.mark.exhaustive
@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    radius=st.floats(0, 4, width=32),
    width=st.floats(float(np.float32(1e-3)), 100, width=32),
    scale=st.sampled_from([0.0, 1.0, 1e3, 1e9, 1e30]),
    whole=st.booleans(),
)
def test_no_gradient_is_nan_or_infinite(seed, radius, width, scale, whole):
    rng = np.random.default_rng(seed)
    lookup = random_lookups(rng)
    # Whole numbers of texels lie on the kinks of every filter.
    texel = jnp.round(lookup.texel) if whole else lookup.texel
    # Before the light, behind it, at the far plane and beyond.
    depth = lookup.depth.at[0].set(-1.0).at[1].set(0.0).at[2].set(1.0).at[3].set(2.0)
    lookup = Lookup(texel * scale, depth, lookup.depth_per_texel, lookup.inside)
    for gradient in all_slopes(random_map(rng), lookup, jnp.float32(radius), jnp.float32(width)):
        for leaf in jax.tree.leaves(gradient):
            assert np.isfinite(np.asarray(leaf)).all()


@pytest.mark.exhaustive
def test_slopes_stay_finite_where_the_surface_passes_the_light():
    """Pixels without a surface, edge-on to the light, beside it and behind it."""
    with jax.enable_x64(False):
        known = problem(technique(FourTap(1.0), compare=SoftCompare(0.5)), "spot")
        light = known.shadow_map.light
        back = known.shadow_map.view.world_to_eye[2, :3]
        position = known.surface.position.at[0].set(light.position).at[1].set(light.position + 0.1 * back)
        position = position.at[2].set(light.position + 1e-7 * back).at[3].set(light.position - 1e-7 * back + 1.0)
        surface = eqx.tree_at(lambda s: s.position, known.surface, position)
        normal = surface.normal.at[5].set(0).at[6].set(jnp.cross(light.direction, jnp.array([1.0, 0.0, 0.0])))
        surface = eqx.tree_at(lambda s: s.normal, surface, normal)
        known = eqx.tree_at(lambda p: p.surface, known, surface)
        at = lambda values: known.residual(with_values(known.technique, NAMES, values))
        values = np.array(VALUES, np.float32)
        # Along all of them at once: what is not finite by one is not by the sum.
        value, slope = jax.jit(lambda values: jax.jvp(at, (values,), (jnp.ones(4),)))(values)
    assert np.isfinite(np.asarray(value)).all()
    assert np.isfinite(np.asarray(slope)).all()


MODES = ["bilinear", pytest.param("nearest", marks=pytest.mark.exhaustive)]


@pytest.mark.exhaustive
@pytest.mark.parametrize("mode", MODES)
def test_what_is_active_is_found_alone_and_its_derivative_too(mode):
    """Whatever the share of pixels that are active, with more of them than fit in a step of the loop."""
    rng = np.random.default_rng(6)
    shape = (70, 150)
    shadow_map, lookup = random_map(rng), random_lookups(rng, shape)
    pattern, compare = stratified((2, 3), 4), SoftCompare(1.0)
    mean = lambda radius, active=None: mean_of_taps(shadow_map, lookup, compare, radius, pattern, mode, active)
    pushed = lambda *of: jax.jvp(lambda r: mean(r, *of), (jnp.float32(1.7),), (jnp.float32(1.0),))
    found = jax.jit(lambda active: (mean(jnp.float32(1.7), active), *pushed(active), *pushed()))
    for share in (0.0, 0.01, 0.3, 1.0):
        active = rng.random(shape) < share
        alone, again, slope_alone, value, slope = (np.asarray(x) for x in found(active))
        np.testing.assert_allclose(alone, np.where(active, value, 0), atol=1e-6)
        np.testing.assert_array_equal(again, np.where(active, value, 0))
        np.testing.assert_array_equal(slope_alone, np.where(active, slope, 0))
    assert (np.abs(slope).max() > 1e-3) == (mode == "bilinear")


@pytest.mark.exhaustive
def test_early_out_differentiates_both_ways_and_maps_over_radii():
    rng = np.random.default_rng(7)
    shadow_map, lookup = random_map(rng), random_lookups(rng, (9, 10))
    filter = RandomDisk(1.0, stratified((3, 4), 2), early_out=True)
    visibility = lambda r: eqx.tree_at(lambda f: f.radius, filter, r)(shadow_map, lookup, SoftCompare(0.02, "linear"))
    weight, radii = rng.normal(size=(9, 10)), np.array([0.3, 1.1, 2.5], np.float32)

    @jax.jit
    def all_of(radii):
        values, forward = jax.vmap(lambda r: jax.jvp(visibility, (r,), (jnp.ones(()),)))(radii)
        backward = jax.vmap(jax.grad(lambda r: jnp.sum(weight * visibility(r))))(radii)
        return values, visibility(radii[1]), forward, backward

    values, value, forward, backward = (np.asarray(x) for x in all_of(radii))
    np.testing.assert_allclose(values[1], value, atol=1e-6)
    np.testing.assert_allclose((weight * forward).sum(axis=(1, 2)), backward, rtol=1e-4, atol=1e-3)
    assert np.abs(forward).max() > 0.01
    # Where the first eight agree, so that nothing depends on the radius.
    assert (forward[(values == 0) | (values == 1)] == 0).mean() > 0.9


@pytest.mark.parametrize("mode", MODES)
def test_each_receiver_looks_into_its_own_layer(mode):
    rng = np.random.default_rng(8)
    single, lookup = random_map(rng), random_lookups(rng, (6, 7))
    depth = jnp.stack([single.depth, random_map(rng).depth, random_map(rng).depth])
    layer = jnp.asarray(rng.integers(0, 3, (6, 7)), jnp.int32)

    @jax.jit
    def mean(depth, layer):
        at = eqx.tree_at(lambda at: at.layer, lookup, layer, is_leaf=lambda x: x is None)
        pattern, compare = stratified((2, 3), 4), SoftCompare(1.0)
        return mean_of_taps(ShadowMap(depth, single.light), at, compare, jnp.float32(1.5), pattern, mode)

    expected = jnp.stack([mean(depth[k], None) for k in range(3)])
    expected = jnp.take_along_axis(expected, layer[None], axis=0)[0]
    np.testing.assert_allclose(mean(depth, layer), expected, atol=1e-6)


def test_a_hard_compare_does_not_see_the_map_move():
    rng = np.random.default_rng(6)
    shadow_map, lookup = random_map(rng, (9, 9)), random_lookups(rng, (4, 5), (9, 9))
    disk = RandomDisk(1.0, stratified((2, 2), 4))
    lit = lambda depth: jnp.sum(disk(ShadowMap(depth, shadow_map.light), lookup, HardCompare()))
    assert (np.asarray(jax.jit(jax.grad(lit))(shadow_map.depth)) == 0).all()
