"""Shadows of meshes with an alpha test: by maps, by points and by rays."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LAMP, LIGHTS, SLANTED, fence, fence_over_floor, side_camera

from diffshadow.geometry import DirectionalLight, OrthographicCamera, PointLight, Scene, merge
from diffshadow.raster import draw_surface
from diffshadow.reference import key_parts, trace_visibility, trace_visibility_exact
from diffshadow.shadow import (
    Bias,
    IrregularZBuffer,
    MapSettings,
    Nearest,
    ProjectiveShadow,
    ShadowMapping,
    ShadowVolumes,
    ThreeJs,
    draw_shadow_map,
)

CAMERA = side_camera((64, 64))


@functools.cache
def scene(light="directional"):
    meshes = fence_over_floor()
    casters = merge(meshes)
    lamp = PointLight.around(jnp.asarray(LAMP), casters.vertices) if light == "point" else LIGHTS[light](casters)
    return Scene(meshes, CAMERA, lamp)


@functools.cache
def traced(light="directional"):
    return trace_visibility(scene(light))


@functools.cache
def surface():
    return draw_surface(scene().mesh, CAMERA)


@pytest.mark.exhaustive
def test_rays_pass_through_what_is_cut_out_as_pixels_do():
    seen, truth = np.asarray(surface().face), traced().face
    assert np.mean(seen == truth) >= 0.999
    np.testing.assert_array_equal(trace_visibility_exact(scene()).face, truth)
    # The whole card would be seen in far more pixels.
    whole = trace_visibility(Scene([fence_over_floor()[0], fence(None)], CAMERA, scene().light)).face
    assert np.mean(whole != truth) > 0.03


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", ["directional", "spot", "point"])
def test_shadows_of_gaps_are_lit_by_rays_in_single_and_double_precision_and_by_points(light):
    truth, exact = traced(light), trace_visibility_exact(scene(light))
    dark = (truth.visibility == 0) & (truth.face < 2) & truth.mask
    assert dark.sum() > 20
    assert np.mean(truth.visibility == exact.visibility) >= 0.999
    found = IrregularZBuffer()
    visibility = np.asarray(found.visibility(found.prepare(scene(light)), surface()))
    same = np.asarray(surface().face) == truth.face
    assert np.mean((visibility == truth.visibility)[same]) >= 0.999


def test_a_map_holds_what_rays_from_the_light_meet():
    light = DirectionalLight(SLANTED, (0, 0.3, 0), (4.0, 4.0), -4.0, 4.0)
    view = light.view()
    up = np.asarray(view.world_to_eye)[1, :3]
    camera = OrthographicCamera(
        (0, 0.3, 0), np.add((0, 0.3, 0), SLANTED), up, height=4.0, near=-4.0, far=4.0, resolution=(96, 96)
    )
    truth = trace_visibility(Scene(scene().meshes, camera, light))
    found = draw_shadow_map(scene().mesh, light, (96, 96))
    clip = np.asarray(view.clip(jnp.asarray(truth.position.reshape(-1, 3), jnp.float32)))
    depth = np.where(truth.mask, (clip[:, 2] / clip[:, 3] * 0.5 + 0.5).reshape(96, 96), 1)
    assert np.mean(np.abs(np.asarray(found.depth) - depth) < 1e-4) >= 0.999
    assert (truth.face >= 2).sum() > 100


@pytest.mark.parametrize(
    "technique",
    [
        pytest.param(ThreeJs(resolution=(256, 256), side="double"), marks=pytest.mark.exhaustive, id="three.js"),
        pytest.param(ProjectiveShadow((256, 256)), id="projective"),
    ],
)
def test_all_maps_have_gaps(technique):
    truth = traced("spot")
    light, casts = scene("spot").light, [False, True]
    shadows = lambda *meshes: np.asarray(
        technique.visibility(technique.prepare(Scene(meshes, CAMERA, light, casts)), surface())
    )
    floor, cut = fence_over_floor()
    lit, others = shadows(floor, cut), shadows(floor, fence(None))
    on_floor = truth.mask & (truth.face < 2) & (np.asarray(surface().face) < 2)
    assert np.mean((lit < 0.5) == (truth.visibility < 0.5), where=on_floor) > 0.97
    assert np.sum((others < 0.5) & (lit > 0.5) & on_floor) > 50


def test_techniques_that_need_outlines_refuse_what_is_cut_out():
    mapping = ShadowMapping(Nearest(), Bias(), map=MapSettings((64, 64), silhouettes=True))
    for technique, mend in ((mapping, "silhouettes to false"), (ShadowVolumes(), "use a shadow map")):
        with pytest.raises(ValueError, match=f"a mesh has an alpha test.*{mend}"):
            technique.prepare(scene())


def test_the_key_of_a_reference_has_the_alpha_test_and_no_colours():
    def key(*meshes):
        return repr(key_parts(Scene(meshes, CAMERA, scene().light)))

    floor, cut = fence_over_floor()
    assert key(floor, cut) != key(floor, fence(0.6)) != key(floor, fence(None))
    assert key(floor, fence(None)) == key(floor, type(cut)(cut.vertices, cut.faces, cut.corner_normals, 0.3))
