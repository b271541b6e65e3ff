"""Projective texture shadows: the shadow of a square, its blur, what they do not darken, and their gradients."""

import jax
import numpy as np
import pytest
from scenes import floor_surface, quad, side_camera

from diffshadow.geometry import DirectionalLight, OrthographicCamera, PointLight, Scene, SpotLight
from diffshadow.raster import draw_surface
from diffshadow.shadow import ProjectiveShadow, ProjectiveTexture

DOWN = DirectionalLight((0, -1, 0), (0, 0, 0), (4, 4), -3, 3)
"""Straight down on a map 4 world units wide."""
TEXELS = 128
HALF = 0.5
"""Of the card's width, world units: 16 texels."""
CARD = quad((0, 1, 0), (HALF, 0, 0), (0, 0, -HALF))
FLOOR = quad((0, 0, 0), (1.5, 0, 0), (0, 0, -1.5))
CAMERA = OrthographicCamera((0, 2, 0), (0, 0, 0), (0, 0, -1), height=3.0)
# All textures and images are of one size, and all can be blurred as far, so that they share what is compiled.
MAX_BLUR = 10.0


# Visibility depends on the texture alone.
ANY = ProjectiveShadow()


@pytest.fixture(scope="module")
def floor():
    """The floor under the card, 3 world units wide, seen straight down; the card is above the camera."""
    return floor_surface(1.5, (TEXELS, TEXELS))


def scene_of(light):
    return Scene([FLOOR, CARD], CAMERA, light, casts=(False, True))


def texture_of(light=DOWN, blur=0.0, kernel="box"):
    technique = ProjectiveShadow((TEXELS, TEXELS), blur, max_blur=MAX_BLUR, kernel=kernel)
    return technique.prepare(scene_of(light))


def project(floor, blur=0.0, light=DOWN, **options):
    return np.asarray(ANY.visibility(texture_of(light, blur, **options), floor))


def test_shadow_of_a_square_is_the_square(floor):
    visibility = project(floor)
    x, z = np.asarray(floor.position)[..., 0], np.asarray(floor.position)[..., 2]
    outside = np.maximum(np.abs(x), np.abs(z)) - HALF
    texel = 4 / TEXELS
    # The look-up is bilinear between texels that are covered or not: it blurs by one of them.
    assert np.all(visibility[outside < -texel] == 0)
    assert np.all(visibility[outside > texel] == 1)
    lit = visibility.mean() * 9
    assert lit == pytest.approx(9 - (2 * HALF) ** 2, abs=0.02)


@pytest.mark.parametrize("blur", [0.5, 3.0, 4.7, 9.25])
def test_blur_makes_a_ramp_of_its_own_width(floor, blur):
    middle = project(floor, blur)[64]
    x = np.asarray(floor.position)[64, :, 0]
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
    below = quad((0, 0.5, 0), (0.2, 0, 0), (0, 0, 0.2))
    scene = Scene([FLOOR, CARD, below], side_camera((TEXELS, TEXELS)), DOWN, casts=(False, True, True))
    surface = draw_surface(scene.mesh, scene.camera)
    technique = ProjectiveShadow((TEXELS, TEXELS), max_blur=MAX_BLUR)
    shadows = lambda scene: np.asarray(technique.visibility(technique.prepare(scene), surface))
    visibility = shadows(scene)
    face = np.asarray(surface.face)
    # The small card hangs in the shadow of the large one, and is a caster itself.
    assert np.isin([4, 5], face).any()
    assert np.all(visibility[face >= 2] == 1)
    assert visibility[np.isin(face, (0, 1))].min() == 0
    up = DirectionalLight((0, 1, 0), (0, 0, 0), (4, 4), -3, 3)
    from_below = Scene(scene.meshes, scene.camera, up, scene.casts)
    assert np.all(shadows(from_below)[np.isin(face, (0, 1))] == 0)


def test_what_the_texture_does_not_show_is_lit(floor):
    narrow = DirectionalLight((0, -1, 0), (0, 0, 0), (0.6, 0.6), -3, 3)
    visibility = project(floor, 2.0, light=narrow)
    shown = np.asarray(ANY.covered(texture_of(narrow, 2.0), floor))
    reach = np.abs(np.asarray(floor.position)[..., [0, 2]]).max(axis=-1)
    assert np.array_equal(shown, reach <= 0.3)
    assert np.all(visibility[reach < 0.28] == 0)
    assert np.all(visibility[reach > 0.32] == 1)


def test_what_lies_behind_the_light_is_lit(floor):
    # The floor lies behind a spot light that shines upwards at the card.
    light = SpotLight((0, 0.5, 0), (0, 1, 0), 60, 0.01, 2)
    texture = texture_of(light)
    assert np.asarray(texture.coverage).max() == 1
    assert not np.asarray(ANY.covered(texture, floor)).any()
    # The floor's upper side faces the light, which lies above it.
    assert np.all(np.asarray(ANY.visibility(texture, floor)) == 1)


@pytest.mark.exhaustive
def test_point_light_projects_as_a_spot_light_that_looks_the_same_way(floor):
    spot = SpotLight((0, 2, 0), (0, -1, 0), 45, 0.1, 4)
    point = PointLight((0, 2, 0), 0.1, 4, guard=0.0)
    textures = [texture_of(light) for light in (spot, point)]
    images = [np.asarray(ANY.visibility(texture, floor)) for texture in textures]
    assert (images[0] == 0).any()
    # The one texture may stand upside down.
    assert np.abs(images[0] - images[1]).max() < 1e-5 or np.abs(images[0] - images[1][::-1]).mean() < 0.01
    assert textures[1].coverage.shape[0] == 6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"blur": -1.0}, "blur is -1.0; expected a number at least 0 and at most 256, in texels"),
        ({"blur": 3.0, "max_blur": 2.0}, "blur is 3.0 and max_blur is 2.0; expected blur at most max_blur"),
    ],
)
def test_impossible_blurs_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        ProjectiveShadow((8, 8), **options)


def test_texture_knows_its_resolution():
    prepare = lambda: ProjectiveShadow((8, 16), 2.0).prepare(scene_of(DOWN))
    texture = jax.eval_shape(prepare)
    assert isinstance(texture, ProjectiveTexture)
    assert texture.resolution == (8, 16)
