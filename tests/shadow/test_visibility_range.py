"""Visibility lies in [0, 1], whatever the technique, its numbers and the map."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import apply, floor_and_card, map_of, random_lookups, side_camera, sun

from diffshadow._arithmetic import in_unit_range
from diffshadow.geometry import Scene
from diffshadow.raster import draw_surface
from diffshadow.shadow import (
    BabylonJs,
    Bilinear,
    Castano,
    ExponentialShadowMap,
    ExponentialVarianceShadowMap,
    FourTap,
    HardCompare,
    MomentShadowMap,
    PercentageCloser,
    PercentageCloserSoft,
    RandomDisk,
    SoftCompare,
    Tent,
    ThreeJs,
    VarianceShadowMap,
    stratified,
)

MAP = (16, 16)
REACH = 3.0
HARD, LINEAR, GAUSSIAN = HardCompare(), SoftCompare(1.0, "linear"), SoftCompare(1.0, "gaussian")
# Each is compiled once: hypothesis draws the numbers.
FILTERS = {
    "box": (PercentageCloser(1.0, REACH), LINEAR),
    "tent": (Tent(1.0, 4.0), HARD),
    "disk": (RandomDisk(1.0, stratified((2, 4))), GAUSSIAN),
    "four taps": (FourTap(1.0), HARD),
    "Castaño": (Castano(7), SoftCompare(1.0)),
    "bilinear": (Bilinear(), GAUSSIAN),
    "PCSS": (PercentageCloserSoft(2.0, stratified((2, 4)), stratified((2, 4))), HARD),
    "VSM": (VarianceShadowMap(1.0, REACH), HARD),
    "ESM": (ExponentialShadowMap(1.0, REACH, "tent"), HARD),
    "EVSM": (ExponentialVarianceShadowMap(1.0, REACH), HARD),
    "MSM": (MomentShadowMap(1.0, REACH, "gaussian"), HARD),
}


def random_depths(seed, shape):
    """Depths as a map may hold them: smooth or noisy, partly empty, or all the same."""
    rng = np.random.default_rng(seed)
    noise, level = rng.random() ** 4, rng.choice([0.0, 0.5, 1.0, rng.random()])
    depth = np.clip(level + noise * rng.normal(size=shape), 0, 1)
    return np.where(rng.random(shape) < rng.choice([0, 0.2, 1]), 1.0, depth)


def assert_in_unit_range(visibility, tolerance=0.0):
    visibility = np.asarray(visibility, np.float64)
    assert np.isfinite(visibility).all()
    assert visibility.min() >= -tolerance
    assert visibility.max() <= 1 + tolerance


def test_a_mean_beyond_the_range_keeps_its_derivative():
    means = jnp.array([-1e-7, 0.0, 0.5, 1.0, 1 + 1e-6])
    values, tangents = jax.jvp(in_unit_range, (means,), (jnp.ones(5),))
    np.testing.assert_array_equal(values, [0, 0, 0.5, 1, 1])
    np.testing.assert_array_equal(tangents, 1)


def within_ranges(module, rng):
    """`module` with random numbers anywhere within the documented ranges; what is static stays."""
    changed = {}
    for key, setting in module.settings.each().items():
        old, limits = getattr(module, key, None), setting.limits
        if eqx.is_inexact_array(old) and old.ndim == 0 and limits.high is not None:
            ends = limits.low + (0 if not limits.above_low else 1e-3 * limits.high), limits.high
            low, high = ends[0], min(ends[1], getattr(module, f"max_{key}", ends[1]))
            changed[key] = rng.choice([low, high, rng.uniform(low, high), low + (high - low) * rng.random() ** 6])
    return eqx.tree_at(
        lambda each: [getattr(each, key) for key in changed], module, [jnp.float32(x) for x in changed.values()]
    )


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["disk", "PCSS", "VSM", "ESM", "EVSM", "MSM"])
def test_no_number_within_its_range_carries_a_filter_out_of_the_unit_range(name):
    kernel, compare = FILTERS[name]
    if name == "PCSS":
        # Its radii are in order, and the light's size is given.
        kernel = eqx.tree_at(lambda f: f.max_radius, kernel, jnp.float32(8192))
    for seed in range(12):
        rng = np.random.default_rng(seed)
        made = within_ranges(kernel, rng)
        if name == "PCSS":
            made = eqx.tree_at(lambda f: f.min_radius, made, jnp.minimum(made.min_radius, made.max_radius))
        lookup = random_lookups(rng, size=MAP)
        assert_in_unit_range(apply(made, map_of(random_depths(seed, MAP)), lookup, compare), tolerance=1e-6)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "technique",
    [
        ThreeJs(resolution=MAP),
        ThreeJs(shadow_type="VSMShadowMap", blur_samples=3, resolution=MAP),
        *(BabylonJs(filter=filter, resolution=MAP) for filter in ("POISSONSAMPLING", "PCSS")),
        *(BabylonJs(filter=filter, resolution=MAP) for filter in ("NONE", "PCF", "CLOSEEXPONENTIALSHADOWMAP")),
        BabylonJs(filter="BLUREXPONENTIALSHADOWMAP", resolution=MAP),
    ],
    ids=lambda made: f"{type(made).__name__} {getattr(made, 'shadow_type', None) or made.filter}",
)
def test_no_number_within_its_range_carries_an_engine_out_of_the_unit_range(technique):
    mesh = floor_and_card()
    scene = Scene(mesh, side_camera((16, 16)), sun(mesh))
    surface = draw_surface(mesh, scene.camera)
    state = technique.prepare(scene)
    for seed in range(12):
        rng = np.random.default_rng(seed)
        made = within_ranges(technique, rng)
        noisy = dataclasses.replace(state, depth=jnp.asarray(random_depths(seed, MAP), jnp.float32))
        assert_in_unit_range(made.visibility(noisy, surface))
