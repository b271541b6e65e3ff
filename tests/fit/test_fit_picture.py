"""Fits to pictures: what moves and takes which colour, gradients against differences, and that fits find the truth."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import lamp, quad, sun

from diffshadow import fit, geometry, raster, reference, shading, shadow
from diffshadow.fit._precision import precision_of

FLOOR = quad((0, 0, 0), (3, 0, 0), (0, 0, -3))
BOX = geometry.library_mesh("box").transformed(geometry.translation(jnp.asarray([0.1, 0.2, 0.15])))
FLOOR, BOX = (
    dataclasses.replace(mesh, albedo=jnp.broadcast_to(jnp.asarray(colour), mesh.faces.shape))
    for mesh, colour in ((FLOOR, (0.7, 0.6, 0.5)), (BOX, (0.8, 0.3, 0.2)))
)
CAMERA = geometry.PinholeCamera((1.1, 3.0, 4.2), (0.05, 0.3, 0), fov_y=40, near=1, far=12, resolution=(64, 64))
SCENE = geometry.Scene([FLOOR, BOX], CAMERA, sun(geometry.merge([FLOOR, BOX]), direction=(-0.55, -1, -0.3)))
TECHNIQUE = shadow.ShadowMapping(
    shadow.Bilinear(), shadow.Bias(constant=0.5, slope=1.0), map=shadow.MapSettings((128, 128))
)
EMPTY = np.zeros((64, 64, 3))
MOVES = {
    "camera.eye.x": 0.01,
    "camera.turn.y": 0.1,
    "camera.turn.z": 0.2,
    "lights.0.azimuth": 0.5,
    "meshes.1.translate.x": 0.01,
    "meshes.1.turn.y": 0.5,
}


def problem(picture=EMPTY, **how):
    return fit.PictureProblem.of(SCENE, TECHNIQUE, picture, **how)


def start(arrangement, path):
    return float(fit.resolve(arrangement, path))


def traced(arrangement, rays=8):
    """The picture by rays."""
    scene = arrangement.placed(SCENE)
    fine = dataclasses.replace(scene.camera, resolution=tuple(rays * side for side in scene.camera.resolution))
    truth = reference.trace_visibility(dataclasses.replace(scene, camera=fine), samples=1)
    seen = raster.draw_surface(scene.mesh, fine)
    image = np.asarray(arrangement.shading(seen, jnp.asarray(truth.visibility), scene.light, fine))
    return image.reshape(64, rays, 64, rays, 3).mean(axis=(1, 3))


def test_an_arrangement_of_a_picture_names_camera_colours_and_exposure():
    arrangement = fit.Arrangement.of_picture(TECHNIQUE, SCENE, shading.Phong(), 0.0)
    named = set(fit.parameter_names(arrangement))
    assert {"camera.eye.x", "camera.turn.z", "camera.fov_y", "meshes.1.albedo.red", "exposure"} <= named
    assert {"shading.ambient.blue", "shading.intensity.red", "shading.specular", "lights.0.azimuth"} <= named
    np.testing.assert_allclose(start(arrangement, "meshes.1.albedo.green"), 0.3)
    # Two colours of one mesh have no single one.
    two = dataclasses.replace(BOX, albedo=BOX.albedo.at[0].set(0.1))
    mixed = dataclasses.replace(SCENE, meshes=[FLOOR, two])
    assert fit.Arrangement.of_picture(TECHNIQUE, mixed, shading.Phong(), 0.0).meshes[1].albedo is None
    assert fit.MeshPose.of(two, coloured=True).albedo is None


def test_a_mesh_takes_the_colour_of_its_pose():
    pose = fit.MeshPose.of(BOX, coloured=True)
    red = fit.with_values(pose, ["albedo.red", "albedo.blue"], jnp.asarray([0.9, 0.1]))
    albedo = np.asarray(red.placed(BOX).albedo)
    np.testing.assert_allclose(albedo, np.broadcast_to([0.9, 0.3, 0.1], albedo.shape), rtol=1e-6)


@pytest.mark.parametrize(
    ("picture", "how", "said"),
    [
        (np.zeros((32, 64, 3)), {}, r"the picture has shape \(32, 64, 3\).*64 rows and 64 columns"),
        (np.full((64, 64, 3), np.nan), {}, "not finite; expected numbers: mask them out"),
    ],
)
def test_a_picture_that_does_not_suit_the_camera_is_reported(picture, how, said):
    with pytest.raises(ValueError, match=said):
        problem(picture, **how)


def test_pixels_that_are_masked_out_may_hold_anything():
    picture, mask = EMPTY.copy(), np.ones((64, 64), bool)
    picture[:3], mask[:3] = np.nan, False
    given = problem(picture, mask=mask)
    assert np.isfinite(np.asarray(given.reference)).all()
    np.testing.assert_array_equal(given.count, [61 * 64] * 3)


def test_precision_of_a_picture_takes_its_channels_as_one():
    """Three equal channels say as much as one of them, and three independent pictures say more."""
    rng = np.random.default_rng(0)
    residual, slope = rng.normal(0, 0.1, (1, 24, 24)), rng.normal(0, 1, (1, 24, 24))
    alone = precision_of("a", [residual], [slope], [0.0], np.ones(1))
    channels = precision_of("a", [residual] * 3, [slope] * 3, [0.0] * 3, np.ones(1), 3)
    pictures = precision_of("a", [residual] * 3, [slope] * 3, [0.0] * 3, np.ones(1))
    assert channels.deviations["a"] == pytest.approx(alone.deviations["a"], rel=0.02)
    assert pictures.deviations["a"] < channels.deviations["a"]


@pytest.fixture(scope="module")
def drawn():
    """The arrangement, its picture, and a compiled picture with its derivative along one path."""
    given = problem().planned()
    paths = tuple(MOVES)

    @jax.jit
    def pushed(values, way):
        at = lambda values: given.difference(fit.with_values(given.arrangement, paths, values))
        return jax.jvp(at, (values,), (way,))

    values = jnp.asarray([start(given.arrangement, path) for path in paths])
    return given, values, pushed


@pytest.mark.exhaustive
def test_a_drawn_picture_is_that_of_rays(drawn):
    given, _, _ = drawn
    picture = np.asarray(given.picture(given.arrangement))
    truth = traced(given.arrangement)
    assert np.sqrt(np.mean((picture - truth) ** 2)) < 0.008
    # As sRGB, with two stops less.
    dark = dataclasses.replace(given, encoding="srgb")
    arrangement = dataclasses.replace(given.arrangement, exposure=jnp.asarray(-2.0))
    np.testing.assert_allclose(dark.picture(arrangement), shading.to_srgb(np.clip(picture / 4, 0, 1)), atol=2e-5)


@pytest.mark.exhaustive
def test_a_fit_finds_camera_sun_and_colour_of_a_traced_picture():
    truth = problem().arrangement
    given = problem(traced(truth))
    off = {
        "camera.eye.x": (0.1, 0.4, "world units"),
        "camera.turn.y": (2.0, 8.0, "degrees"),
        "lights.0.azimuth": (5.0, 20.0, "degrees"),
        "meshes.1.albedo.red": (-0.2, 0.19, ""),
        "shading.ambient.green": (0.1, 0.29, ""),
    }
    parameters = []
    for path, (away, reach, unit) in off.items():
        value = start(truth, path)
        first = value + away
        parameters.append(fit.Parameter(path, first, min(value, first) - reach, max(value, first) + reach, unit))
    parameters = [
        dataclasses.replace(p, lower=max(p.lower, 0.0), upper=min(p.upper, 1.0)) if p.unit == "" else p
        for p in parameters
    ]
    found = fit.fit(given, parameters, on_step=lambda step: None)
    assert found.errors[1] < 0.008 < found.errors[0]
    for path, bound in zip(off, (0.003, 0.03, 0.1, 0.003, 0.003), strict=True):
        assert found.fitted[path] == pytest.approx(start(truth, path), abs=bound), path
    assert found.precision is not None
    assert all(0 < deviation < 0.3 for deviation in found.precision.deviations.values())
    assert found.arrangement.placed(SCENE).camera.resolution == (64, 64)


TWO = dataclasses.replace(SCENE, lights=[SCENE.light, lamp(SCENE.mesh, (-1.2, 2.5, 1.5))])
EACH = shading.Phong(intensities=[(0.5, 0.45, 0.4), (0.3, 0.35, 0.5)], specular=0.0)
OF_LIGHTS = tuple(f"shading.intensities.{i}.{channel}" for i in range(2) for channel in ("red", "green", "blue"))


@pytest.fixture(scope="module")
def two_lights():
    """The problem of a scene under a sun and a spot light, with its picture by rays. Nothing moves."""
    truth = fit.Arrangement.of_picture(TECHNIQUE, TWO, EACH, 0.0)
    surface = raster.draw_antialiased(TWO.mesh, CAMERA)
    return fit.PictureProblem.of(TWO, TECHNIQUE, traced_under_all(truth), arrangement=truth, surface=surface)


def traced_under_all(arrangement, rays=4):
    fine = dataclasses.replace(CAMERA, resolution=(rays * 64, rays * 64))
    scene = dataclasses.replace(TWO, camera=fine)
    seen = raster.draw_surface(scene.mesh, fine)
    visibility = [reference.trace_visibility(scene.lit_by(i), samples=1).visibility for i in range(2)]
    image = np.asarray(arrangement.shading(seen, jnp.asarray(np.stack(visibility)), scene.lights, fine))
    return image.reshape(64, rays, 64, rays, 3).mean(axis=(1, 3))


@pytest.mark.exhaustive
def test_a_fit_finds_the_intensity_of_each_light(two_lights):
    parameters = [fit.Parameter(path, 0.2 if ".1." in path else 0.7, 0.0, 1.0, "") for path in OF_LIGHTS]
    found = fit.fit(two_lights, parameters)
    for path in OF_LIGHTS:
        assert found.fitted[path] == pytest.approx(start(two_lights.arrangement, path), rel=0.01), path
    assert found.precision is not None
    assert found.precision.undetermined == []


@pytest.mark.exhaustive
def test_a_scale_that_colours_and_lights_have_in_common_is_reported(two_lights):
    free = ["shading.ambient.red", *(f"meshes.{i}.albedo.red" for i in range(2)), *OF_LIGHTS[::3]]
    parameters = [fit.Parameter(path, start(two_lights.arrangement, path), 0.01, 1.0, "") for path in free]
    found = fit.fit(dataclasses.replace(two_lights, surface=None), parameters)
    assert found.precision is not None
    assert found.precision.undetermined == [tuple(free)]
