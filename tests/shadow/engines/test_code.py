"""Code for three.js: it makes the light that the settings hold for."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from engine_states import light_of
from golden_engines import engine_golden

from diffshadow.geometry import DirectionalLight, MatrixLight, PointLight, RectangleLight, SpotLight
from diffshadow.shadow import BabylonJs, Bevy, EngineLight, GodotCompatibility, PlayCanvas, ThreeJs, engine_code
from diffshadow.shadow.engines._axes import engine_light

SUN = DirectionalLight((0.3, -1.0, -0.2), (0.5, 1, 0), (4.0, 2.0), -3.0, 3.0)


def basis(position, target) -> np.ndarray:
    """Rows right, up and backward of three.js' `lookAt`, with +y up."""
    backward = np.subtract(position, target)
    backward /= np.linalg.norm(backward)
    right = np.cross([0, 1, 0], backward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(backward, right), backward])


def window(given: EngineLight, points: np.ndarray, resolution) -> np.ndarray:
    """Window coordinates (n, 3) of points, from the engine's settings alone."""
    x, y, z = basis(given.position, given.target) @ (points - given.position).T
    n, f = given.near, given.far
    if given.window is not None:
        left, right, top, bottom = (given.window[key] for key in ("left", "right", "top", "bottom"))
        return np.stack([(x - left) / (right - left), (y - bottom) / (top - bottom), (-z - n) / (f - n)], axis=-1)
    height, width = resolution
    scale = 1 / math.tan(given.angle)
    u, v = x / -z * scale / (given.aspect * width / height), y / -z * scale
    return np.stack([u / 2 + 0.5, v / 2 + 0.5, f * (-z - n) / (-z * (f - n))], axis=-1)


@pytest.mark.parametrize("resolution", [(64, 64), (32, 64)])
@pytest.mark.parametrize("light", [SUN, SpotLight((1, 3, 2), (-0.4, -1, -0.3), 30.0, 0.5, 9.0)], ids=["sun", "spot"])
def test_the_engines_light_sees_what_the_librarys_sees(light, resolution):
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    clip = np.asarray(light.view().clip(jnp.asarray(points, jnp.float32)))
    expected = clip[:, :3] / clip[:, 3:] / 2 + 0.5
    found = window(EngineLight.of(light, resolution), points, resolution)
    # The far plane is elsewhere only by rounding; a directional light's near plane is where the light is put.
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=1e-5)
    if isinstance(light, SpotLight):
        np.testing.assert_allclose(found[:, 2], expected[:, 2], atol=1e-5)
    else:
        slope = np.polyfit(expected[:, 2], found[:, 2], 1)
        np.testing.assert_allclose(slope, [1, 0], atol=1e-5)


@pytest.mark.parametrize("name", ["directional_pcf_oblong", "spot_pcf_oblong_focus", "point_pcf_distance"])
def test_a_light_of_the_engine_comes_back(name):
    golden = engine_golden("three", name)
    settings, info = golden.settings["light"], golden.info
    size = settings["mapSize"]
    width, height = size if isinstance(size, list) else (size, size)
    found = EngineLight.of(light_of(golden), (height, width))
    assert found.far - found.near == pytest.approx(info["far"] - info["near"], rel=1e-5)
    if found.window is not None:
        assert found.window == pytest.approx({key: settings["camera"][key] for key in found.window}, abs=1e-5)
    if found.angle is not None:
        # The engine multiplies the angle by the focus.
        assert found.angle == pytest.approx(settings["angle"] * settings["focus"], rel=1e-5)
        assert found.aspect == pytest.approx(settings["aspect"], rel=1e-5)
    if found.target is None:
        assert found.position == pytest.approx(settings["position"])


PLACED = [
    DirectionalLight((-2.2, -3.8, -1.6), (2.2, 4, 1.6), (4.0, 3.0), 0.1, 8.7),
    SpotLight((2.2, 4, 1.6), np.subtract((0, 0.2, 0), (2.2, 4, 1.6)), 30.0, 0.1, 8.7),
]


@pytest.mark.parametrize("light", PLACED, ids=["sun", "spot"])
def test_code_has_the_numbers_that_a_light_was_given(light):
    code = engine_code(ThreeJs(bias=-0.0007, resolution=(64, 64)), light, (1.0, 5.0))
    assert "light.position.set(2.2, 4, 1.6);" in code
    assert "light.target.position.set(0, 0.2, 0);" in code
    assert "near: 0.1, far: 8.7 }" in code
    assert "light.shadow.bias = -0.0007;" in code
    if isinstance(light, DirectionalLight):
        assert "{ left: -2, right: 2, top: 1.5, bottom: -1.5," in code
    code = engine_code(BabylonJs(resolution=(64, 64)), light, (1.0, 5.0))
    assert "light.position = new BABYLON.Vector3(2.2, 4, 1.6);" in code
    assert "light.direction = new BABYLON.Vector3(-2.2, -3.8, -1.6);" in code
    # Of its matrices, no digits are printed that their rounding does not leave.
    code = engine_code(ThreeJs(), MatrixLight(light.view().world_to_eye, light.view().eye_to_clip), (1.0, 5.0))
    assert "light.position.set(2.2, 4, 1.6);" in code
    assert "near: 0.1, far: 8.7 }" in code


def test_a_number_without_a_shorter_form_keeps_all_digits_of_single_precision():
    value = np.float32(-0.028972616)
    code = engine_code(ThreeJs(bias=value, normal_bias=1e-8), SUN, (1.0, 5.0))
    assert f"light.shadow.bias = {value!s};" in code
    assert "light.shadow.normalBias = 1e-08;" in code


@pytest.mark.parametrize("light", PLACED, ids=["sun", "spot"])
def test_an_engines_light_is_where_it_was_put(light):
    """Its matrix is rounded once, from the position: far from the origin, one more rounding would be seen."""
    at = np.float32([220.2, 400.4, 160.6])
    eye = {"center": at} if isinstance(light, DirectionalLight) else {"position": at}
    moved = engine_light(dataclasses.replace(light, **eye), 0.0)
    points = at + np.random.default_rng(0).uniform(-1, 1, (50, 3))
    rows = basis(np.zeros(3), np.asarray(light.direction, np.float64))
    matrix = np.asarray(moved.world_to_eye, np.float64)
    found = points @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(found, (points - at) @ rows.T, atol=4e-5)


def test_code_says_what_a_bias_amounts_to():
    technique = ThreeJs(bias=-0.001, normal_bias=0.02, radius=2.0, resolution=(64, 128), shadow_side="double")
    code = engine_code(technique, SUN, (1.0, 5.0))
    assert "light.shadow.bias = -0.001;  // 0.006 world units towards the light" in code
    assert "light.shadow.normalBias = 0.02;  // world units, 0.64 texels" in code
    assert "light.shadow.mapSize.set(128, 64);" in code
    assert "material.shadowSide = THREE.DoubleSide;" in code
    lamp = PointLight((0, 1, 0), 0.5, 10.0)
    code = engine_code(technique, lamp, (1.0, 2.0))
    # b D d² / (f n) at both distances.
    assert "-0.001;  // 0.0019 world units at the distance 1, 0.0076 at 2" in code
    assert "target" not in code


def test_code_of_a_far_light_has_its_place_in_the_world():
    light, origin = SpotLight((0.1, 2.25, 0), (0, -1, 0.5), 30, 0.5, 5), (600000.0, 0.0, -3e6)
    near, far = (engine_code(ThreeJs(), light, (1.0, 2.0), at) for at in ((0.0, 0.0, 0.0), origin))
    assert "light.position.set(600000.1, 2.25, -3000000);" in far
    assert "light.target.position.set(600000.1, 1.25, -2999999.5);" in far
    assert [line for line in near.splitlines() if "position" not in line] == [
        line for line in far.splitlines() if "position" not in line
    ]
    code = engine_code(BabylonJs(resolution=(64, 64)), light, (1.0, 2.0), origin)
    assert "light.position = new BABYLON.Vector3(600000.1, 2.25, -3000000);" in code
    assert "light.direction = new BABYLON.Vector3(0, -1, 0.5);" in code


def test_babylons_window_is_the_mirror_image():
    offset = DirectionalLight((0.3, -1.0, -0.2), (0.5, 1, 0), (4.0, 2.0), -3.0, 3.0).view()
    projection = np.array(offset.eye_to_clip)
    projection[0, 3] = -0.25
    light = MatrixLight(offset.world_to_eye, projection)
    given = EngineLight.of(light, (64, 64)).window
    code = engine_code(BabylonJs(bias=0.01, filter="PCF", resolution=(64, 64)), light, (1.0, 5.0))
    assert given["left"] == pytest.approx(-1.5)
    assert "light.orthoLeft = -2.5;" in code
    assert "light.orthoRight = 1.5;" in code
    # Half of Babylon.js' bias is window depth, in PCF.
    assert "generator.bias = 0.01;  // 0.03 world units towards the light" in code
    code = engine_code(BabylonJs(bias=0.01, filter="NONE", resolution=(64, 64), float_maps=True), light, (1.0, 5.0))
    assert "generator.bias = 0.01;  // 0.06 world units" in code
    assert "new BABYLON.ShadowGenerator(64, light, true)" in code
    spot = SpotLight((1, 3, 2), (-0.4, -1, -0.3), 30.0, 0.5, 9.0)
    code = engine_code(BabylonJs(filter="BLUREXPONENTIALSHADOWMAP", resolution=(64, 64)), spot, (1.0, 5.0))
    assert f"light.angle = {np.float32(np.radians(60))!s};" in code
    assert "generator.blurBoxOffset = 1;" in code
    assert "generator.depthScale = 50;" in code


def test_what_casts_is_said():
    babylon = BabylonJs(force_back_faces_only=True, back_face_culling=False, resolution=(64, 64))
    code = engine_code(babylon, SUN, (1.0, 5.0))
    assert "generator.forceBackFacesOnly = true;" in code
    assert "material.backFaceCulling = false;" in code
    code = engine_code(BabylonJs(back_face_culling=(True, False), resolution=(64, 64)), SUN, (1.0, 5.0))
    assert "// material.backFaceCulling of each mesh: true, false" in code
    code = engine_code(ThreeJs(side=("front", "double"), reversed_depth=True), SUN, (1.0, 5.0))
    assert "// material.side of each mesh: THREE.FrontSide, THREE.DoubleSide" in code
    assert "reversedDepthBuffer: true" in code


def test_zero_has_no_sign():
    code = engine_code(ThreeJs(bias=-0.0, normal_bias=-1e-30, shadow_type="BasicShadowMap"), SUN, (1.0, 5.0))
    assert "bias = 0;" in code
    assert "normalBias = -1e-30;" in code
    assert "radius" not in code


def test_lights_that_the_engine_lacks_are_named():
    view = SUN.view()
    oblique = np.array(SpotLight((1, 3, 2), (0, -1, 0), 30.0, 0.5, 9.0).view().eye_to_clip)
    oblique[0, 2] = 0.3
    with pytest.raises(ValueError, match="off its axis"):
        engine_code(ThreeJs(), MatrixLight(view.world_to_eye, oblique), (1.0, 2.0))
    area = RectangleLight((0, 3, 0), (0, -1, 0), (1.0, 1.0), 45.0, 0.1, 9.0)
    with pytest.raises(ValueError, match="RectangleLight; expected a directional, spot, point or matrix light"):
        engine_code(ThreeJs(), area, (1.0, 2.0))


def test_engines_that_fit_their_cameras_are_given_the_lights_direction():
    sun = PlayCanvas.directional_light((1.0, -2.0, 0.5))
    code = engine_code(PlayCanvas(shadow_bias=0.1, num_cascades=3, resolution=(64, 64)), sun, (1.0, 5.0))
    assert "entity.lookAt(entity.getPosition().clone().add(new pc.Vec3(1, -2, 0.5)));" in code
    assert "entity.light.shadowBias = 0.1;  // casters move away by 1 of their depth's steps" in code
    assert "entity.light.cascadeDistribution = 0.5;" in code
    code = engine_code(Bevy(shadow_normal_bias=1.0, resolution=(64, 64)), sun, (1.0, 5.0))
    assert "Transform::default().looking_to(Vec3::new(1.0, -2.0, 0.5), Vec3::Y)," in code
    assert "shadow_normal_bias: 1.4142 texels along the normal." in code
    code = engine_code(GodotCompatibility(resolution=(64, 64)), sun, (1.0, 5.0))
    assert "light.look_at_from_position(Vector3.ZERO, Vector3(1, -2, 0.5))" in code
    assert "light.directional_shadow_mode = DirectionalLight3D.SHADOW_PARALLEL_4_SPLITS" in code


def test_positional_lights_stand_where_they_were_put():
    spot = Bevy.spot_light((1.0, 3.0, 2.0), (-0.4, -1.0, -0.3), outer_angle=0.5, range=8.0)
    code = engine_code(Bevy(resolution=(64, 64)), spot, (1.0, 5.0))
    # Rust takes no whole number for a float.
    assert "Transform::from_xyz(1.0, 3.0, 2.0).looking_at(Vec3::new(0.6, 2.0, 1.7), Vec3::Y)" in code
    assert "outer_angle: 0.5, range: 8.0, shadow_map_near_z: 0.1, ..default()" in code
    lamp = PlayCanvas.omni_light((0.0, 2.0, 0.0), range=5.0)
    code = engine_code(PlayCanvas(resolution=(64, 64), side=("front", "double")), lamp, (1.0, 5.0))
    assert "entity.light.shadowBias = 0.05;  // 0.0025 world units towards the light" in code
    assert "// material.cull of each mesh: pc.CULLFACE_BACK, pc.CULLFACE_NONE" in code
    code = engine_code(GodotCompatibility(resolution=(64, 64)), lamp, (1.0, 5.0))
    # A cube's face is half as wide as the light's part, and this a half of the atlas.
    assert "get_viewport().positional_shadow_atlas_size = 256" in code
