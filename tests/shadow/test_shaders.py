"""Techniques as shaders: visibility by the exported functions, beside ours."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LAMP, LIGHTS, marked
from shader_chains import ByOpenGL, BySpirv, ByWebGPU, Picture

from diffshadow import shadow
from diffshadow._arithmetic import normalize
from diffshadow.geometry import PinholeCamera, PointLight, Scene, SpotLight, library_mesh, merge
from diffshadow.raster import draw_surface
from diffshadow.shadow import (
    AdaptiveBias,
    Bias,
    Bilinear,
    Cascades,
    Castano,
    ConstantBias,
    ExponentialShadowMap,
    ExponentialVarianceShadowMap,
    FourTap,
    HardCompare,
    LinearBias,
    MapSettings,
    MomentShadowMap,
    Nearest,
    NormalOffset,
    PercentageCloser,
    PercentageCloserSoft,
    PerceptronBias,
    PerspectiveWarp,
    RandomDisk,
    ReceiverPlane,
    Separable,
    ShadowMapping,
    SingleMap,
    SlopeBias,
    SoftCompare,
    Tent,
    VarianceShadowMap,
    shader_buffers,
    to_shader,
)

SIDE = 128


def trained():
    """A perceptron of all features, as a training leaves it: no weight is 0."""
    weights = (1.0, 0.4, 0.2, 0.3, 0.5, -0.6, 0.02)
    names = ("one", "slope", "sine", "one_minus_cosine", "texel_size", "distance", "blocker_distance")
    bias = PerceptronBias.correcting(LinearBias(dict(zip(names, weights, strict=True))), seed=1)
    return eqx.tree_at(lambda bias: bias.last, bias, jnp.linspace(-1, 1.5, bias.last.size))


PLAIN = Bias(0.3, 0.5, 0.4)


HARD, SINGLE = HardCompare(), SingleMap()


def mapping(filter, bias, compare=HARD, depth_format="float32", layout=SINGLE):
    return ShadowMapping(filter, bias, compare, MapSettings((SIDE, SIDE), depth_format=depth_format), layout)


TECHNIQUES = {
    "nearest, clamped slope, window depth": mapping(
        Nearest(), Bias(ConstantBias(1e-4, "depth"), SlopeBias(0.6, least=0.05, most=2.0))
    ),
    "bilinear, fixed point": mapping(Bilinear(), PLAIN, depth_format="unorm16"),
    "four taps, Godot's offset": mapping(FourTap(1.2), Bias(0.2, 0.6, NormalOffset(0.5, "across"))),
    "box, plane": mapping(PercentageCloser(1.7), Bias(plane=ReceiverPlane(deepening=0.5)), depth_format="unorm16"),
    "tent, linear": mapping(
        Tent(2.3), Bias(0.1, terms=LinearBias({"one": 0.1, "slope": 0.3, "blocker_distance": 0.1}))
    ),
    "Castano, perceptron": mapping(
        Castano(3), Bias(normal_offset=NormalOffset(0.3, "one_minus_cosine"), terms=trained())
    ),
    "separable, soft": mapping(Separable((0.9, 0.5, 0.2)), PLAIN, SoftCompare(0.4)),
    "disk, early out": mapping(RandomDisk(2.5, shadow.stratified(32, 4), early_out=True), PLAIN),
    "rotated disk, nearest taps": mapping(
        RandomDisk(3.0, shadow.vogel(12, rotated=True), "nearest"), Bias(plane=ReceiverPlane(1.0, 0.4))
    ),
    "adaptive, fixed point": mapping(Nearest(), Bias(plane=AdaptiveBias(0.1)), depth_format="unorm16"),
    "soft shadows": mapping(
        PercentageCloserSoft(0.15, shadow.stratified(16, 2, seed=1), shadow.vogel(16, rotated=True)),
        Bias(plane=ReceiverPlane(deepening=0.0)),
    ),
    "exponential compare": mapping(Bilinear(), PLAIN, SoftCompare(0.5, "exponential")),
    "gaussian compare": mapping(Bilinear(), PLAIN, SoftCompare(0.5, "gaussian")),
    "vsm": mapping(VarianceShadowMap(2.0, kernel="tent", least_variance=1e-5, light_bleeding=0.2), PLAIN),
    "esm": mapping(ExponentialShadowMap(2.5, exponent=20.0), PLAIN, depth_format="unorm16"),
    "evsm": mapping(ExponentialVarianceShadowMap(2.5, kernel="gaussian"), PLAIN),
    "msm": mapping(MomentShadowMap(2.0, light_bleeding=0.02), PLAIN),
    "cascades by map, blended": mapping(
        PercentageCloser(1.5),
        Bias(0.4, 0.6, 0.3, factors=(1.0, 0.8, 1.5)),
        layout=Cascades(3, select="map", blend=0.3, margin=4.0),
    ),
    "cascades by depth, fading": mapping(
        Bilinear(), PLAIN, layout=Cascades(distances=(2.5, 3.0, 4.0), blend=0.4, fade=0.5, shares=(4.0, 2.0, 1.0))
    ),
    "moments in cascades": mapping(
        ExponentialVarianceShadowMap(2.0, negative_exponent=10.0), PLAIN, layout=Cascades(2, 0.7, fit="scene")
    ),
    "warp, plane": mapping(
        PercentageCloser(1.5), Bias(normal_offset=0.3, plane=ReceiverPlane(deepening=1.0)), layout=PerspectiveWarp()
    ),
    "perspective warp, soft": mapping(
        PercentageCloserSoft(2.0, shadow.vogel(12), shadow.vogel(16)),
        Bias(0.5, 0.5, plane=ReceiverPlane(deepening=0.0)),
        layout=PerspectiveWarp("perspective", shadow_distance=4.2, margin=33.0),
    ),
}


@pytest.fixture(scope="module", params=marked(["glsl", "wgsl", "hlsl"], {"wgsl", "hlsl"}))
def chain(request, tmp_path_factory):
    makers = {"glsl": ByOpenGL, "wgsl": ByWebGPU, "hlsl": lambda: BySpirv(tmp_path_factory.mktemp("hlsl"))}
    return request.param, makers[request.param]()


def bulb(mesh):
    return PointLight.around(jnp.asarray(LAMP), mesh.vertices)


def narrow(mesh):
    """A lamp whose cone and depths end within the scene."""
    return SpotLight(LAMP, tuple(-x for x in LAMP), outer_angle=12.0, near=3.0, far=3.6)


EACH = {**LIGHTS, "point": bulb, "narrow": narrow}


@functools.cache
def picture_of(name, light):
    """A technique's visibility of a small scene under a light, and what a shader needs to find it."""
    meshes = [library_mesh("torus", segments=14, sides=8), library_mesh("plane", size=3.0)]
    camera = PinholeCamera((1.6, 1.4, 2.0), (0.0, 0.2, 0.0), fov_y=40, near=0.1, far=10, resolution=(SIDE, SIDE))
    scene = Scene(meshes, camera, EACH[light](merge(meshes)))
    technique, surface = TECHNIQUES[name], draw_surface(scene.mesh, camera)
    state = technique.prepare(scene)
    ways = normalize(scene.light.towards(surface.position))
    buffers = shader_buffers(technique, state.light, "wgsl").values()
    picture = Picture(state, surface, ways, buffers)
    return state.light, picture, np.asarray(technique.visibility(state, surface)), np.asarray(surface.mask)


# A light changes constants only, so that four techniques are enough for the others.
SOME = ("bilinear, fixed point", "box, plane", "disk, early out", "soft shadows")
FITTED = tuple(name for name, technique in TECHNIQUES.items() if technique.layout != SINGLE)
CASES = [
    *((name, "directional" if name in FITTED else "spot") for name in TECHNIQUES),
    *((name, light) for light in ("directional", "point") for name in (*SOME, "vsm", "esm", "evsm", "msm")),
    *((name, "narrow") for name in ("box, plane", "separable, soft", "disk, early out", "vsm", "msm")),
]
EVERYDAY = {("box, plane", "spot"), ("disk, early out", "spot"), ("moments in cascades", "directional")}


@pytest.mark.parametrize(
    ("name", "light"),
    [pytest.param(*case, marks=[] if case in EVERYDAY else pytest.mark.exhaustive) for case in CASES],
)
def test_visibility_by_an_exported_shader_is_ours(chain, name, light):
    language, draw = chain
    of_light, picture, ours, mask = picture_of(name, light)
    theirs = draw(to_shader(TECHNIQUES[name], of_light, language), picture)
    differ = (np.abs(theirs - ours) > 1 / 255)[mask].mean()
    assert differ <= 1e-3
    penumbra = (ours > 0.01) & (ours < 0.99) & mask
    assert penumbra.sum() > 100 or isinstance(TECHNIQUES[name].filter, Nearest)
    assert 0.03 < (ours == 0)[mask].mean() < 0.9


def test_constants_have_all_digits_and_a_comment():
    text = to_shader(mapping(Castano(3), Bias(1 / 3)), LIGHTS["directional"](library_mesh("box")))
    assert "const float SHADOW_CONSTANT_BIAS = 0.333333343;  // along the light's axis, in texels\n" in text
    assert "const float SHADOW_WEIGHTS[5] = float[5](0.0, 0.25, 0.5, 0.25, 0.0);" in text
    # What is 0 has no code.
    assert "SHADOW_SLOPE_BIAS" not in text
    assert "const bool SHADOW_HAS_NORMAL_OFFSET = false;" in text


@pytest.mark.parametrize(
    ("technique", "message"),
    [
        (shadow.ShadowVolumes(), r"the technique is ShadowVolumes, .*; the most similar is ShadowMapping"),
        (shadow.IrregularZBuffer(), r"the technique is IrregularZBuffer, .*; the most similar is ShadowMapping"),
        (shadow.ProjectiveShadow(), r"the technique is ProjectiveShadow, .*; the most similar is ShadowMapping"),
        (shadow.ThreeJs(), r"the technique is ThreeJs, .*; `diffshadow convert` writes its settings"),
        (
            mapping(Nearest(), Bias(1.0, factors=(1.0, 2.0))),
            r"the bias has 2 factors, and the map has 1 layer",
        ),
        (mapping(Nearest(), PLAIN, layout=Cascades()), r"the light is a DirectionalLight, .*light_of_map\(scene\)"),
        (
            mapping(Nearest(), PLAIN, layout=shadow.ResolutionMatched()),
            r"ResolutionMatched, whose pages .*: the most similar is cascades",
        ),
        (ShadowMapping(Nearest(), PLAIN, map=MapSettings(silhouettes=True)), r"silhouettes is true, .*expected false"),
    ],
)
def test_what_has_no_shader_is_refused(technique, message):
    with pytest.raises(ValueError, match=message):
        to_shader(technique, LIGHTS["directional"](library_mesh("box")))


@pytest.mark.exhaustive
def test_two_shaders_fit_into_one_program(chain):
    language, draw = chain
    of_light, picture, ours, mask = picture_of("disk, early out", "spot")
    other = to_shader(TECHNIQUES["vsm"], picture_of("vsm", "point")[0], language, name="lamp_2", first_binding=1)
    assert ("LAMP_2_NEAR" in other, "Lamp2Receiver" in other, "lamp_2_blur_rows(" in other) == (True, True, True)
    theirs = draw(other + to_shader(TECHNIQUES["disk, early out"], of_light, language), picture)
    assert (np.abs(theirs - ours) > 1 / 255)[mask].mean() <= 1e-3


@pytest.mark.parametrize("name", ["Sun", "2nd", "gl_sun", "a__b", "_a", ""])
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(ValueError, match=r"the shader's name is .*expected small letters"):
        to_shader(TECHNIQUES["vsm"], LIGHTS["spot"](library_mesh("box")), name=name)


def test_long_tables_are_buffers_of_wgsl():
    technique, light = mapping(RandomDisk(2.0), PLAIN), LIGHTS["spot"](library_mesh("box"))
    text = to_shader(technique, light, "wgsl", "lamp", first_binding=3)
    assert "@group(1) @binding(3) var<storage, read> LAMP_PATTERN: array<f32>;" in text
    ((name, values),) = shader_buffers(technique, light, "wgsl", "lamp").items()
    assert name == "LAMP_PATTERN"
    np.testing.assert_array_equal(values, np.ravel(technique.filter.pattern.offsets))
    assert shader_buffers(technique, light, "glsl") == {}
    short = mapping(RandomDisk(2.0, shadow.vogel(16)), PLAIN)
    assert "array<f32, 32>(" in to_shader(short, light, "wgsl")
    assert shader_buffers(short, light, "wgsl") == {}


def test_a_light_of_other_layers_is_refused():
    camera = PinholeCamera((1.6, 1.4, 2.0), (0.0, 0.2, 0.0), fov_y=40, near=0.1, far=10)
    cascades = shadow.Cascades().light(LIGHTS["directional"](library_mesh("box")), camera, (64, 64), None)
    with pytest.raises(ValueError, match="which has no shader; expected a directional, a spot or a point light"):
        to_shader(mapping(Nearest(), PLAIN), cascades)
