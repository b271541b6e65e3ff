"""Shading against values worked out by hand."""

import dataclasses
import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow._arithmetic import as_float
from diffshadow.geometry import DirectionalLight, OrthographicCamera, PinholeCamera, PointLight, SpotLight
from diffshadow.raster import Surface
from diffshadow.shading import AbstractShading, Attenuation, ModulatedShadow, Phong

ALBEDO = (0.5, 0.25, 1.0)
UP = (0.0, 1.0, 0.0)


def surface(position=(0.0, 0.0, 0.0), normal=UP, mask=True) -> Surface:
    """A single pixel of surface."""
    row = lambda x: jnp.asarray(x, jnp.float32).reshape(1, 1, 3)
    seen = jnp.asarray([[mask]])
    return Surface(row(position), row(normal), row(normal), row(ALBEDO), jnp.where(seen, 0, -1), seen)


def sun(direction=(0.0, -1.0, 0.0)) -> DirectionalLight:
    return DirectionalLight.around(jnp.asarray(direction), jnp.asarray([[-1.0, -1, -1], [1, 1, 1]]))


def spot(height: float, inner_angle: float | None = None) -> SpotLight:
    return SpotLight((0, height, 0), (0, -1, 0), 30.0, 0.1, 10.0, inner_angle=inner_angle)


def camera(eye=(0.0, 2.0, 0.0)) -> PinholeCamera:
    return PinholeCamera(eye, (0, 0, 0), up=(0, 0, 1), resolution=(1, 1))


@eqx.filter_jit
def shaded(shading, *given):
    return shading(*given)


def pixel(shading: AbstractShading, surface: Surface, light, *, visibility=1.0, eye=None) -> np.ndarray:
    visibility = as_float(np.full((1, 1), visibility))
    return np.asarray(shaded(shading, surface, visibility, light, eye or camera()))[0, 0]


def test_facing_lit_plane_is_ambient_plus_diffuse_plus_specular():
    phong = Phong(ambient=0.2, intensity=(1.0, 0.5, 0.25), specular=0.3)
    expected = np.multiply(ALBEDO, 0.2) + np.multiply((1.0, 0.5, 0.25), np.add(ALBEDO, 0.3))
    np.testing.assert_allclose(pixel(phong, surface(), sun()), expected, rtol=1e-6)


@pytest.mark.parametrize("angle", [10.0, 45.0, 80.0])
def test_diffuse_falls_with_the_cosine(angle):
    a = math.radians(angle)
    light = sun((math.sin(a), -math.cos(a), 0.0))
    seen = pixel(Phong(ambient=0, intensity=1, specular=0), surface(), light)
    np.testing.assert_allclose(seen, np.multiply(ALBEDO, math.cos(a)), rtol=1e-5)


@pytest.mark.parametrize(("model", "cosine"), [("blinn_phong", math.cos(math.pi / 8)), ("phong", math.sqrt(0.5))])
def test_highlight_off_the_mirror_direction(model, cosine):
    # Light from 45°, eye overhead: H lies at 22.5° of the normal, R at 45° of the eye.
    light = sun((1.0, -1.0, 0.0))
    black = eqx.tree_at(lambda s: s.albedo, surface(), jnp.zeros((1, 1, 3)))
    seen = pixel(Phong(ambient=0, intensity=1, specular=1, shininess=20, model=model), black, light)
    np.testing.assert_allclose(seen, cosine**20, rtol=1e-4)


def test_orthographic_eye_looks_along_its_axis_everywhere():
    eye = OrthographicCamera((0, 2, 0), (0, 0, 0), up=(0, 0, 1), resolution=(1, 1))
    phong = Phong(ambient=0, intensity=1, specular=1)
    far_off = pixel(phong, surface(position=(5.0, 0.0, 3.0)), sun(), eye=eye)
    np.testing.assert_allclose(far_off, np.add(ALBEDO, 1), rtol=1e-6)


@pytest.mark.parametrize("light", [sun(), spot(3.0), spot(3.0, inner_angle=10)])
def test_shadow_never_touches_ambient(light):
    phong = Phong(ambient=(0.1, 0.2, 0.3), intensity=5.0, specular=1.0)
    np.testing.assert_array_equal(
        pixel(phong, surface(), light, visibility=0.0), np.multiply(ALBEDO, np.float32([0.1, 0.2, 0.3]))
    )


def test_half_shadow_halves_what_comes_from_the_light():
    phong = Phong(ambient=0, intensity=1)
    half, full = (pixel(phong, surface(), sun(), visibility=v) for v in (0.5, 1.0))
    np.testing.assert_allclose(half, full / 2, rtol=1e-6)


def test_surface_turned_away_has_neither_diffuse_nor_highlight():
    # Grazing: the halfway vector is still on the normal's side.
    light, eye = sun((1.0, 0.1, 0.0)), camera((1.0, 1.0, 0.0))
    seen = pixel(Phong(ambient=0.2, intensity=1, specular=1, shininess=1), surface(), light, eye=eye)
    np.testing.assert_allclose(seen, np.multiply(ALBEDO, 0.2), rtol=1e-6)


def test_attenuation_with_distance():
    phong = Phong(ambient=0, intensity=1, specular=0, attenuation=Attenuation(0.5, 0.25, 0.125))
    np.testing.assert_allclose(
        pixel(phong, surface(), spot(4.0)), np.multiply(ALBEDO, 1 / (0.5 + 1.0 + 2.0)), rtol=1e-6
    )
    np.testing.assert_allclose(pixel(phong, surface(), sun()), ALBEDO, rtol=1e-6)


def test_cone_is_full_inside_dark_outside_and_half_between():
    phong = Phong(ambient=0, intensity=1, specular=0)
    middle = math.acos((math.cos(math.radians(10)) + math.cos(math.radians(30))) / 2)
    for angle, share in ((0.0, 1.0), (math.radians(9.9), 1.0), (middle, 0.5), (math.radians(30.1), 0.0)):
        x = 2 * math.tan(angle)
        cosine = math.cos(angle)
        np.testing.assert_allclose(
            pixel(phong, surface(position=(x, 0, 0)), spot(2.0, inner_angle=10)),
            np.multiply(ALBEDO, cosine * share),
            atol=2e-4,
        )


def test_light_from_a_point_falls_off_with_distance_alone():
    phong = Phong(ambient=0, intensity=1, specular=0, attenuation=Attenuation(1.0, 0.0, 1.0))
    light = PointLight((0, 1, 0), 0.1, 10)
    seen = pixel(phong, surface(position=(math.sqrt(3), 0, 0)), light)
    np.testing.assert_allclose(seen, np.multiply(ALBEDO, 0.5 / 5), rtol=1e-5)


# --- Several lights ---


def test_several_lights_add_up_and_ambient_counts_once():
    phong, at, eye = Phong(ambient=0.2, intensity=0.4), surface(), camera((1.0, 2.0, 0.0))
    lights, visibilities = [sun((0.5, -1.0, 0.0)), spot(3.0), PointLight((1, 1, 1), 0.1, 10)], [0.25, 1.0, 0.5]
    shares = [jnp.full((1, 1), v) for v in visibilities]
    ambient = np.multiply(ALBEDO, 0.2)
    each = [pixel(phong, at, light, visibility=v, eye=eye) for light, v in zip(lights, visibilities, strict=True)]
    expected = ambient + sum(alone - ambient for alone in each)
    np.testing.assert_allclose(np.asarray(phong(at, shares, lights, eye))[0, 0], expected, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(phong(at, jnp.stack(shares), lights, eye))[0, 0], expected, rtol=1e-5)


def test_each_light_has_its_own_intensity():
    alone, own, eye = Phong(ambient=0), (0.4, (0.1, 0.2, 0.3)), camera((1.0, 2.0, 0.0))
    lights, full = [sun((0.5, -1.0, 0.0)), spot(3.0)], jnp.ones((2, 1, 1))
    several = Phong(ambient=0, intensities=own)
    pairs = zip(own, lights, strict=True)
    each = [pixel(dataclasses.replace(alone, intensity=i), surface(), light, eye=eye) for i, light in pairs]
    np.testing.assert_allclose(np.asarray(several(surface(), full, lights, eye))[0, 0], sum(each), rtol=1e-5)
    for shading in (several, ModulatedShadow(several)):
        seen = pixel(shading.of_light(1), surface(), lights[1], eye=eye)
        np.testing.assert_allclose(seen, each[1], rtol=1e-6)
    with pytest.raises(ValueError, match="intensities has 2 entries for 1 light; expected one for each light"):
        several(surface(), full[:1], lights[:1], eye)


@pytest.mark.parametrize("shading", [Phong(), ModulatedShadow()])
@pytest.mark.parametrize(("count", "said"), [(1, "1 visibility"), (3, "3 visibilities")])
def test_every_light_needs_its_visibility(shading, count, said):
    with pytest.raises(ValueError, match=f"{said} for 2 lights"):
        shading(surface(), [jnp.ones((1, 1))] * count, [sun(), spot(2.0)], camera())


# --- Modulated shadow ---


@pytest.mark.parametrize(("factor", "visibility"), [(0.5, 0.0), (0.5, 1.0), (0.25, 0.4), (0.0, 0.0), (1.0, 0.0)])
def test_modulated_shadow_multiplies_the_lit_colour_ambient_and_highlight_included(factor, visibility):
    lit = Phong(ambient=0.3, intensity=0.5, specular=0.4)
    seen = pixel(ModulatedShadow(lit, factor), surface(), sun(), visibility=visibility)
    expected = (factor + (1 - factor) * visibility) * pixel(lit, surface(), sun())
    np.testing.assert_allclose(seen, expected, rtol=1e-6)


def test_modulated_shadow_halves_by_default_and_leaves_the_background_alone():
    np.testing.assert_allclose(
        pixel(ModulatedShadow(), surface(), sun(), visibility=0.0), pixel(Phong(), surface(), sun()) / 2, rtol=1e-6
    )
    nothing = surface(normal=(0, 0, 0), mask=False)
    np.testing.assert_allclose(pixel(ModulatedShadow(), nothing, sun(), visibility=0.0), Phong().background, rtol=1e-6)


def test_modulated_shadows_of_several_lights_multiply():
    lights, shares = [sun(), spot(2.0)], [jnp.full((1, 1), v) for v in (0.0, 0.5)]
    lit = Phong()(surface(), jnp.ones((2, 1, 1)), lights, camera())
    seen = ModulatedShadow(Phong(), 0.5)(surface(), shares, lights, camera())
    np.testing.assert_allclose(seen, 0.5 * 0.75 * np.asarray(lit), rtol=1e-6)


def test_background_shows_where_there_is_no_surface():
    phong = Phong(background=(0.1, 0.2, 0.3))
    nothing = surface(normal=(0, 0, 0), mask=False)
    np.testing.assert_allclose(pixel(phong, nothing, sun()), (0.1, 0.2, 0.3), rtol=1e-6)


@eqx.filter_jit
def slopes_of_brightness(arguments, where, camera):
    """Of a pixel's colours, by shading, position, normal, visibility and light."""

    def brightness(arguments):
        phong, position, normal, visibility, light = arguments
        at = Surface(position, normal, normal, where.albedo, where.face, where.mask)
        return jnp.sum(phong(at, visibility, light, camera))

    return eqx.filter_grad(brightness)(arguments)


SHONE_ON = {"sun": sun(), "full spot": spot(2.0), "spot": spot(2.0, inner_angle=10)}
# The highlight does not depend on what kind of light makes it.
USUAL = [("blinn_phong", "spot"), ("phong", "sun")]


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("model", "light"),
    [
        pytest.param(*case, marks=[] if case in USUAL else pytest.mark.exhaustive)
        for case in itertools.product(("blinn_phong", "phong"), SHONE_ON)
    ],
)
@pytest.mark.parametrize(
    "where",
    [
        surface(),
        surface(normal=(0, 0, 0), mask=False),
        surface(position=(0, 2, 0)),  # at the eye and at the light
        surface(normal=(1, 0, 0)),  # at right angles to light and eye
    ],
)
def test_gradients_are_finite_everywhere(model, light, where):
    phong = Phong(model=model, attenuation=Attenuation(1, 1, 1))
    at = (phong, where.position, where.shading_normal, jnp.ones((1, 1)), SHONE_ON[light])
    gradients = slopes_of_brightness(at, where, camera())
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(gradients))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Phong(model="lambert"), "lambert"),
        (lambda: Phong(shininess=0.0), "shininess"),
        (lambda: ModulatedShadow(factor=1.5), "factor"),
        (lambda: Attenuation(0.0, 1.0, 1.0), "Attenuation"),
        (lambda: Attenuation(1.0, -1.0, 0.0), "Attenuation"),
    ],
)
def test_nonsense_is_refused_by_name(make, said):
    with pytest.raises((ValueError, TypeError), match=said):
        make()
