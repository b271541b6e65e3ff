"""Projective texture shadows: the shadow of a square, its blur, what they do not darken, and their gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import floor_and_card, floor_camera, quad, side_camera

from diffshadow.geometry import DirectionalLight, PointLight, SpotLight, merge
from diffshadow.raster import draw_surface
from diffshadow.shadow import ProjectiveShadow, ProjectiveTexture, draw_projective_texture, plan_shadow_map

DOWN = DirectionalLight((0, -1, 0), (0, 0, 0), (4, 4), -3, 3)
"""Straight down on a map 4 world units wide."""
TEXELS = 128
IS_CARD = jnp.array([False, False, True, True])
HALF = 0.5
"""Of the card's width, world units: 16 texels."""
CARD = quad((0, 1, 0), (HALF, 0, 0), (0, 0, -HALF))
FLOOR = quad((0, 0, 0), (3, 0, 0), (0, 0, -3))


@eqx.filter_jit
def shadows(texture, surface, casts):
    return ProjectiveShadow().visibility(texture, surface, casts)


@pytest.fixture(scope="module")
def floor():
    """The floor under the card, 3 world units wide, seen straight down; the card is above the camera."""
    return draw_surface(floor_and_card(HALF), floor_camera(1.5, (96, 96)))


def project(floor, blur=0.0, light=DOWN, **options):
    texture = draw_projective_texture(CARD, light, (TEXELS, TEXELS), blur, **options)
    return np.asarray(shadows(texture, floor, IS_CARD))


def test_shadow_of_a_square_is_the_square(floor):
    visibility = project(floor)
    x, z = np.asarray(floor.position[..., 0]), np.asarray(floor.position[..., 2])
    outside = np.maximum(np.abs(x), np.abs(z)) - HALF
    texel = 4 / TEXELS
    # The look-up is bilinear between texels that are covered or not: it blurs by one of them.
    assert np.all(visibility[outside < -texel] == 0)
    assert np.all(visibility[outside > texel] == 1)
    lit = visibility.mean() * 9
    assert lit == pytest.approx(9 - (2 * HALF) ** 2, abs=0.02)


@pytest.mark.parametrize("blur", [0.5, 3.0, 4.7, 9.25])
def test_blur_makes_a_ramp_of_its_own_width(floor, blur):
    middle = project(floor, blur)[48]
    x = np.asarray(floor.position[48, :, 0])
    # A box of half-width b over an edge: from dark to lit in 2 b texels, and a bilinear look-up blurs it by one more.
    texels = (np.abs(x) - HALF) * TEXELS / 4
    ramp = np.clip(0.5 + texels / (2 * blur), 0, 1)
    near = np.abs(np.abs(texels) - blur) < 1
    assert np.abs(middle - ramp)[~near].max() < (0.51 if blur == 0.5 else 1e-5)
    assert np.abs(middle - ramp)[near].max() < 0.26 / blur


def test_kernels_keep_the_shadow_s_area(floor):
    area = lambda **options: 1 - project(floor, 6.0, **options).mean()
    assert area(kernel="tent") == pytest.approx(area(kernel="box"), rel=1e-3)
    assert area(kernel="gaussian") == pytest.approx(area(), rel=1e-3)


def test_shadow_grows_with_the_distance_from_a_spot_light(floor):
    light = SpotLight((0, 3, 0), (0, -1, 0), 45, 0.5, 4)
    visibility = project(floor, light=light)
    # The card at two thirds of the way throws half as much again of its width.
    assert (1 - visibility.mean()) * 9 == pytest.approx((2 * HALF * 1.5) ** 2, rel=0.02)


def test_casters_are_lit_and_surfaces_turned_away_are_dark():
    scene = merge([FLOOR, CARD, quad((0, 0.5, 0), (0.2, 0, 0), (0, 0, 0.2))])
    surface = draw_surface(scene, side_camera())
    casts = jnp.array([False] * 2 + [True] * 4)
    texture = draw_projective_texture(merge([CARD]), DOWN, (TEXELS, TEXELS))
    visibility = np.asarray(shadows(texture, surface, casts))
    face = np.asarray(surface.face)
    # The small card hangs in the shadow of the large one, and is a caster itself.
    assert np.isin([4, 5], face).any()
    assert np.all(visibility[face >= 2] == 1)
    assert visibility[np.isin(face, (0, 1))].min() == 0
    up = DirectionalLight((0, 1, 0), (0, 0, 0), (4, 4), -3, 3)
    from_below = draw_projective_texture(CARD, up, (TEXELS, TEXELS))
    assert np.all(np.asarray(shadows(from_below, surface, casts))[np.isin(face, (0, 1))] == 0)


def test_what_the_texture_does_not_show_is_lit(floor):
    narrow = DirectionalLight((0, -1, 0), (0, 0, 0), (0.6, 0.6), -3, 3)
    visibility = project(floor, 2.0, light=narrow)
    texture = draw_projective_texture(CARD, narrow, (TEXELS, TEXELS), 2.0)
    covered = np.asarray(ProjectiveShadow().covered(texture, floor))
    reach = np.abs(np.asarray(floor.position[..., [0, 2]])).max(axis=-1)
    assert np.array_equal(covered, reach <= 0.3)
    assert np.all(visibility[reach < 0.28] == 0)
    assert np.all(visibility[reach > 0.32] == 1)


def test_what_lies_behind_the_light_is_lit(floor):
    # The floor lies behind a spot light that shines upwards at the card.
    light = SpotLight((0, 0.5, 0), (0, 1, 0), 60, 0.01, 2)
    texture = draw_projective_texture(CARD, light, (TEXELS, TEXELS))
    assert np.asarray(texture.coverage).max() == 1
    assert not np.asarray(ProjectiveShadow().covered(texture, floor)).any()
    # The floor's upper side faces the light, which lies above it.
    assert np.all(np.asarray(shadows(texture, floor, IS_CARD)) == 1)


def test_point_light_projects_as_a_spot_light_that_looks_the_same_way(floor):
    spot = SpotLight((0, 2, 0), (0, -1, 0), 45, 0.1, 4)
    point = PointLight((0, 2, 0), 0.1, 4, guard=0.0)
    images = [project(floor, light=light) for light in (spot, point)]
    assert (images[0] == 0).any()
    # The one texture may stand upside down.
    assert np.abs(images[0] - images[1]).max() < 1e-5 or np.abs(images[0] - images[1][::-1]).mean() < 0.01
    assert draw_projective_texture(CARD, point, (TEXELS, TEXELS)).coverage.shape[0] == 6


def test_blur_has_a_gradient():
    with jax.enable_x64(True):
        surface = draw_surface(floor_and_card(HALF), floor_camera(1.5, (24, 24)))
        room = plan_shadow_map(CARD, DOWN, (32, 32)).triangles

        def mean_square(blur):
            texture = draw_projective_texture(CARD, DOWN, (32, 32), blur, max_blur=6.0, capacity=room)
            return jnp.mean(ProjectiveShadow().visibility(texture, surface, IS_CARD) ** 2)

        def both_ways(blur):
            value, forward = jax.jvp(mean_square, (blur,), (jnp.ones_like(blur),))
            return value, forward, jax.grad(mean_square)(blur)

        step, compiled = 1e-4, jax.jit(both_ways)
        at = lambda blur: [float(x) for x in compiled(jnp.float64(blur))]
        slope = (at(3.3 + step)[0] - at(3.3 - step)[0]) / (2 * step)
        _, forward, backward = at(3.3)
        assert abs(slope) > 1e-4
        assert forward == pytest.approx(slope, rel=1e-3)
        assert backward == pytest.approx(forward, rel=1e-9)


def test_receivers_have_a_gradient_within_the_texture():
    with jax.enable_x64(True):
        surface = draw_surface(floor_and_card(HALF), floor_camera(1.5, (24, 24)))
        texture = draw_projective_texture(CARD, DOWN, (32, 32), 3.0)

        @jax.jit
        @jax.value_and_grad
        def mean(shift):
            moved = eqx.tree_at(lambda s: s.position, surface, surface.position + shift * jnp.array([1.0, 0, 0.3]))
            weight = jnp.arange(24.0)
            return jnp.mean(weight * ProjectiveShadow().visibility(texture, moved, IS_CARD))

        at, step = jnp.float64(0.01), 1e-5
        slope = float((mean(at + step)[0] - mean(at - step)[0]) / (2 * step))
        assert abs(slope) > 1e-2
        assert float(mean(at)[1]) == pytest.approx(slope, rel=1e-2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"blur": -1.0}, "the projective texture's radius is -1.0 texels; expected 0 to max_radius"),
        ({"blur": 3.0, "max_blur": 2.0}, "the projective texture's radius is 3.0 texels; expected 0 to max_radius = 2"),
    ],
)
def test_impossible_blurs_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        draw_projective_texture(CARD, DOWN, (8, 8), **options)


def test_texture_knows_its_resolution():
    texture = draw_projective_texture(CARD, DOWN, (8, 16), 2.0)
    assert isinstance(texture, ProjectiveTexture)
    assert texture.resolution == (8, 16)
