"""The interface that all techniques share."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import floor_camera, marked, quad, side_camera, sun

from diffshadow.geometry import Scene, merge
from diffshadow.raster import draw_surface
from diffshadow.reference import trace_visibility, trace_visibility_exact
from diffshadow.shadow import (
    AbstractTechnique,
    Bias,
    Bilinear,
    IrregularZBuffer,
    MapPlan,
    MapSettings,
    ProjectiveShadow,
    ShadowMapping,
    ShadowVolumes,
)

FLOOR, CARD = quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), quad((0, 1, 0), (0.5, 0, 0), (0, 0, -0.5))
# Above all else, and out of sight.
CANOPY = quad((0, 4, 0), (9, 0, 0), (0, 0, -9))
SCENE = Scene([FLOOR, CARD, CANOPY], side_camera((64, 64)), sun(merge([FLOOR, CARD])), casts=(False, True, False))
SIZE = (64, 64)
TECHNIQUES = {
    "shadow_map": ShadowMapping(Bilinear(), Bias(1.0), map=MapSettings(SIZE)),
    "shadow_volumes": ShadowVolumes(),
    "irregular_z_buffer": IrregularZBuffer(),
    "projective_texture": ProjectiveShadow(SIZE),
}


class Unshadowed(AbstractTechnique):
    """Lit everywhere: what is written without knowing more than the interface."""

    def prepare(self, scene, surface=None):
        return scene.light

    def visibility(self, state, surface):
        return jnp.ones(surface.mask.shape)

    def covered(self, state, surface):
        return surface.mask


@pytest.fixture(scope="module")
def seen():
    return draw_surface(SCENE.mesh, SCENE.camera), trace_visibility_exact(SCENE)


# Volumes and the irregular z-buffer have tests of their own.
@pytest.mark.parametrize("name", marked(TECHNIQUES, ("shadow_volumes", "irregular_z_buffer")))
def test_every_technique_draws_the_shadow_of_a_card(name, seen):
    (surface, truth), technique = seen, TECHNIQUES[name]
    state = technique.prepare(SCENE, surface)
    visibility = np.asarray(technique.visibility(state, surface))
    counted = np.asarray(technique.covered(state, surface)) & truth.mask
    on_floor = counted & (np.asarray(surface.face) < 2)
    assert counted.sum() > 0.95 * truth.mask.sum()
    assert 0.03 < np.mean(truth.visibility[on_floor] < 0.5) < 0.5
    # An outline is wrong by a texel at most, and a texel is some pixels wide.
    exact = name in ("shadow_volumes", "irregular_z_buffer")
    assert np.mean(np.abs(visibility - truth.visibility)[on_floor]) < (1e-3 if exact else 0.03)
    assert (visibility[~np.asarray(surface.mask)] == 1).all()


def test_what_does_not_cast_darkens_the_reference_only_if_asked(seen):
    _, truth = seen
    assert 0.5 < truth.visibility[truth.mask].mean() < 1
    assert not trace_visibility(SCENE, blockers="all").visibility[truth.mask].any()


def test_a_technique_of_ones_own_is_one(seen):
    surface, _ = seen
    technique = Unshadowed()
    assert np.asarray(technique.visibility(technique.prepare(SCENE, surface), surface)).min() == 1
    with pytest.raises(TypeError, match="abstract"):
        AbstractTechnique()


OUTLINES = ShadowMapping(Bilinear(), Bias(1.0), map=MapSettings((32, 32), silhouettes=True))


def _sunlit(direction):
    return dataclasses.replace(SCENE, lights=dataclasses.replace(SCENE.light, direction=direction))


@pytest.mark.exhaustive
def test_several_lights_at_once_have_the_derivatives_of_each(seen):
    """Of the light that reaches the floor, by the sun's direction, in reverse mode."""
    plan, floor = OUTLINES.plan(SCENE), draw_surface(FLOOR, floor_camera(resolution=(32, 32)))

    def lit(direction):
        return jnp.mean(OUTLINES.visibility(OUTLINES.prepare(_sunlit(direction), plan=plan), floor))

    directions = SCENE.light.direction + jnp.array([[0.1, 0, 0.05], [-0.2, 0, 0.1], [0.05, 0, -0.3]])
    each = jax.jit(jax.grad(lit))
    together = jax.jit(jax.grad(lambda directions: jnp.sum(jax.vmap(lit)(directions))))(directions)
    expected = np.stack([each(direction) for direction in directions])
    assert np.abs(expected).max() > 5e-3
    np.testing.assert_allclose(together, expected, rtol=1e-3, atol=1e-6)


@pytest.mark.exhaustive
def test_a_map_says_that_a_plan_has_too_little_memory():
    of_margin = lambda margin: OUTLINES.prepare(SCENE, plan=OUTLINES.plan(SCENE, margin=margin, raises=False)).overflow
    assert of_margin(0.1)
    assert not of_margin(2.0)


def test_maps_with_silhouettes_need_a_plan_inside_jit():
    with pytest.raises(ValueError, match=r"no plan was given.*technique\.plan\(scene\).*prepare\(scene, plan=plan\)"):
        jax.jit(lambda direction: OUTLINES.prepare(_sunlit(direction)).depth)(SCENE.light.direction)
    with pytest.raises(ValueError, match=r"the plan has no edges, and map\.silhouettes is True"):
        OUTLINES.prepare(SCENE, plan=MapPlan())
    assert TECHNIQUES["shadow_map"].plan(SCENE) == MapPlan()
