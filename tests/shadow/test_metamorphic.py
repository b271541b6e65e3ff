"""Techniques under changes of a scene that leave its shadows as they are, or turn them with the picture."""

import contextlib
import dataclasses
import functools
import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import apply, lookups_at, marked, quad
from transformations import CHANGES, with_patterns

from diffshadow._arithmetic import as_float
from diffshadow.geometry import (
    DirectionalLight,
    OrthographicCamera,
    PinholeCamera,
    PointLight,
    Scene,
    SpotLight,
    library_mesh,
    merge,
    scaling,
    translation,
)
from diffshadow.raster import draw_surface
from diffshadow.shadow import (
    BabylonJs,
    Bias,
    Bilinear,
    Cascades,
    Castano,
    ExponentialShadowMap,
    ExponentialVarianceShadowMap,
    FourTap,
    HardCompare,
    MapSettings,
    MomentShadowMap,
    Nearest,
    PercentageCloser,
    PercentageCloserSoft,
    PerspectiveWarp,
    ProjectiveShadow,
    RandomDisk,
    ReceiverPlane,
    ResolutionMatched,
    Separable,
    ShadowMap,
    ShadowMapping,
    SingleMap,
    SlopeBias,
    SoftCompare,
    Tent,
    ThreeJs,
    VarianceShadowMap,
    stratified,
)

# Nothing here is symmetric: neither pictures and maps nor what they show.
FLOOR, CARD = quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), quad((0.3, 1.0, 0.2), (0.7, 0.1, 0.1), (0.0, 0.2, -0.5))
BALL = library_mesh("sphere", subdivisions=1).transformed(translation(jnp.array([-0.9, 0.5, 0.6])) @ scaling(0.9))
MESHES = [FLOOR, CARD, BALL]
POINTS = merge(MESHES).vertices
UP, LAMP = jnp.array([0.2, 1.0, 0.4]), (-1.2, 3.0, 0.9)
LIGHTS = {
    "sun": DirectionalLight.around((0.5, -1.0, -0.3), POINTS, 2.0, up=UP),
    "spot": SpotLight.around(LAMP, POINTS, radius=0.1, up=UP, aspect=1.3),
    "point": PointLight.around(LAMP, POINTS, radius=0.1),
}
MAP, SQUARE = (48, 40), (32, 32)
POSE = {"eye": (2.2, 2.6, 3.2), "target": (0.2, 0.3, -0.2), "near": 0.5, "far": 12.0}
CAMERA = PinholeCamera(**POSE, fov_y=32.0, resolution=(32, 48))
WIDE_CAMERA = PinholeCamera(**POSE, fov_y=32.0, resolution=(64, 64))
PARALLEL = OrthographicCamera(**POSE, height=2.5, resolution=(32, 48))
SOFT = SoftCompare(0.7)
PLANE, PLAIN_PLANE = Bias(0.2, 0.3, 0.4, plane=ReceiverPlane()), Bias(0.5, plane=ReceiverPlane())
OFFSET, SLOPED = Bias(0.5, plane=ReceiverPlane(), normal_offset=0.7), Bias(0.2, SlopeBias(0.9, "one_minus_cosine"), 0.3)
SETS = stratified((4, 3), 4)


class Row(NamedTuple):
    """A technique, and the changes that it must not see.

    - `camera`, `light`: of the scene; `casts`: which of its meshes cast.
    - `few`: how many pixels may differ, and `close`: how much the others may.
    """

    technique: Any
    light: str
    changes: tuple[str, ...]
    camera: Any = CAMERA
    casts: tuple[bool, ...] | None = None
    few: int = 0
    close: float = 2e-3


WHOLE = SingleMap()


def mapping(filter, bias=PLANE, size=MAP, layout=WHOLE, compare=SOFT):
    return ShadowMapping(filter, bias, compare, MapSettings(size, silhouettes=False), layout)


ANYWHERE = ("elsewhere", "mirrored", "map turned", "image turned", "meshes cut")
IN_A_CUBE = ("a quarter turn", "mirrored", "image turned", "meshes cut")
UPRIGHT = ("upright elsewhere", "mirrored", "image turned", "meshes cut")
COPIED, SHIFTED = "camera copied", "camera shifted"
# An engine moves vertices to steps of its own, and where meshes are cut there are more.
ENGINE, CLOSE = {"compare": SOFT, "resolution": SQUARE}, {"few": 3, "close": 0.02}
SINGLE = mapping(PercentageCloser(1.7))
# Numbers of texels, samples and pages are those of the layouts' own tests, whose programs these are.
CASCADES = Cascades(4, logarithmic=0.8, blend=0.2, max_blend=0.3, margin=5.0, select="map")
ROWS = {
    "single map": Row(SINGLE, "sun", (*ANYWHERE, "map exchanged", "light copied", COPIED, SHIFTED)),
    "parallel camera": Row(SINGLE, "sun", ("elsewhere", "mirrored", "eye behind", COPIED, SHIFTED), PARALLEL),
    "soft shadows": Row(mapping(PercentageCloserSoft(None, SETS, SETS), SLOPED), "spot", (*ANYWHERE, SHIFTED)),
    "cube": Row(mapping(PercentageCloser(1.7), size=SQUARE), "point", (*IN_A_CUBE, SHIFTED)),
    "cascades": Row(mapping(RandomDisk(3.0), PLAIN_PLANE, SQUARE, CASCADES), "sun", ANYWHERE, WIDE_CAMERA),
    "cascades by interval": Row(
        mapping(Nearest(), layout=Cascades(3, stabilize=False, margin=3.0, depths="surface")),
        "sun",
        (*ANYWHERE, COPIED),
    ),
    "warp": Row(mapping(Nearest(), size=(64, 64), layout=PerspectiveWarp()), "sun", (*ANYWHERE, COPIED)),
    "pages": Row(
        mapping(PercentageCloser(3.0), OFFSET, (132, 131), ResolutionMatched(16, 64, margin=6.0), SoftCompare(0.3)),
        "sun",
        ANYWHERE,
        WIDE_CAMERA,
    ),
    "projective": Row(ProjectiveShadow(MAP, 1.3), "spot", (*ANYWHERE, SHIFTED), casts=(False, True, True)),
    "three.js, basic": Row(
        ThreeJs(-0.01, 0.02, shadow_type="BasicShadowMap", side="double", compare=SOFT, resolution=MAP),
        "sun",
        (*UPRIGHT, SHIFTED),
        **CLOSE,
    ),
    "three.js, variance": Row(
        ThreeJs(-0.01, 0.02, 1.4, shadow_type="VSMShadowMap", side="double", **ENGINE), "spot", UPRIGHT, **CLOSE
    ),
    "three.js, spot": Row(
        ThreeJs(-0.01, 0.02, shadow_type="BasicShadowMap", side="double", **ENGINE), "spot", UPRIGHT, **CLOSE
    ),
    "three.js, cube": Row(
        ThreeJs(-0.01, 0.02, shadow_type="BasicShadowMap", side="double", **ENGINE), "point", IN_A_CUBE, **CLOSE
    ),
    "Babylon.js": Row(BabylonJs(0.02, filter="PCF", back_face_culling=False, **ENGINE), "sun", UPRIGHT, **CLOSE),
    "Babylon.js, cube": Row(BabylonJs(0.02, back_face_culling=False, **ENGINE), "point", IN_A_CUBE, **CLOSE),
}
"""Each technique, and what must leave its picture as it is."""
RARE = (
    *("three.js, basic", "three.js, variance", "Babylon.js, cube"),
    *("pages", "warp", "soft shadows", "cascades", "cube", "three.js, spot", "three.js, cube", "cascades by interval"),
    "Babylon.js",
)
# These compile a program of their own.
COSTLY = ("map exchanged", "light copied")
TABLE = [
    pytest.param(
        *(name, change), id=f"{name}-{change}", marks=pytest.mark.exhaustive if name in RARE or change in COSTLY else ()
    )
    for name, row in ROWS.items()
    for change in row.changes
]
COVERED = ("single map", "cascades by interval", "projective", "three.js, basic")
"""Whose covered pixels are compared too."""


@functools.cache
def scene_of(name):
    row = ROWS[name]
    return Scene(MESHES, row.camera, LIGHTS[row.light], row.casts)


def drawn(name, technique, scene):
    """Visibility, and what is covered."""
    surface = draw_surface(scene.mesh, scene.camera)
    state = technique.prepare(scene, surface)
    covered = technique.covered(state, surface) if name in COVERED else surface.mask
    return np.asarray(technique.visibility(state, surface)), np.asarray(covered)


@functools.cache
def before(name):
    visibility, covered = drawn(name, ROWS[name].technique, scene_of(name))
    # There is much that could change.
    assert np.mean((visibility > 0.05) & (visibility < 0.95)) > 0.15
    assert 0.5 < covered.mean() < 1
    return visibility, covered


@pytest.mark.parametrize(("name", "change"), TABLE)
def test_pictures_follow_a_change_of_the_scene(name, change):
    row, change = ROWS[name], CHANGES[change]
    found = drawn(name, change.technique(row.technique), change.scene(scene_of(name)))
    for after, image in zip(map(change.back, found), before(name), strict=True):
        expected = change.seen(image)
        assert (np.abs(after * 1.0 - expected) > row.close).sum() <= row.few


# --- Filters, of maps and look-ups that are made by hand ---

HARD, EIGHT = HardCompare(), stratified((2, 4))
# Of maps of 16 x 16 texels and these look-ups, whose programs other tests of filters have, too.
FILTERS = {
    "bilinear": (Bilinear(), HARD),
    "box": (PercentageCloser(1.0, 3.0), SoftCompare(1.0, "linear")),
    "tent": (Tent(1.0, 4.0), HARD),
    "Castaño": (Castano(7), HARD),
    "free weights": (Separable((0.5, 0.3)), HARD),
    "PCSS": (PercentageCloserSoft(2.0, EIGHT, EIGHT), HARD),
    "ESM": (ExponentialShadowMap(1.0, 3.0, "tent", exponent=8.0), HARD),
    "MSM": (MomentShadowMap(1.0, 3.0, "gaussian"), HARD),
    "disk": (RandomDisk(1.0, EIGHT), SoftCompare(1.0, "gaussian")),
    "four taps": (FourTap(1.0), HARD),
    "VSM": (VarianceShadowMap(1.0, 3.0), HARD),
    "EVSM": (
        ExponentialVarianceShadowMap(1.0, 3.0, "box", positive_exponent=5.0, negative_exponent=3.0, least_variance=0.1),
        HARD,
    ),
}
SELDOM = ("PCSS", "disk", "four taps", "VSM", "EVSM")
EACH_FILTER = marked(FILTERS, SELDOM)


# Depths (n, n), x and y of places, width and height of the window.
TURNS = {
    "mirrored": (lambda d, x, y, e: (d[:, ::-1], 16 - x, y, e), [-1.0, 1.0], False),
    "upside down": (lambda d, x, y, e: (d[::-1], x, 16 - y, e), [1.0, -1.0], False),
    "exchanged": (lambda d, x, y, e: (d.T, y, x, e[::-1]), [1.0, 1.0], True),
    "moved": (lambda d, x, y, e: (np.roll(d, (2, -3), (0, 1)), x - 3, y + 2, e), [1.0, 1.0], False),
}


def looked_up(kernel, compare, depth, x, y, extent, depths):
    light = DirectionalLight((0, -1, 0), (0, 0, 0), extent, -1, 1)
    return np.asarray(apply(kernel, ShadowMap(as_float(depth), light), lookups_at(x, y, depths), compare))


def random_case():
    """Depths with nothing along the border, places, an extent, and the places' depths."""
    rng = np.random.default_rng(3)
    depth = np.pad(rng.uniform(0.2, 0.8, (10, 10)), 3, constant_values=1.0)
    return (depth, *rng.uniform(1, 15, (2, 9, 13)), np.array([1.0, 1.6])), rng.uniform(0.2, 0.8, (9, 13))


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("name", EACH_FILTER)
def test_filters_follow_their_map(name, turn):
    (kernel, compare), (change, signs, exchanged) = FILTERS[name], TURNS[turn]
    given, depths = random_case()
    before = looked_up(kernel, compare, *given, depths)
    assert np.ptp(before) > 0.3
    turned = with_patterns(lambda offsets: (offsets[..., ::-1] if exchanged else offsets) * np.array(signs))(kernel)
    np.testing.assert_allclose(looked_up(turned, compare, *change(*given), depths), before, atol=2e-5)


def of_radius(technique, radius):
    """With this radius of its kernel, or width of what makes one."""
    for name in ("filter.radius", "blur", "radius", "light_size"):
        with contextlib.suppress(AttributeError):
            return eqx.tree_at(operator.attrgetter(name), technique, jnp.float32(radius))
    return None


@pytest.mark.parametrize(
    "name", marked([name for name, (kernel, _) in FILTERS.items() if of_radius(kernel, 1)], SELDOM)
)
def test_a_radius_of_half_or_whole_texels_is_like_those_beside_it(name):
    (kernel, compare), (given, depths) = FILTERS[name], random_case()
    most = getattr(kernel, "max_radius", 3.0)
    at = lambda radius: looked_up(of_radius(kernel, radius), compare, *given, depths)
    for radius in np.arange(0.5, 3.1, 0.5):
        here = at(radius)
        for beside in (radius - 1e-4, min(radius + 1e-4, most)):
            np.testing.assert_allclose(at(beside), here, atol=2e-3)


# --- Receivers along the light's axis ---

ON_AXIS = ("three.js, basic", "three.js, spot", "three.js, cube", "Babylon.js", "Babylon.js, cube")


def texel_at(name, distance):
    """The width of a texel at a distance from the light, in world units."""
    light, (height, width) = scene_of(name).light, ROWS[name].technique.resolution
    if isinstance(light, DirectionalLight):
        return np.sqrt(np.prod(light.extent) / (height * width)) * np.ones_like(distance)
    half = np.tan(np.radians(light.outer_angle)) * np.sqrt(light.aspect) if isinstance(light, SpotLight) else 1.0
    return 2 * distance * half / height


def along_axis(name, depth, distances):
    """Visibility and what is covered, (n,) each, of receivers at these distances along the light's axis that face it;
    of a cube, along the axis of one face. All of the map holds `depth`."""
    scene, technique = scene_of(name), ROWS[name].technique
    light = scene.light
    view = light.view()
    backward, eye = np.array([0, 0, 1.0]), light.position if hasattr(light, "position") else light.center
    if not isinstance(light, PointLight):
        backward = np.asarray(view.world_to_eye, float)[2, :3]
    surface = draw_surface(scene.mesh, scene.camera)
    state = technique.prepare(scene, surface)
    state = dataclasses.replace(state, depth=jnp.full_like(state.depth, depth))
    # A little off the axis, where no texels meet.
    points = np.asarray(eye) + np.array([1e-3, 1e-3, 0]) - np.resize(distances, surface.mask.size)[:, None] * backward
    fill = lambda values, like: jnp.asarray(np.broadcast_to(values, like.shape), like.dtype)
    surface = dataclasses.replace(
        surface,
        position=fill(points.reshape(surface.position.shape), surface.position),
        normal=fill(backward, surface.normal),
        interpolated_normal=jnp.zeros_like(surface.normal),
        mask=fill(True, surface.mask),
        face=fill(0, surface.face),
    )
    images = technique.visibility(state, surface), technique.covered(state, surface)
    return [np.asarray(image).ravel()[: len(distances)] for image in images]


@pytest.mark.parametrize("name", marked(ON_AXIS, RARE))
def test_a_soft_compare_is_as_wide_as_it_says_in_texels(name):
    light, step = scene_of(name).light, 0.02
    near, far = float(light.near), float(light.far)
    distances = np.linspace(near, far, 122)[1:-1]
    each = np.concatenate([distances - step, distances, distances + step])
    # What the map holds is met somewhere on the way.
    visibility, _ = along_axis(name, 0.5 if isinstance(light, DirectionalLight) else 0.8, each)
    nearer, here, farther = np.clip(visibility.astype(float).reshape(3, -1), 1e-6, 1 - 1e-6)
    logit = lambda share: np.log(share / (1 - share))
    slope = (logit(nearer) - logit(farther)) / (2 * step) * texel_at(name, distances)
    # There, the width alone changes the logistic compare.
    assert here[-1] < 0.4 < 0.6 < here[0]
    np.testing.assert_allclose(np.interp(-0.5, -here, slope), 1 / float(SOFT.width), rtol=0.01)


@pytest.mark.parametrize("name", marked(ON_AXIS, RARE))
def test_receivers_before_and_beyond_the_light_s_range_do_not_count(name):
    light = scene_of(name).light
    near, far = float(light.near), float(light.far)
    before, between, beyond = near - 0.4 * abs(near), np.linspace(near, far, 7)[1:-1], far + 0.5
    visibility, covered = along_axis(name, 0.0, [before, *between, beyond])
    np.testing.assert_array_equal(covered, [False, *[True] * 5, False])
    assert (visibility[1:-1] < 0.5).all()
    keeps_beyond = name == "Babylon.js, cube"
    assert visibility[0] > 0.9
    assert (visibility[-1] > 0.9) != keeps_beyond
