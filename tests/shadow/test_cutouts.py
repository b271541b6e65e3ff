"""Shadows of meshes with an alpha test: by maps, by points and by rays."""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LAMP, LIGHTS, SLANTED, fence, fence_over_floor, floor_camera, marked, quad, side_camera

from diffshadow.geometry import (
    DirectionalLight,
    OrthographicCamera,
    PointLight,
    Scene,
    SpotLight,
    Textures,
    merge,
)
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
    of = lambda **new: dataclasses.replace(cut, textures=dataclasses.replace(cut.textures, **new))
    others = {"samplers": [(1, 0, 0)]}, {"samplers": [(0, 1, 0)]}, {"corner_alpha": np.full((2, 3), 0.7)}
    assert len({key(floor, cut), *(key(floor, of(**other)) for other in others)}) == 4


# A card over the floor, given by its middle and half of its sides; the rays come from a lamp above.
MIDDLE, RIGHT, FAR = np.array([(0.05, 0.8, 0.0), (0.5, 0.15, 0.02), (0.0, 0.1, -0.5)])
ABOVE = np.array([0.2, 3.0, 0.1])
BELOW = floor_camera(1.2, (48, 48))
MAPPED, POINTS = ShadowMapping(Nearest(), Bias(constant=3.0), map=MapSettings((256, 256))), IrregularZBuffer()
# Opaque in the first half of each axis, of four texels; bilinear alpha is 0.2 at 0.575, and at 0.925 of a repetition.
BARS = np.array([1.0, 1.0, 0.0, 0.0])
ALONG_U, ALONG_BOTH = np.tile(BARS, (4, 1)), np.outer(BARS, BARS)


def mirrored(coordinate):
    return np.abs(coordinate - 2 * np.round(coordinate / 2))


# The image, how it is read, and what casts at texture coordinates (u, v), where corners have alpha `a`.
READ = {
    "mirrored and bilinear": (ALONG_U, ("mirror", "repeat"), "linear", lambda u, v, a: mirrored(u) < 0.575),
    "mirrored along v": (
        ALONG_BOTH,
        ("clamp", "mirror"),
        "nearest",
        lambda u, v, a: (u < 0.5) & (mirrored(v) < 0.5),
    ),
    "repeated and nearest": (ALONG_U, "repeat", "nearest", lambda u, v, a: u % 1 < 0.5),
    "clamped and bilinear": (ALONG_U, "clamp", "linear", lambda u, v, a: u < 0.575),
    "alpha of corners": (np.ones((4, 4)), "clamp", "linear", lambda u, v, a: a > 0.2),
}


@pytest.mark.parametrize("name", marked(READ, {"repeated and nearest", "clamped and bilinear"}))
def test_samplers_and_alpha_of_corners_cut_alike_for_maps_points_and_rays(name):
    alpha, wrap, filter, casts = READ[name]
    card = quad(MIDDLE, RIGHT, FAR)
    faces = np.asarray(card.faces)
    # From -7 to -4 along u, and from 3 to 6 along v: many repetitions away. From -1 to 2 where the border goes on.
    near = np.array([each == "clamp" for each in ([wrap] * 2 if isinstance(wrap, str) else wrap)])
    uv = (np.array([(-7, 3), (-4, 3), (-4, 6), (-7, 6)]) - np.array([-6, 4]) * near)[faces]
    corners = np.array([0.0, 1.0, 1.0, 0.0] if name == "alpha of corners" else [1.0] * 4)[faces]
    image = np.concatenate([np.full((4, 4, 3), 0.5), alpha[..., None]], axis=-1)
    textures = Textures.of(image, uv, 0.2, wrap=wrap, filter=filter, corner_alpha=corners)
    cut = dataclasses.replace(card, textures=textures)
    floor = quad((0, 0, 0), (1.5, 0, 0), (0, 0, -1.5))
    light = SpotLight.around(jnp.asarray(ABOVE), merge([floor, card]).vertices)
    scene = Scene([floor, cut], BELOW, light)
    truth = trace_visibility(scene)
    surface = draw_surface(scene.mesh, BELOW)
    # Where the ray from each point to the lamp meets the card, along its sides from -1 to 1.
    towards = ABOVE - truth.position
    away = MIDDLE - truth.position
    normal = np.cross(RIGHT, FAR)
    meets = truth.position + (away @ normal / (towards @ normal))[..., None] * towards - MIDDLE
    along, up, _ = np.moveaxis(meets @ np.linalg.inv(np.stack([RIGHT, FAR, normal])), -1, 0)
    low, high = uv.reshape(-1, 2).min(axis=0), uv.reshape(-1, 2).max(axis=0)
    u, v = (lo + (hi - lo) * (at + 1) / 2 for lo, hi, at in zip(low, high, (along, up), strict=True))
    expected = (np.abs(along) < 1) & (np.abs(up) < 1) & casts(u, v, (along + 1) / 2)
    assert 0.05 < expected.mean() < 0.3
    dark = {
        "rays": truth.visibility < 0.5,
        "rays in double precision": trace_visibility_exact(scene).visibility < 0.5,
        "map": np.asarray(MAPPED.visibility(MAPPED.prepare(scene), surface)) < 0.5,
        "points": np.asarray(POINTS.visibility(POINTS.prepare(scene), surface)) < 0.5,
    }
    wrong = {way: np.mean(found != expected) for way, found in dark.items()}
    # A map is off by a texel along the borders of bars.
    assert max(wrong["rays"], wrong["rays in double precision"], wrong["points"]) < 0.001
    assert wrong["map"] < 0.012
