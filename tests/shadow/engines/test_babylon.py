"""Babylon.js' shadows against pictures that Babylon.js drew."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from engine_states import agreement, scene_of, surface_of
from golden_engines import engine_golden, engine_goldens
from scenes import marked
from scipy import ndimage

from diffshadow.geometry import DirectionalLight, MatrixLight, Mesh
from diffshadow.raster import Surface
from diffshadow.shadow import BabylonJs, EngineMap
from diffshadow.shadow.engines import _babylon
from diffshadow.shadow.engines._textures import bilinear

pytestmark = pytest.mark.optimized

CASES = engine_goldens("babylon")
ENOUGH = 0.9997
ENOUGH_BY_OWN_MAP = 0.999
# The near plane cuts casters open, and the engine's rasterizer places the corners of the cut at whole steps too: 4
# texels along the cut differ, each of which 36 texels' receivers read.
CUT_OPEN = {"directional_pcf_frustum_falloff": 0.99}
# Blurred in place: the engine overwrites the map that it blurs, so there is none to read back.
READ_BACK = [name for name in CASES if not name.endswith("in_place")]
NAMES = {
    "bias": "bias",
    "normalBias": "normal_bias",
    "darkness": "darkness",
    "blurScale": "blur_scale",
    "depthScale": "depth_scale",
    "frustumEdgeFalloff": "frustum_edge_falloff",
    "contactHardeningLightSizeUVRatio": "contact_hardening_light_size_uv_ratio",
    "filter": "filter",
    "filteringQuality": "quality",
    "blurKernel": "blur_kernel",
    "blurBoxOffset": "blur_box_offset",
    "useKernelBlur": "use_kernel_blur",
    "forceBackFacesOnly": "force_back_faces_only",
    "usefullFloatFirst": "float_maps",
}


def preset(golden) -> BabylonJs:
    """The engine's settings."""
    given = dict(golden.settings["generator"])
    size = given.pop("mapSize")
    culling = tuple(mesh.get("backFaceCulling", True) for mesh in golden.settings["meshes"])
    settings = {NAMES[name]: value for name, value in given.items()}
    return BabylonJs(**settings, back_face_culling=culling, resolution=(size, size), subpixels=16)


def read_back(golden) -> np.ndarray:
    """The map that the engine drew, before any blur."""
    return golden.arrays["map_depth" if "map_depth" in golden.arrays else "map_metric"]


def from_read_back(golden, technique):
    """Visibility from the engine's own map."""
    return visibility(golden, technique, technique.from_map(read_back(golden), scene_of(golden)))


def from_own_map(golden, technique):
    """Visibility from a map that the library draws, at the engine's receivers."""
    return visibility(golden, technique, technique.prepare(scene_of(golden)))


def visibility(golden, technique, state):
    """Visibility with the engine's pseudo-random numbers, which depend on its device."""
    surface = surface_of(golden)
    if "random" not in golden.arrays:
        return technique.visibility(state, surface)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_babylon, "random_turn", lambda clip: 3.1415926 * jnp.asarray(golden.arrays["random"]))
        return traced_again(technique, state, surface)


def traced_again(technique, state, surface):
    """Visibility by the module as it is now."""
    return eqx.filter_jit(lambda *given: _babylon._visibility.__wrapped__(*given))(technique, state, surface)


# Each of these takes a program of its own, for a filter, a quality or a kind of light that others have too.
REPEATED = (
    "directional_blur_esm",
    "directional_blur_close_esm",
    "directional_blur_close_esm_kernel",
    "directional_close_esm",
    "directional_esm_half_float",
    "directional_pcf_low",
    "directional_pcf_medium",
    "directional_pcss_high",
    "directional_pcss_medium",
    "directional_poisson",
    "directional_poisson_frustum_falloff",
    "point_close_esm",
    "point_esm",
    "spot_blur_close_esm_half_float_kernel",
    "spot_close_esm",
    "spot_pcf_bias",
    "spot_pcss",
    "spot_poisson",
)


@pytest.mark.parametrize("name", marked(READ_BACK, REPEATED))
def test_the_engines_map_gives_the_engines_picture(name):
    golden = engine_golden("babylon", name)
    assert agreement(golden, from_read_back(golden, preset(golden))) >= ENOUGH


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CASES)
def test_the_own_map_gives_the_engines_picture(name):
    golden = engine_golden("babylon", name)
    assert agreement(golden, from_own_map(golden, preset(golden))) >= CUT_OPEN.get(name, ENOUGH_BY_OWN_MAP)


@pytest.mark.exhaustive
def test_the_own_map_is_the_engines_where_the_near_plane_cuts():
    golden = engine_golden("babylon", "directional_pcf_frustum_falloff")
    technique = preset(golden)
    drawn = np.asarray(technique.prepare(scene_of(golden)).depth)
    pushed = np.where(drawn < 1, drawn + float(technique.bias) / 2, 1)
    assert (np.abs(pushed - golden.arrays["map_depth"]) > 1e-4).sum() <= 4


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", marked([name for name in CASES if "pcss" in name], REPEATED))
def test_means_agree_with_our_own_random_numbers(name):
    golden = engine_golden("babylon", name)
    technique = preset(golden)
    ours = np.asarray(technique.visibility(technique.prepare(scene_of(golden)), surface_of(golden)))
    counted = golden.arrays["mesh"] >= 0
    height, width = counted.shape
    sums = lambda image: image.reshape(height // 8, 8, width // 8, 8).sum(axis=(1, 3))
    count = sums(counted)
    off = np.abs(sums(np.where(counted, ours - golden.arrays["visibility"], 0))) / np.maximum(count, 1)
    assert off[count >= 32].max() < 0.02


BLURS = [name for name in READ_BACK if "_blur_" in name]


@pytest.mark.parametrize("name", marked(BLURS, set(BLURS) - {"directional_blur_esm_half_float_kernel"}))
def test_the_blur_of_exponential_maps_has_the_engines_bits(name):
    golden = engine_golden("babylon", name)
    technique, expected = preset(golden), golden.arrays["map_blurred"]
    step, stored = technique.blur_scale / technique.resolution[1], _babylon._stored(technique)
    if technique.use_kernel_blur:
        of = lambda image: _babylon.kernel_blurred(image, expected.shape, step, technique.blur_kernel, stored)
    else:
        of = lambda image: stored(_babylon.box_blurred(image, expected.shape, step, technique.blur_box_offset))
    np.testing.assert_array_equal(jax.jit(of)(jnp.asarray(golden.arrays["map_metric"])), expected)


def test_equal_texels_stay_equal_between_them():
    """A map's empty part is compared with receivers beyond far, at the very depth that it was cleared to."""
    place = jnp.asarray(np.random.default_rng(0).uniform(0, 1, (2, 1000)), jnp.float32)
    for value in (1.0, 0.1, 0.7):
        texture = jnp.full((8, 8), value, jnp.float32)
        np.testing.assert_array_equal(between_texels(texture, *place), texture[0, 0])


between_texels = jax.jit(lambda texture, u, v: bilinear(texture, u, v, lambda texel: texel))


def tie(filter_):
    """Visibility where a caster at exactly the receivers' depth is seen, without bias."""
    projection = np.diag([1.0, 1.0, -1.0, 1.0])
    projection[2, 3] = -2.0
    light = MatrixLight(np.eye(4), projection)
    position = jnp.tile(jnp.array([0.0, 0.0, -2.0]), (4, 4, 1))
    normal = jnp.tile(jnp.array([0.0, 0.0, 1.0]), (4, 4, 1))
    surface = Surface(position, normal, normal, normal, jnp.zeros((4, 4), jnp.int32), jnp.ones((4, 4), bool))
    technique = BabylonJs(filter=filter_, bias=0.0, resolution=(4, 4))
    return np.asarray(technique.visibility(EngineMap(jnp.full((4, 4), 0.5), light, [0.0], [True]), surface))


@pytest.mark.exhaustive
def test_equal_depth_is_lit_by_metric_and_shadowed_by_the_texture_unit():
    assert (tie("NONE") == 1).all()
    assert (tie("POISSONSAMPLING") == 1).all()
    assert (tie("PCF") == 0).all()


@pytest.mark.parametrize("filter_", marked(["NONE", "PCF", "PCSS"], ["PCSS"]))
def test_nothing_casts_whatever_the_bias(filter_):
    golden = engine_golden("babylon", "directional_none_bias")
    technique = BabylonJs(filter=filter_, bias=-0.5, resolution=(128, 128))
    scene, far = scene_of(golden), np.ones((128, 128), np.float32)
    state = dataclasses.replace(technique.prepare(scene), depth=jnp.asarray(far))
    np.testing.assert_allclose(np.asarray(technique.visibility(state, surface_of(golden))), 1, atol=1e-6)


@pytest.mark.parametrize(
    "name",
    marked(
        ["directional_pcf_high", "spot_pcf_bias", "directional_pcss_low", "spot_none_bias"],
        ["directional_pcss_low", "spot_none_bias"],
    ),
)
def test_a_bias_needs_no_new_map(name):
    golden = engine_golden("babylon", name)
    technique = preset(golden)
    scene, surface = scene_of(golden), surface_of(golden)
    unbiased = dataclasses.replace(technique, bias=0.0).prepare(scene)
    state = technique.prepare(scene)
    np.testing.assert_allclose(unbiased.depth, state.depth, atol=2e-6)
    ours, again = (np.asarray(technique.visibility(one, surface)) for one in (unbiased, state))
    assert (np.abs(ours - again) <= 1 / 255).mean() >= 0.9995


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "name", marked(["BLUREXPONENTIALSHADOWMAP", "BLURCLOSEEXPONENTIALSHADOWMAP"], ["BLUREXPONENTIALSHADOWMAP"])
)
def test_a_point_lights_map_is_not_blurred(name):
    golden = engine_golden("babylon", "point_close_esm")
    blurred = dataclasses.replace(preset(golden), filter=name)
    plain = dataclasses.replace(blurred, filter=name.removeprefix("BLUR"))
    np.testing.assert_array_equal(from_own_map(golden, blurred), from_own_map(golden, plain))


@pytest.mark.exhaustive
@pytest.mark.parametrize("kernel", marked([0, 1, 2, 3, 5, 8, 16, 16.4, 33], [0, 1, 3, 5, 8, 16, 33]))
def test_a_blur_leaves_a_constant_map_as_it_is(kernel):
    constant, step = jnp.full((16, 16), 0.7), jnp.float32(1 / 8)
    for blurred in (
        _babylon.kernel_blurred(constant, (8, 8), step, kernel, lambda x: x),
        _babylon.box_blurred(constant, (8, 8), step, 2),
    ):
        np.testing.assert_allclose(np.asarray(blurred), 0.7, atol=1e-6)


def test_only_numbers_that_change_the_map_lay_it_out():
    technique = BabylonJs(filter="BLUREXPONENTIALSHADOWMAP")
    assert technique.lays_out("normal_bias")
    assert technique.lays_out("blur_scale")
    assert not technique.lays_out("bias")
    assert not BabylonJs(filter="POISSONSAMPLING").lays_out("blur_scale")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"resolution": (64, 128)}, "expected a square map"),
        ({"blur_scale": 0.0}, "blur_scale is 0"),
    ],
)
def test_errors_name_the_setting(wrong, message):
    with pytest.raises(ValueError, match=message):
        BabylonJs(**wrong)


def test_each_mesh_needs_its_culling():
    golden = engine_golden("babylon", "directional_none_bias")
    with pytest.raises(ValueError, match="back_face_culling has 3 entries, and the scene has 4 meshes"):
        BabylonJs(back_face_culling=(True, True, False)).prepare(scene_of(golden))
    listed = BabylonJs(back_face_culling=[True, False, True, True])
    assert listed.casting_sides(scene_of(golden)) == ("front", "double", "front", "front")


def test_a_normal_bias_shrinks_casters_where_their_faces_are_slanted_to_the_light():
    corners = np.array([(0, 0, 0), (2, 0, 0), (0, 3, 0), (0, 0, 4)], float)
    mesh = Mesh(corners, [(0, 1, 2), (0, 3, 1)])
    sun = DirectionalLight((0.6, 0, -0.8), (0, 0, 0), (4, 4), -4, 4)
    found = _babylon.shrunk(mesh, sun, jnp.asarray(0.5))
    # The normals are z and y; the light comes from (-0.6, 0, 0.8).
    np.testing.assert_allclose(found.vertices[:3], corners[[0, 1, 2]] - [0, 0, 0.5 * 0.6], atol=1e-6)
    np.testing.assert_allclose(found.vertices[3:], corners[[0, 3, 1]] - [0, 0.5, 0], atol=1e-6)
    np.testing.assert_array_equal(found.faces, [(0, 1, 2), (3, 4, 5)])
    np.testing.assert_array_equal(found.corner_normals, mesh.corner_normals)
    assert _babylon.shrunk(mesh, sun, jnp.asarray(0.0)) is mesh


def test_a_box_blur_is_the_mean_of_texels_around():
    image = jnp.asarray(np.random.default_rng(4).uniform(size=(12, 12)), jnp.float32)
    found = _babylon.box_blurred(image, image.shape, jnp.asarray(1 / 12), 2)
    np.testing.assert_allclose(found[2:-2, 2:-2], ndimage.uniform_filter(image, 5)[2:-2, 2:-2], atol=1e-5)
