"""Biases: their units, their profiles, and that several add up."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LIGHTS, drawn, floor_and_card, lamp, sun

from diffshadow.raster import Surface
from diffshadow.shadow import Bias, BiasTerms, ConstantBias, NormalOffset, Receiver, ShadowMap, SlopeBias, receiver

ANGLES = np.array([0.0, 10.0, 45.0, 80.0, 89.9, 90.0, 120.0])


def receivers_at(angles=ANGLES, texel=0.02, depth_per_texel=1e-3):
    """Receivers in the plane y = 0 that the light meets at `angles`, degrees."""
    shape = (1, len(angles))
    cosine = jnp.asarray(np.cos(np.radians(angles))[None], jnp.float32)
    normal = jnp.broadcast_to(jnp.array([0.0, 1.0, 0.0]), (*shape, 3))
    return Receiver(jnp.zeros((*shape, 3)), normal, cosine, jnp.full(shape, texel), jnp.full(shape, depth_per_texel))


def test_constant_bias_is_in_texels_of_depth():
    terms = ConstantBias(3.0)(receivers_at())
    np.testing.assert_allclose(terms.depth, np.full((1, 7), 3e-3), rtol=1e-6)
    assert (np.asarray(terms.displacement) == 0).all()


def test_slope_bias_is_in_proportion_to_the_tangent():
    depth = np.asarray(SlopeBias(2.0)(receivers_at()).depth)[0]
    np.testing.assert_allclose(depth[:4], 2e-3 * np.tan(np.radians(ANGLES[:4])), rtol=1e-4, atol=1e-9)
    # Grazing light and light from behind ask for a large bias, but not for an endless one.
    np.testing.assert_allclose(depth[4:], 2e-3 * 100, rtol=1e-3)


@pytest.mark.parametrize(
    ("profile", "formula"),
    [
        ("sine", lambda angle: np.sin(angle)),
        ("constant", lambda angle: np.ones_like(angle)),
        ("one_minus_cosine", lambda angle: 1 - np.cos(angle)),
    ],
)
def test_normal_offset_moves_along_the_normal_by_its_profile(profile, formula):
    terms = NormalOffset(1.5, profile)(receivers_at())
    angles = np.radians(np.minimum(ANGLES, 90))
    np.testing.assert_allclose(terms.displacement[0, :, 1], 1.5 * 0.02 * formula(angles), rtol=1e-5, atol=1e-7)
    assert (np.asarray(terms.displacement)[..., [0, 2]] == 0).all()
    assert (np.asarray(terms.depth) == 0).all()


def test_terms_of_a_bias_add_up():
    at = receivers_at(np.array([30.0, 60.0]))
    whole = Bias(1.0, 0.5, 2.0)(at)
    parts = ConstantBias(1.0)(at) + SlopeBias(0.5)(at) + NormalOffset(2.0)(at)
    np.testing.assert_allclose(whole.depth, parts.depth, rtol=1e-6)
    np.testing.assert_allclose(whole.displacement, parts.displacement, rtol=1e-6)
    assert isinstance(whole, BiasTerms)


def test_bias_takes_modules_for_its_parts():
    bias = Bias(normal_offset=NormalOffset(1.0, "constant"))
    np.testing.assert_allclose(bias(receivers_at()).displacement[..., 1], 0.02, rtol=1e-6)


def test_no_bias_moves_nothing_and_no_profile_has_a_nan_slope():
    terms = Bias()(receivers_at())
    assert (np.asarray(terms.depth) == 0).all()
    assert (np.asarray(terms.displacement) == 0).all()

    def total(cosine):
        at = receivers_at()
        at = Receiver(at.position, at.normal, cosine, at.texel, at.depth_per_texel)
        biases = (SlopeBias(1.0), *(NormalOffset(1.0, p) for p in ("sine", "constant", "one_minus_cosine")))
        terms = [bias(at) for bias in biases]
        return sum(jnp.sum(t.depth) + jnp.sum(t.displacement) for t in terms)

    edges = jnp.array([[1.0, 1.0 + 1e-7, 0.0, -1.0, 0.01, 0.5, -0.0]])
    assert np.isfinite(np.asarray(jax.grad(total)(edges))).all()


@pytest.mark.parametrize("light", LIGHTS)
def test_receivers_know_the_size_of_their_texels(light):
    """Against the projection itself: steps of a share of a texel's width move a point by that share of a texel."""
    surface, shadow_map = drawn(light, 64, 64)
    at = receiver(shadow_map, surface)
    view = shadow_map.view
    rows = np.asarray(view.world_to_eye[:3, :3])

    def window(position):
        clip = np.asarray(view.clip(position), np.float64)
        return clip[..., :3] / clip[..., 3:] * 0.5 + 0.5

    mask = np.asarray(surface.mask)
    step = np.asarray(at.texel)[..., None]
    middle = window(surface.position)
    moved = [window(surface.position + jnp.asarray(step * rows[k] / 8, jnp.float32)) - middle for k in range(3)]
    # The width is the mean of a texel's two sides, which differ under the sun.
    area = moved[0][mask][:, 0] * moved[1][mask][:, 1] * (8 * 64) ** 2
    np.testing.assert_allclose(area, 1, rtol=5e-3)
    # Along the axis, the eye looks along -z; a finite step sees the perspective's curvature.
    np.testing.assert_allclose(-moved[2][mask][:, 2] * 8, np.asarray(at.depth_per_texel)[mask], rtol=0.03)
    np.testing.assert_allclose(np.linalg.norm(np.asarray(surface.normal)[mask], axis=-1), 1, atol=1e-5)
    assert (np.abs(np.asarray(at.cosine)[mask]) <= 1 + 1e-6).all()


def test_maps_that_are_not_square_have_a_mean_texel():
    mesh = floor_and_card()
    light = sun(mesh)
    position = jnp.zeros((1, 1, 3))
    up = jnp.zeros((1, 1, 3)).at[..., 1].set(1.0)
    surface = Surface(position, up, up, position, jnp.zeros((1, 1), jnp.int32), jnp.ones((1, 1), bool))
    texel = float(receiver(ShadowMap(jnp.ones((40, 160)), light), surface).texel[0, 0])
    width, height = np.asarray(light.extent) / [160, 40]
    assert texel == pytest.approx(float(np.sqrt(width * height)), rel=1e-5)


def test_pixels_without_a_surface_hold_harmless_numbers():
    for light in (sun(floor_and_card()), lamp(floor_and_card())):
        zero = jnp.zeros((2, 2, 3))
        # A position on the light itself, no normal, and no surface.
        where = light.position if hasattr(light, "position") else light.center
        surface = Surface(zero + where, zero, zero, zero, jnp.full((2, 2), -1), jnp.array([[True, False]] * 2))
        at = receiver(ShadowMap(jnp.ones((8, 8)), light), surface)
        for leaf in jax.tree.leaves(Bias(1.0, 1.0, 1.0)(at)):
            assert np.isfinite(np.asarray(leaf)).all()
