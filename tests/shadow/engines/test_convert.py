"""Settings of engines: one bias in their units."""

import math

import numpy as np
import pytest

from diffshadow.geometry import DirectionalLight, PinholeCamera, PointLight, Scene, SpotLight, library_mesh
from diffshadow.shadow import (
    BabylonJs,
    GodotCompatibility,
    PlayCanvas,
    ThreeJs,
    castano_radius,
    engine_settings,
    light_frame,
    radius_settings,
)

# Windows that are not square: texels are as large as in one of 4 by 4 world units, of the spot light at distance 2.
SUN = DirectionalLight((0.3, -1.0, -0.2), (0.5, 1, 0), (2.0, 8.0), -3.0, 5.0)
SPOT = SpotLight((1, 3, 2), (-0.4, -1, -0.3), math.degrees(math.atan(2)), 0.5, 10.0, aspect=0.25)
LAMP = PointLight((0, 2, 0), 0.5, 10.0)
SHIFT, TEXELS, SIZE = 0.02, 1.5, (100, 100)
# n f / (D d²) at d = 2.
SLOPE = 0.5 * 10 / (9.5 * 4)


def plain_bias(technique, light, distance):
    return technique.plain(light_frame(light, technique.resolution, distance), distance)


def values(light, distance=2.0) -> dict[tuple[str, str], float | None]:
    return {(each.engine, each.setting): each.value for each in engine_settings(light, SIZE, SHIFT, TEXELS, distance)}


@pytest.mark.parametrize(
    ("light", "engine", "setting", "expected"),
    [
        (SUN, "three.js", "light.shadow.bias", -SHIFT / 8),
        (SPOT, "three.js", "light.shadow.bias", -SHIFT * SLOPE),
        (LAMP, "three.js", "light.shadow.bias", -SHIFT * SLOPE),
        (SUN, "three.js", "light.shadow.normalBias", TEXELS * 4 / 100),
        (SPOT, "three.js", "light.shadow.normalBias", TEXELS * 4 / 100),
        (SUN, "Babylon.js", "generator.bias (PCF)", 2 * SHIFT / 8),
        (SPOT, "Babylon.js", "generator.bias (PCF)", 2 * SHIFT * SLOPE),
        (SPOT, "Babylon.js", "generator.bias (NONE, POISSON, ESM)", SHIFT / 9.5),
        (LAMP, "Babylon.js", "generator.bias (PCF)", SHIFT / 10.5),
        (SUN, "Godot 4", "shadow_bias", 100 * SHIFT / 8),
        (SPOT, "Godot 4", "shadow_bias", 2.5 * SHIFT / 2),
        (LAMP, "Godot 4", "shadow_bias", SHIFT),
        (SUN, "Bevy", "shadow_depth_bias", SHIFT),
        (SPOT, "Bevy", "shadow_normal_bias", TEXELS / math.sqrt(2)),
        (SUN, "Filament", "normalBias", 2 * TEXELS),
        (SPOT, "Filament", "normalBias", TEXELS),
        (SUN, "Unity URP", "shadowBias (depth)", SHIFT / 0.04),
        (LAMP, "Unity URP", "shadowNormalBias", 0),
    ],
)
def test_a_shift_in_an_engines_unit(light, engine, setting, expected):
    assert values(light)[engine, setting] == pytest.approx(expected, rel=1e-5)


def test_only_engines_that_were_run_are_verified():
    for light in (SUN, SPOT, LAMP):
        verified = {each.engine for each in engine_settings(light, SIZE, SHIFT, TEXELS, 2.0) if each.is_verified}
        # Of Bevy, not its point light.
        assert verified == {"three.js", "Babylon.js", *(() if light is LAMP else ("Bevy",))}


def test_no_bias_is_no_bias_everywhere():
    for each in engine_settings(SUN, SIZE, 0.0, 0.0, 2.0):
        assert str(each.value) == "0.0"


def test_a_place_behind_the_light_is_refused():
    with pytest.raises(ValueError, match=r"distance is -1.0; expected world units in front"):
        engine_settings(SPOT, SIZE, SHIFT, TEXELS, -1.0)


def test_engines_with_another_normal_bias_are_left_out():
    of = lambda light, profile, m=TEXELS: {
        each.engine for each in engine_settings(light, SIZE, SHIFT, m, 2.0, profile=profile)
    }
    assert of(SUN, "constant") == {"three.js", "Bevy"}
    assert of(SUN, "sine") == {"Babylon.js", "Filament"}
    assert of(SUN, "one_minus_cosine") == {"Unity URP"}
    assert of(SUN, "across") == {"Godot 4"}
    assert of(SPOT, "across") == set()
    assert of(LAMP, "one_minus_cosine") == set()
    assert of(SUN, "sine", 0.0) == of(SUN, None) == {each for each, _ in values(SUN)}


@pytest.mark.parametrize(
    ("power", "steady"),
    [
        (0, {"generator.bias (NONE, POISSON, ESM)", "shadow_depth_bias", "constantBias", "shadowBias (depth)"}),
        (1, {"shadow_bias"}),
        (2, {"light.shadow.bias", "generator.bias (PCF)"}),
    ],
)
def test_notes_say_which_settings_hold_at_one_distance_only(power, steady):
    found = engine_settings(SPOT, SIZE, SHIFT, 0.0, 2.0, power=power)
    at_all = {each.setting for each in found if "at this distance" not in each.note}
    offsets = {each.setting for each in found if "normal" in each.setting.lower()}
    assert at_all - offsets == steady
    assert not any("at this distance" in each.note for each in engine_settings(SUN, SIZE, SHIFT, TEXELS, 2.0))
    moved = engine_settings(SPOT, SIZE, 0.0, TEXELS, 2.0)
    assert {each.setting for each in moved if "at this distance" in each.note} == {
        "light.shadow.normalBias",
        "generator.normalBias",
        "shadowNormalBias",
    }


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        (SUN, {"three.js": 3.0, "Babylon.js": 3 / 1.343, "Godot 4": 1.5}),
        (SPOT, {"three.js": 3.0, "Babylon.js": 3 / 1.343, "Godot 4": 1.5}),
        # The taps are half as far apart.
        (LAMP, {"three.js": 6.0, "Babylon.js": 3.0, "Godot 4": 1.5}),
    ],
)
def test_a_radius_in_an_engines_unit(light, expected):
    found = radius_settings(light, 3.0)
    assert {each.engine: each.value for each in found if each.value is not None} == pytest.approx(expected, rel=1e-3)
    lacking = {each.engine for each in found if each.note.startswith("no counterpart")}
    assert lacking - {"Babylon.js"} == {"Bevy", "Filament", "Unity URP"}
    assert {each.engine for each in found} == set(expected) | lacking


def test_a_suns_bias_is_window_depth_in_every_unit():
    notes = {(each.engine, each.setting): each.note for each in engine_settings(SUN, SIZE, SHIFT, TEXELS, 2.0)}
    assert notes["three.js", "light.shadow.bias"] == "window depth"
    assert notes["Babylon.js", "generator.bias (PCF)"] == "twice window depth"
    assert notes["Babylon.js", "generator.bias (NONE, POISSON, ESM)"] == "window depth"


@pytest.mark.parametrize("light", [SUN, SPOT, LAMP])
@pytest.mark.parametrize(
    ("technique", "engine", "bias", "power"),
    [
        (ThreeJs, "three.js", "light.shadow.bias", 2),
        (BabylonJs, "Babylon.js", "generator.bias (NONE, POISSON, ESM)", 0),
        (lambda **given: BabylonJs(filter="PCF", **given), "Babylon.js", "generator.bias (PCF)", 2),
    ],
)
def test_an_engines_settings_amount_to_what_they_were_made_of(light, technique, engine, bias, power):
    offset = "light.shadow.normalBias" if engine == "three.js" else "generator.normalBias"
    given = values(light)
    made = technique(bias=given[engine, bias], normal_bias=given[engine, offset], resolution=SIZE)
    found = plain_bias(made, light, 2.0)
    assert (found.shift, found.offset) == pytest.approx((SHIFT, TEXELS), rel=1e-5)
    # Under a point light, PCF is drawn as POISSON.
    assert found.power == (0 if engine == "Babylon.js" and light is LAMP else power)


def test_an_engines_filter_is_as_wide_as_the_radius_that_it_was_made_of():
    for light in (SUN, LAMP):
        made = {each.engine: each.value for each in radius_settings(light, 3.0) if each.value is not None}
        taken = (
            ThreeJs(radius=made["three.js"], resolution=SIZE),
            BabylonJs(filter="POISSONSAMPLING", blur_scale=made["Babylon.js"], resolution=SIZE),
        )
        for technique in taken:
            assert plain_bias(technique, light, 2.0).radius == pytest.approx(3.0, rel=1e-5)
    fixed = {quality: BabylonJs(filter="PCF", quality=quality, resolution=SIZE) for quality in ("LOW", "HIGH")}
    assert [plain_bias(each, SUN, 2.0).radius for each in fixed.values()] == [0, castano_radius(5)]
    # (1, 3, 4, 3, 1) has the variance 14 / 12, and a disk a quarter of its radius squared.
    assert castano_radius(5) == pytest.approx(2 * math.sqrt(14 / 12))
    assert plain_bias(BabylonJs(filter="PCSS", resolution=SIZE), SUN, 2.0).radius is None


def test_soft_filters_of_godot_and_unity_apply_a_bias_several_times():
    hard = {(each.engine, each.setting): each.value for each in engine_settings(SUN, SIZE, SHIFT, TEXELS, 2.0)}
    soft = {
        (each.engine, each.setting): each.value for each in engine_settings(SUN, SIZE, SHIFT, TEXELS, 2.0, softness=2.5)
    }
    changed = {key: hard[key] / soft[key] for key in hard if hard[key] != soft[key]}
    assert changed == pytest.approx(
        dict.fromkeys(
            [("Godot 4", "shadow_bias"), ("Unity URP", "shadowBias (depth)"), ("Unity URP", "shadowNormalBias")], 2.5
        )
    )


@pytest.mark.parametrize(
    "technique", [GodotCompatibility(resolution=(64, 64)), PlayCanvas(resolution=(64, 64), num_cascades=4)]
)
def test_a_spot_lights_map_fills_the_texture_whatever_cascades_a_sun_has(technique):
    meshes = [library_mesh("box"), library_mesh("plane", size=4.0)]
    light = SpotLight((-1.2, 3.0, 0.9), (1.2, -3.0, -0.9), outer_angle=30.0, near=0.5, far=8.0)
    scene = Scene(meshes, PinholeCamera((2.0, 2.0, 3.0), (0.0, 0.0, 0.0), fov_y=40.0, near=0.1, far=20.0), light)
    assert technique.prepare(scene).depth.shape == (64, 64)
    # A texel at a distance of 3.
    assert technique.frame(scene, 3.0).texel == pytest.approx(2 * np.tan(np.radians(30)) * 3 / 64, rel=1e-5)
