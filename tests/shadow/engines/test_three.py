"""three.js' shadows against pictures that three.js drew."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from engine_states import agreement, scene_of, surface_of
from golden_engines import engine_golden, engine_goldens
from scenes import marked

from diffshadow.raster import draw_surface
from diffshadow.shadow import ThreeJs
from diffshadow.shadow.engines import _variance

pytestmark = pytest.mark.optimized

CASES = engine_goldens("three")
ENOUGH = 0.9997
ENOUGH_BY_OWN_MAP = 0.999
# The box stands on the ground, and its bottom casts. At equal depths, the rounding of what the engine interpolates
# decides, which the picture does not hold.
TIES = {"point_basic_default_sides": 0.9996}


def preset(golden) -> ThreeJs:
    """The engine's settings."""
    given, light = golden.settings, golden.settings["light"]
    meshes = given["meshes"]
    side = tuple(mesh.get("side", "front") for mesh in meshes)
    casting = tuple(mesh.get("shadowSide") for mesh in meshes)
    size = light["mapSize"]
    width, height = size if isinstance(size, list) else (size, size)
    return ThreeJs(
        bias=light.get("bias", 0.0),
        normal_bias=light.get("normalBias", 0.0),
        radius=light.get("radius", 1.0),
        intensity=light.get("intensity", 1.0),
        shadow_type=f"{given['shadowType']}ShadowMap",
        blur_samples=light.get("blurSamples", 8),
        side=side,
        shadow_side=casting,
        reversed_depth=given["reversedDepthBuffer"],
        resolution=(height, width),
        subpixels=16,
    )


def from_read_back(golden, technique):
    """Visibility from the engine's own map."""
    return technique.visibility(technique.from_map(golden.arrays["map"], scene_of(golden)), surface_of(golden))


def from_own_map(golden, technique):
    """Visibility from a map that the library draws, at the engine's receivers."""
    return technique.visibility(technique.prepare(scene_of(golden)), surface_of(golden))


# Each of these takes a program of its own, for settings that others have too.
REPEATED = (
    "directional_pcf_default_frustum",
    "directional_pcf_frustum_reversed",
    "directional_pcf_oblong",
    "directional_vsm_default_sides",
    "directional_vsm_frustum_reversed",
    "directional_vsm_normal_bias",
    "directional_vsm_radius_4",
    "directional_vsm_uncast",
    "spot_pcf_oblong_focus",
    "spot_vsm_odd_sizes",
)


@pytest.mark.parametrize("name", marked(CASES, REPEATED))
def test_the_engines_map_gives_the_engines_picture(name):
    golden = engine_golden("three", name)
    assert agreement(golden, from_read_back(golden, preset(golden))) >= TIES.get(name, ENOUGH)


OWN_MAPS = ("directional_basic_bias", "directional_pcf_radius_4", "point_basic_bias")
"""Those whose maps are drawn in every run of the tests."""


@pytest.mark.parametrize("name", marked(CASES, set(CASES) - set(OWN_MAPS)))
def test_the_own_map_gives_the_engines_picture(name):
    golden = engine_golden("three", name)
    assert agreement(golden, from_own_map(golden, preset(golden))) >= ENOUGH_BY_OWN_MAP


BLURS = [name for name in CASES if "_vsm_" in name]
blurred = jax.jit(_variance.blurred, static_argnums=2)


@pytest.mark.parametrize("name", marked(BLURS, set(BLURS) - {"spot_vsm_radius_3", "spot_vsm_odd_sizes"}))
def test_the_blur_of_variance_maps_has_the_engines_bits(name):
    if "odd" in name and jax.default_backend() == "gpu":
        pytest.skip("GPUs do not round quotients correctly, so places between texels fall on another one")
    golden = engine_golden("three", name)
    technique = preset(golden)
    found = blurred(jnp.asarray(golden.arrays["map"]), technique.radius, technique.blur_samples)
    np.testing.assert_array_equal(np.stack(found, -1), golden.arrays["map_blurred"])


@pytest.mark.exhaustive
def test_the_own_camera_gives_the_engines_picture():
    golden = engine_golden("three", "directional_pcf_both_intensity")
    technique, scene = preset(golden), scene_of(golden)
    seen = golden.arrays["mesh"] >= 0
    close = lambda surface: np.abs(np.asarray(surface.position) - golden.arrays["position"]).max(axis=-1)[seen] < 2e-6
    picture = lambda surface: agreement(golden, technique.visibility(technique.prepare(scene, surface), surface))
    surface = draw_surface(scene.mesh, scene.camera, subpixels=16)
    assert (np.asarray(surface.mask) == seen).mean() > 0.999
    assert close(surface).mean() > 0.999
    assert picture(surface) >= ENOUGH
    # Between the vertices themselves, the surface is another.
    surface = draw_surface(scene.mesh, scene.camera)
    assert close(surface).mean() < 0.1
    assert picture(surface) < 0.995


def test_a_mesh_without_a_shadow_side_casts_what_the_engine_chooses():
    scene = scene_of(engine_golden("three", "directional_pcf_bias"))
    some = ThreeJs(side=["front", "back", "double", "front"], shadow_side=[None, None, None, "double"])
    assert some.casting_sides(scene) == ("back", "front", "double", "double")
    assert dataclasses.replace(some, shadow_type="VSMShadowMap").casting_sides(scene) == (
        "front",
        "back",
        "double",
        "double",
    )
    assert hash(some.shadow_side)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"side": "both"}, "ThreeJs.side is 'both'; expected front, back or double, or a list"),
        ({"side": ("front", None)}, r"ThreeJs.side is \['front', None\]"),
        ({"shadow_side": ["front", "none"]}, "ThreeJs.shadow_side is .* or null for each mesh"),
    ],
)
def test_unknown_sides_are_named(wrong, said):
    with pytest.raises(ValueError, match=said):
        ThreeJs(**wrong)


@pytest.mark.parametrize(
    ("stored", "said"),
    [
        (np.ones((64, 64)), r"map has shape \(64, 64\); expected \(128, 128\), by the light and"),
        (np.full((128, 128), 255.0), "map has values from 255 to 255; expected depths from 0 to 1"),
        (np.full((128, 128), np.nan), "map has values from nan to nan; expected depths from 0 to 1"),
    ],
    ids=["shape", "bytes", "not a number"],
)
def test_what_is_no_map_of_the_engine_is_refused(stored, said):
    golden = engine_golden("three", "directional_pcf_bias")
    with pytest.raises(ValueError, match=said):
        preset(golden).from_map(stored, scene_of(golden))


def test_maps_of_a_cubes_faces_are_square():
    scene = scene_of(engine_golden("three", "point_pcf_radius_4"))
    with pytest.raises(
        ValueError, match=r"point light has \(32, 64\) texels, \(height, width\); expected a square one"
    ):
        ThreeJs(resolution=(32, 64)).prepare(scene)


@pytest.mark.exhaustive
def test_a_mesh_that_receives_nothing_is_lit_and_does_not_count():
    golden = engine_golden("three", "directional_basic_mixed")
    assert not golden.settings["meshes"][3]["receives"]
    technique, scene = preset(golden), scene_of(golden)
    surface = draw_surface(scene.mesh, dataclasses.replace(scene.camera, resolution=(64, 64)))
    number = np.repeat(np.arange(4), [len(mesh["faces"]) for mesh in golden.settings["meshes"]])
    torus = np.asarray(surface.mask) & (number[np.asarray(surface.face)] == 3)
    of = lambda scene: (technique, technique.prepare(scene))
    everywhere, marked = of(dataclasses.replace(scene, receives=None)), of(scene)
    assert scene.receives == (True, True, True, False)
    lit, covered = (
        np.asarray(technique.visibility(marked[1], surface)),
        np.asarray(technique.covered(marked[1], surface)),
    )
    assert (lit[torus] == 1).all()
    assert not covered[torus].any()
    before = np.asarray(technique.visibility(everywhere[1], surface))
    assert (before[torus] < 1).any()
    np.testing.assert_array_equal(lit[~torus], before[~torus])


def test_back_sides_negate_the_normal_bias():
    golden = engine_golden("three", "directional_pcf_mixed_normal_bias")
    drawn = preset(golden).prepare(scene_of(golden))
    blob = golden.settings["meshes"][1]
    assert blob["side"] == "back"
    at = golden.arrays["mesh"] == 1
    outwards = golden.arrays["position"][at] - blob["vertices"].mean(axis=0)
    # The engine's normals point inwards there, and ours are turned.
    assert ((outwards * golden.arrays["normal"][at]).sum(axis=-1) < 0).all()
    counts = [len(mesh["faces"]) for mesh in golden.settings["meshes"]]
    assert np.split(np.asarray(drawn.offset), np.cumsum(counts)[:-1])[1].tolist() == [-1] * counts[1]
