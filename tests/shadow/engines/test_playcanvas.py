"""PlayCanvas' shadows against pictures that PlayCanvas drew."""

import dataclasses

import numpy as np
import pytest
from engine_states import agreement, scene_of, surface_of
from golden_engines import engine_golden, engine_goldens
from scenes import marked

from diffshadow.geometry import RectangleLight, Scene
from diffshadow.shadow import PlayCanvas

pytestmark = pytest.mark.optimized

CASES = engine_goldens("playcanvas")
ENOUGH, ENOUGH_BY_OWN_MAP = 0.9995, 0.999
# Its near plane is a thousandth of its range, so that depths are nearly 1: their last bits decide where there is acne.
NOISY = {"spot_pcf3_both": 0.997}


def preset(golden) -> PlayCanvas:
    """The engine's settings."""
    given = golden.settings["light"]
    size = given["shadowResolution"]
    return PlayCanvas(
        shadow_bias=given.get("shadowBias", 0.05),
        normal_offset_bias=given.get("normalOffsetBias", 0.0),
        shadow_intensity=given.get("shadowIntensity", 1.0),
        shadow_type=given["shadowType"],
        shadow_distance=given.get("shadowDistance", 40.0),
        num_cascades=given.get("numCascades", 1),
        side=tuple(mesh.get("side", "front") for mesh in golden.settings["meshes"]),
        resolution=(size, size),
        subpixels=16,
    )


def scene(golden) -> Scene:
    given = golden.settings["light"]
    if given["type"] == "directional":
        return scene_of(golden, PlayCanvas.directional_light(given["direction"]))
    if given["type"] == "omni":
        return scene_of(golden, PlayCanvas.omni_light(given["position"], range=given["range"]))
    cones = {"outer_cone_angle": given["outerConeAngle"], "inner_cone_angle": given["innerConeAngle"]}
    spot = PlayCanvas.spot_light(given["position"], given["direction"], range=given["range"], **cones)
    return scene_of(golden, spot)


def from_read_back(golden, technique) -> float:
    """The agreement from the engine's own map."""
    state = technique.from_map(golden.arrays["map"], scene(golden))
    return agreement(golden, technique.visibility(state, surface_of(golden)))


def from_own_map(golden, technique) -> float:
    return agreement(golden, technique.visibility(technique.prepare(scene(golden)), surface_of(golden)))


FIRST = ("directional_pcf3_cascades", "spot_pcf1_bias", "omni_pcf3_bias")
"""Those that are compared in every run of the tests."""


@pytest.mark.parametrize("name", marked(CASES, set(CASES) - set(FIRST)))
def test_both_maps_give_the_engines_picture(name):
    golden = engine_golden("playcanvas", name)
    technique = preset(golden)
    assert from_read_back(golden, technique) >= ENOUGH
    assert from_own_map(golden, technique) >= NOISY.get(name, ENOUGH_BY_OWN_MAP)


@pytest.mark.parametrize("name", [name for name in CASES if "omni" not in name])
def test_the_cameras_are_the_engines(name):
    golden = engine_golden("playcanvas", name)
    info, cameras = golden.info, preset(golden).cameras_of(scene(golden))
    expected = np.reshape(info["shadowMatrices"], (-1, 4, 4)).transpose(0, 2, 1)
    np.testing.assert_allclose(cameras.to_window, expected, atol=2.5e-7)
    np.testing.assert_allclose(cameras.far, info["fars"], rtol=1e-6)
    if golden.settings["light"]["type"] == "spot":
        # To the bit: the noise of depths near 1 follows from it.
        np.testing.assert_array_equal(cameras.to_window, expected.astype(np.float32))
    else:
        np.testing.assert_allclose(cameras.ends, info["cascadeDistances"][: cameras.count], rtol=1e-6)


# The setting that each picture shows, and what a tenth of it is worth.
SENSITIVE = [
    ("directional_pcf3_default", "shadow_bias"),
    ("directional_pcf5_both", "normal_offset_bias"),
    ("spot_pcf1_bias", "shadow_bias"),
    ("omni_pcf1_normal", "normal_offset_bias"),
    ("omni_pcf3_bias", "shadow_bias"),
]


@pytest.mark.parametrize(("name", "key"), [pytest.param(*each, marks=pytest.mark.exhaustive) for each in SENSITIVE])
def test_a_setting_that_is_off_by_a_tenth_is_seen(name, key):
    golden = engine_golden("playcanvas", name)
    technique = preset(golden)
    state = technique.prepare(scene(golden))
    for factor in (0.9, 1.1):
        wrong = dataclasses.replace(technique, **{key: getattr(technique, key) * factor})
        # Changing the bias of a drawn map gives the map that is drawn with the new bias.
        assert agreement(golden, wrong.visibility(state, surface_of(golden))) < 0.99
        assert from_own_map(golden, wrong) < 0.99


def test_what_the_engine_cannot_draw_is_refused():
    with pytest.raises(ValueError, match=r"PlayCanvas.resolution is \(32, 64\); expected a square map"):
        PlayCanvas(resolution=(32, 64))
    golden = engine_golden("playcanvas", "omni_pcf3_bias")
    area = RectangleLight((0, 3, 0), (0, -1, 0), (1.0, 1.0), 45.0, 0.1, 9.0)
    with pytest.raises(ValueError, match="RectangleLight; expected a directional, spot, point or matrix light"):
        preset(golden).prepare(scene_of(golden, area))
