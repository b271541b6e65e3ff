"""Biases: their units, their profiles, their gradients, and that several add up."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import LIGHTS, drawn, floor_and_card, lamp, sun

from diffshadow import shadow
from diffshadow._arithmetic import as_float, at_least, at_most
from diffshadow.config import parse_config
from diffshadow.raster import Surface
from diffshadow.settings import rules
from diffshadow.shadow import (
    AdaptiveBias,
    Bias,
    BiasTerms,
    ConstantBias,
    LinearBias,
    NormalOffset,
    Pattern,
    PerceptronBias,
    Receiver,
    ReceiverPlane,
    ShadowMap,
    SlopeBias,
    SoftCompare,
    look_up,
    mean_of_taps,
    receiver,
)
from diffshadow.shadow.biases import FEATURES

ANGLES = np.array([0.0, 10.0, 45.0, 80.0, 89.9, 90.0, 120.0])


ROUNDING = 1e-6


def receivers_at(angles=ANGLES, texel=0.02, depth_per_texel=1e-3):
    """Receivers in the plane y = 0 that the light meets at `angles`, degrees, slanted along the map's x.

    They fall a quarter to the right of the middle of a texel.
    """
    shape = (1, len(angles))
    angles, zero = np.radians(angles)[None], np.zeros(shape)
    slope = np.stack([np.minimum(np.abs(np.tan(angles)), 100), zero], axis=-1)
    at = {
        "position": np.zeros((*shape, 3)),
        "normal": np.broadcast_to([0.0, 1.0, 0.0], (*shape, 3)),
        "cosine": np.cos(angles),
        "texel": np.broadcast_to([3.75, 5.5], (*shape, 2)),
        "depth": zero + 0.5,
        "in_front": zero == 0,
        "texel_size": zero + texel,
        "depth_per_texel": zero + depth_per_texel,
        "slope": slope,
        "rounding": zero + ROUNDING,
        "distance": zero + 0.25,
        "depth_range": np.asarray(20.0),
        "stored": zero + 0.494,
        "layer": None,
    }
    on_device = lambda x: jnp.asarray(x) if x.dtype == bool else as_float(x)
    return Receiver(**jax.tree.map(on_device, at))


def test_constant_bias_is_in_texels_of_depth():
    terms = ConstantBias(3.0)(receivers_at())
    np.testing.assert_allclose(terms.depth, np.full((1, 7), 3e-3), rtol=1e-6)
    assert terms.displacement is None


def test_slope_bias_is_in_proportion_to_the_tangent():
    depth = np.asarray(SlopeBias(2.0)(receivers_at()).depth)[0]
    np.testing.assert_allclose(depth[:4], 2e-3 * np.tan(np.radians(ANGLES[:4])), rtol=1e-4, atol=1e-9)
    # Slanted along both of the map's axes.
    at = eqx.tree_at(lambda at: at.slope, receivers_at(), jnp.zeros((1, 7, 2)) + jnp.array([3.0, -4.0]))
    np.testing.assert_allclose(SlopeBias(2.0)(at).depth, 2e-3 * 5, rtol=1e-6)


def test_slope_bias_is_held_between_its_bounds():
    depth = np.asarray(SlopeBias(2.0, least=1.0, most=5.0)(receivers_at()).depth)[0]
    tangent = np.minimum(np.abs(np.tan(np.radians(ANGLES))), 100)
    np.testing.assert_allclose(depth, 1e-3 * np.clip(2 * tangent, 1, 5), rtol=1e-4)


def test_a_bias_on_its_bound_keeps_its_derivative():
    """Without one, a fit that starts there would never leave it."""
    for held in (at_least, at_most):
        for x, slope in ((0.5, held is at_most), (1.0, True), (1.5, held is at_least)):
            found = jax.jvp(lambda x, held=held: held(x, jnp.float32(1)), (jnp.float32(x),), (jnp.float32(1),))[1]
            assert found == slope


def test_slope_bias_of_shader_cookbooks_is_in_window_depth_and_converts_to_texels():
    cosine = np.clip(np.cos(np.radians(ANGLES)), 0, 1)
    expected = np.maximum(0.05 * (1 - cosine), 0.005)
    in_depth = SlopeBias(0.05, "one_minus_cosine", least=0.005, unit="depth")
    np.testing.assert_allclose(in_depth(receivers_at()).depth[0], expected, rtol=1e-5)
    # Under another light the same numbers mean the same depth, and other texels.
    np.testing.assert_allclose(in_depth(receivers_at(depth_per_texel=0.1)).depth[0], expected, rtol=1e-5)
    np.testing.assert_allclose(ConstantBias(0.005, "depth")(receivers_at()).depth, 0.005, rtol=1e-6)
    in_texels = SlopeBias(0.05 / 1e-3, "one_minus_cosine", least=0.005 / 1e-3)
    np.testing.assert_allclose(in_texels(receivers_at()).depth[0], expected, rtol=1e-5)


@eqx.filter_jit
def seen(shadow_map, surface):
    return receiver(shadow_map, surface)


@pytest.mark.exhaustive
def test_texels_convert_to_window_depth_by_the_view():
    surface, shadow_map = drawn("spot", 64, 64)
    mask, light = np.asarray(surface.mask), shadow_map.light
    at = seen(shadow_map, surface)
    near, far = float(light.near), float(light.far)
    distance = near * far / (far - np.asarray(at.depth, np.float64)[mask] * (far - near))
    texel = 2 * distance * np.tan(np.radians(float(light.outer_angle))) / 64
    found, expected = np.asarray(at.depth_per_texel)[mask], texel * near * far / (far - near) / distance**2
    assert np.ptp(found) > 0.1 * found.max()
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_receiver_plane_subtracts_its_fudge_and_follows_the_plane():
    at = receivers_at(np.array([30.0, 60.0, 85.0]))
    at = eqx.tree_at(lambda at: at.slope, at, at.slope.at[..., 1].set(-2.0))
    plane = ReceiverPlane(0.5, limit=2.0, deepening=3.0)(at)
    steep = np.abs(np.asarray(at.slope)).sum(axis=-1)
    np.testing.assert_allclose(plane.depth, 1e-3 * np.minimum(0.5 * steep, 2) + ROUNDING, rtol=1e-5)
    np.testing.assert_allclose(plane.deepening, 3e-3, rtol=1e-6)
    assert plane.follows_plane
    assert plane.displacement is None
    bare = ReceiverPlane()(at)
    np.testing.assert_allclose(bare.depth, ROUNDING, rtol=1e-6)
    assert bare.deepening is None


def test_taps_that_follow_a_plane_go_no_deeper_than_its_deepening():
    at = receivers_at(np.array([60.0]))
    shadow_map = ShadowMap(jnp.full((8, 8), 0.5), sun(floor_and_card()))
    slope, right = np.tan(np.radians(60)), np.array([-3.0, -1.0, 0.0, 1.0, 4.0])
    one = lambda x: Pattern(jnp.asarray(np.array([[[[x, 0.0]]]], np.float32)))
    for deepening, most in ((8192.0, np.inf), (1.0, 1.0), (0.0, 0.0)):
        lit = np.array([taps_of_plane(shadow_map, at, ReceiverPlane(deepening=deepening), one(x)) for x in right])
        # In texels, from how dark a ramp finds it; a quarter of one from the receiver to the centre of its own.
        found = 20 * (1 - 2 * lit)
        np.testing.assert_allclose(found, np.minimum(slope * (right - 0.25), most) - ROUNDING / 1e-3, atol=1e-3)


@eqx.filter_jit
def taps_of_plane(shadow_map, at, bias, pattern):
    lookup, compare = look_up(shadow_map, at, bias(at)), SoftCompare(20.0, "linear")
    return mean_of_taps(shadow_map, lookup, compare, jnp.float32(1.0), pattern, "nearest")[0, 0]


def test_adaptive_bias_lifts_the_receiver_to_its_plane_at_the_texels_centre():
    at = receivers_at(np.array([0.0, 45.0, 80.0]))
    tangent = np.tan(np.radians([0.0, 45.0, 80.0]))
    # Sloping down from the centre of the texel to the receiver, a quarter of a texel on; and up.
    np.testing.assert_allclose(AdaptiveBias(0.3)(at).depth[0], 1e-3 * (0.25 * tangent + 0.3) + ROUNDING, rtol=1e-5)
    up = eqx.tree_at(lambda at: at.slope, at, -at.slope)
    np.testing.assert_allclose(AdaptiveBias(0.3)(up).depth[0], 1e-3 * 0.3 + ROUNDING, rtol=1e-5)
    assert not AdaptiveBias()(at).follows_plane


@pytest.mark.parametrize(
    ("profile", "formula"),
    [
        ("sine", lambda angle: np.sin(angle)),
        ("constant", lambda angle: np.ones_like(angle)),
        ("one_minus_cosine", lambda angle: 1 - np.cos(angle)),
    ],
)
def test_normal_offset_moves_along_the_normal_by_its_profile(profile, formula):
    terms = NormalOffset(1.5, profile)(receivers_at())
    angles = np.radians(np.minimum(ANGLES, 90))
    np.testing.assert_allclose(terms.displacement[0, :, 1], 1.5 * 0.02 * formula(angles), rtol=1e-5, atol=1e-7)
    assert (np.asarray(terms.displacement)[..., [0, 2]] == 0).all()
    assert (np.asarray(terms.depth) == 0).all()


def test_offset_across_the_light_moves_nothing_towards_it():
    """Window depth falls by a thousandth per texel of 0.02 towards the light."""
    plain, across = (NormalOffset(1.5, profile)(receivers_at()) for profile in ("one_minus_cosine", "across"))
    np.testing.assert_array_equal(across.displacement, plain.displacement)
    cosine = np.maximum(np.cos(np.radians(ANGLES)), 0)
    towards = across.displacement[0, :, 1] * cosine / 0.02 * 1e-3
    np.testing.assert_allclose(-across.depth[0], towards, rtol=1e-5, atol=1e-9)


LINEAR = LinearBias({"one": 0.5, "slope": 0.25, "blocker_distance": -0.5})


def network(sizes):
    """A perceptron on top of `LINEAR` whose last weights are not 0."""
    made = PerceptronBias.correcting(LINEAR, sizes, seed=3)
    return eqx.tree_at(lambda bias: bias.last, made, 0.3 + 0.1 * jnp.arange(made.last.size))


def test_linear_bias_is_the_sum_of_its_terms_and_never_negative():
    at = receivers_at(np.array([0.0, 45.0, 60.0, 120.0]))
    angle = np.radians([0.0, 45.0, 60.0, 120.0])
    tangent, cosine = np.abs(np.tan(angle)), np.maximum(np.cos(angle), 0)
    # As `receivers_at` has them: texels 0.1 % of the depth range, a quarter of the way, the map 6 texels in front.
    features = {
        "one": np.ones(4),
        "slope": tangent,
        "sine": np.sqrt(1 - cosine**2),
        "one_minus_cosine": 1 - cosine,
        "texel_size": np.full(4, 0.1),
        "distance": np.full(4, 0.25),
        "blocker_distance": np.full(4, 6.0),
    }
    assert features.keys() == FEATURES.keys()
    for name, feature in features.items():
        found = LinearBias({"one": 0.5, name: 2.0} if name != "one" else {name: 2.5})(at).depth[0] / 1e-3
        np.testing.assert_allclose(found, 0.5 + 2 * feature, rtol=1e-4, atol=1e-5)
    # -2.5 and more of the slope.
    np.testing.assert_allclose(LINEAR(at).depth[0], 0, atol=0)
    steep = LinearBias({"slope": 2.0, "blocker_distance": -0.5})(at).depth[0]
    np.testing.assert_allclose(steep, 1e-3 * np.maximum(2 * tangent - 3, 0), rtol=1e-4, atol=1e-7)


def test_a_linear_bias_holds_the_classical_ones():
    at = receivers_at()
    linear = LinearBias({"one": 0.7, "slope": 0.4})
    np.testing.assert_allclose(linear(at).depth, Bias(0.7, 0.4)(at).depth, rtol=1e-6)
    np.testing.assert_allclose(Bias(terms=linear)(at).depth, linear(at).depth, rtol=1e-6)
    start = PerceptronBias.correcting(linear)
    np.testing.assert_array_equal(start(at).depth, linear(at).depth)
    assert start.count == 2 + 8 + 8 + 8


def test_perceptron_is_its_formula():
    bias, at = network((4, 3)), receivers_at(np.array([20.0, 60.0, 87.0]))
    x = np.stack([np.tan(np.radians([20.0, 60.0, 87.0])), np.full(3, 6.0)])
    total = 0.5 + 0.25 * x[0] - 0.5 * x[1]
    values = x / (1 + x)
    for layer in bias.hidden:
        values = np.tanh(np.asarray(layer.weight) @ values + np.asarray(layer.bias)[:, None])
    total = total + np.asarray(bias.last) @ values
    assert (total > 0).any()
    assert (total < 0).any()
    np.testing.assert_allclose(bias(at).depth[0], 1e-3 * np.maximum(total, 0), rtol=1e-4, atol=1e-7)
    again = PerceptronBias.of(
        LINEAR, [(layer.weight.tolist(), layer.bias.tolist()) for layer in bias.hidden], bias.last.tolist()
    )
    np.testing.assert_array_equal(again(at).depth, bias(at).depth)


def test_blockers_count_to_sixteen_texels_and_not_behind_the_receiver():
    at = receivers_at(np.zeros(3))
    at = eqx.tree_at(lambda at: at.stored, at, jnp.array([[0.4, 0.5005, 1.0]]))
    # A constant beside it, since no bias is negative.
    bias = LinearBias({"one": 1.0, "blocker_distance": 1.0})
    np.testing.assert_allclose(bias(at).depth[0], [0.017, 0.001, 0.001], rtol=1e-4, atol=1e-9)


def test_terms_of_a_bias_add_up():
    at = receivers_at(np.array([30.0, 60.0]))
    whole = Bias(1.0, 0.5, 2.0)(at)
    parts = ConstantBias(1.0)(at) + SlopeBias(0.5)(at) + NormalOffset(2.0)(at)
    np.testing.assert_allclose(whole.depth, parts.depth, rtol=1e-6)
    np.testing.assert_allclose(whole.displacement, parts.displacement, rtol=1e-6)
    assert isinstance(whole, BiasTerms)


EVERY = {
    "constant": ConstantBias(1.0),
    "slope": SlopeBias(0.5, most=2.0),
    "cookbook": SlopeBias(0.05, "one_minus_cosine", least=0.005, unit="depth"),
    "normal_offset": NormalOffset(2.0),
    "plane": ReceiverPlane(0.5, deepening=1.0),
    "adaptive": AdaptiveBias(0.1),
    "linear": LinearBias({"one": 0.2, "slope": 0.3, "distance": -0.1}),
    "perceptron": PerceptronBias.correcting(LinearBias({"one": 0.2, "slope": 0.3}), (2,)),
    "bias": Bias(0.3, 0.2, 0.1, ReceiverPlane(deepening=0.5)),
}


@pytest.mark.parametrize(("one", "other"), list(itertools.combinations(EVERY, 2)))
def test_any_two_biases_add_up(one, other):
    at = receivers_at(np.array([30.0, 60.0]))
    a, b = EVERY[one](at), EVERY[other](at)
    zero = jnp.zeros_like(at.position)
    moved = lambda terms: zero if terms.displacement is None else terms.displacement
    limit = lambda terms: jnp.inf if terms.deepening is None else terms.deepening
    for found in (
        a + b,
        b + a,
        Bias(0, EVERY[one], EVERY[other])(at),
        Bias(normal_offset=EVERY[one], plane=EVERY[other])(at),
    ):
        np.testing.assert_allclose(found.depth, a.depth + b.depth, rtol=1e-6)
        np.testing.assert_allclose(moved(found), moved(a) + moved(b), rtol=1e-6)
        np.testing.assert_array_equal(limit(found), jnp.minimum(limit(a), limit(b)))
        assert found.follows_plane == (a.follows_plane or b.follows_plane)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SlopeBias(0.5, least=2.0, most=1.0), r"least is 2.0 and most is 1.0; expected least at most most"),
        (lambda: LinearBias({}), r"linear bias has no terms; expected one or more"),
        (
            lambda: LinearBias({"tangent": 1.0}),
            r"linear bias has a term 'tangent'; expected terms among one, slope, sine",
        ),
        (lambda: LinearBias({"one": float("nan")}), r"weights\['one'\] is nan; expected a number"),
        (lambda: network((40,)), r"perceptron has 163 weights; expected at most 100"),
        (lambda: network(()), r"2 inputs and layers of 1 x 2 weights; expected one or more hidden layers"),
        (lambda: PerceptronBias.of(LINEAR, [([[1.0]], [0.0])], [1.0]), r"2 inputs and layers of 1 x 1, 1 x 1 weights"),
        (lambda: PerceptronBias.of(LINEAR, [([[1.0, 2.0]], [0.0] * 2)], [1.0]), r"and a bias for each row"),
        (lambda: PerceptronBias.of(LINEAR, [([[1.0], [1.0, 2.0]], [0.0] * 2)], [1.0]), r"lengths \[1, 2\]; expected"),
    ],
)
def test_impossible_biases_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_bias_takes_modules_for_its_parts():
    bias = Bias(normal_offset=NormalOffset(1.0, "constant"))
    np.testing.assert_allclose(bias(receivers_at()).displacement[..., 1], 0.02, rtol=1e-6)


def test_no_bias_moves_nothing_and_no_profile_has_a_nan_slope():
    terms = eqx.filter_jit(Bias())(receivers_at())
    assert (np.asarray(terms.depth) == 0).all()
    assert (np.asarray(terms.displacement) == 0).all()

    def total(cosine):
        at = receivers_at()
        at = eqx.tree_at(lambda at: at.cosine, at, cosine)
        biases = (*EVERY.values(), *(NormalOffset(1.0, p) for p in ("sine", "constant", "one_minus_cosine", "across")))
        terms = [bias(at) for bias in biases]
        return sum(jnp.sum(leaf) for leaf in jax.tree.leaves(terms))

    edges = jnp.array([[1.0, 1.0 + 1e-7, 0.0, -1.0, 0.01, 0.5, -0.0]])
    assert np.isfinite(np.asarray(jax.jit(jax.grad(total))(edges))).all()


@eqx.filter_jit
def matrices(light):
    view = light.view()
    return view.matrix, view.world_to_eye


@pytest.mark.exhaustive
@pytest.mark.parametrize("light", LIGHTS)
def test_receivers_know_the_size_of_their_texels(light):
    """Against the projection itself: steps of a share of a texel's width move a point by that share of a texel."""
    surface, shadow_map = drawn(light, 64, 64)
    at = seen(shadow_map, surface)
    mask = np.asarray(surface.mask)
    matrix, world_to_eye = (np.asarray(x, np.float64) for x in matrices(shadow_map.light))

    def window(position):
        clip = position @ matrix[:, :3].T + matrix[:, 3]
        return clip[..., :3] / clip[..., 3:] * 0.5 + 0.5

    step, position = np.asarray(at.texel_size)[..., None], np.asarray(surface.position, np.float64)
    middle = window(position)
    np.testing.assert_allclose(np.asarray(at.texel)[mask], middle[mask][:, :2] * 64, atol=1e-3)
    np.testing.assert_allclose(np.asarray(at.depth)[mask], middle[mask][:, 2], atol=1e-5)
    moved = [window(position + step * world_to_eye[k, :3] / 8) - middle for k in range(3)]
    # The width is the mean of a texel's two sides, which differ under the sun.
    area = moved[0][mask][:, 0] * moved[1][mask][:, 1] * (8 * 64) ** 2
    np.testing.assert_allclose(area, 1, rtol=5e-3)
    # Along the axis, the eye looks along -z; a finite step sees the perspective's curvature.
    np.testing.assert_allclose(-moved[2][mask][:, 2] * 8, np.asarray(at.depth_per_texel)[mask], rtol=0.03)
    np.testing.assert_allclose(np.linalg.norm(np.asarray(surface.normal)[mask], axis=-1), 1, atol=1e-5)
    # The way along the axis, and what the map stores there.
    eye = position @ world_to_eye[2, :3] + world_to_eye[2, 3]
    near, far = (float(getattr(shadow_map.view, end)) for end in ("near", "far"))
    np.testing.assert_allclose(np.asarray(at.distance)[mask], ((-eye - near) / (far - near))[mask], atol=1e-5)
    np.testing.assert_allclose(at.depth_range, far - near, rtol=1e-6)
    column, row = np.clip(np.floor(np.asarray(at.texel)).astype(int), 0, 63)[mask].T
    within = ((np.asarray(at.texel) >= 0) & (np.asarray(at.texel) < 64)).all(axis=-1)[mask]
    stored = np.where(within, np.asarray(shadow_map.depth)[row, column], 1)
    np.testing.assert_array_equal(np.asarray(at.stored)[mask], stored)
    assert (~within).any() == (light == "spot") or within.all()
    assert (np.abs(np.asarray(at.cosine)[mask]) <= 1 + 1e-6).all()


def surface_of(position, normal, mask):
    """A surface of arrays (h, w, 3), of whose fields the light sees these."""
    position, normal = (jnp.asarray(np.asarray(x), jnp.float32) for x in (position, normal))
    return Surface(position, normal, normal, position, jnp.asarray(mask, jnp.int32), jnp.asarray(mask))


@pytest.mark.exhaustive
def test_maps_that_are_not_square_have_a_mean_texel():
    mesh = floor_and_card()
    light = sun(mesh)
    x, z = np.meshgrid([-1.0, 0.0], [0.0, 1.0])
    position = np.stack([x, 0 * x, z], axis=-1)
    surface = surface_of(position, np.broadcast_to([0, 1, 0], position.shape), np.ones((2, 2), bool))
    at = seen(ShadowMap(jnp.ones((40, 160)), light), surface)
    width, height = np.asarray(light.extent) / [160, 40]
    np.testing.assert_allclose(at.texel_size, np.sqrt(width * height), rtol=1e-5)
    matrix = np.asarray(matrices(light)[0], np.float64)
    window = (position @ matrix[:2, :3].T + matrix[:2, 3]) * 0.5 + 0.5
    np.testing.assert_allclose(at.texel, window * [160, 40], rtol=1e-4)


@eqx.filter_jit
def seen_and_biased(shadow_map, surface):
    at = receiver(shadow_map, surface)
    return at, Bias(1.0, 1.0, 1.0)(at)


def test_pixels_without_a_surface_hold_harmless_numbers():
    for light in (sun(floor_and_card()), lamp(floor_and_card())):
        # A position on the light itself, no normal, and no surface.
        where = light.position if hasattr(light, "position") else light.center
        surface = surface_of(np.zeros((2, 2, 3)) + where, np.zeros((2, 2, 3)), np.array([[True, False]] * 2))
        for leaf in jax.tree.leaves(seen_and_biased(ShadowMap(jnp.ones((8, 8)), light), surface)):
            assert np.isfinite(np.asarray(leaf)).all()


@pytest.mark.parametrize("light", LIGHTS)
def test_receivers_know_the_slope_of_their_plane_in_the_map(light):
    """Against the projection itself: a step along the receiver's plane moves as far into depth as the slope says."""
    with jax.enable_x64(True):
        to_double = lambda x: jnp.asarray(x, jnp.float64) if eqx.is_inexact_array_like(x) else x
        surface, shadow_map = jax.tree.map(to_double, drawn(light, 64, 64))
        at = jax.tree.map(np.asarray, seen(shadow_map, surface))
        mask = np.asarray(surface.mask)
        across = np.cross(np.asarray(surface.normal), [0.3, 0.5, -0.8])
        for way in (across, np.cross(np.asarray(surface.normal), across)):
            moved = eqx.tree_at(lambda s: s.position, surface, jnp.asarray(np.asarray(surface.position) + 1e-5 * way))
            there = jax.tree.map(np.asarray, seen(shadow_map, moved))
            step = np.asarray(there.texel - at.texel)[mask]
            expected = (np.asarray(at.slope)[mask] * step).sum(axis=-1) * np.asarray(at.depth_per_texel)[mask]
            found = np.asarray(there.depth - at.depth)[mask]
            assert np.abs(found).max() > 1e-7
            # Window depth is linear in the window along a plane.
            np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-13)


def test_grazing_receivers_have_a_large_slope_but_no_endless_one():
    mesh = floor_and_card()
    shadow_map = ShadowMap(jnp.ones((40, 40)), sun(mesh, (1.0, 0.0, 0.0)))
    normal = np.array([[[0.0, 1.0, 0.0], [1e-4, 1.0, 0.0]]])
    surface = surface_of(np.zeros((1, 2, 3)), normal, np.ones((1, 2), bool))
    steepness = np.linalg.norm(np.asarray(seen(shadow_map, surface).slope), axis=-1)
    extent = np.asarray(shadow_map.light.extent)
    np.testing.assert_allclose(steepness, 100 * extent[1] / np.sqrt(extent.prod()), rtol=1e-3)


def test_the_bias_for_a_filter_is_that_of_a_configuration():
    filters = [shadow.Nearest(), shadow.PercentageCloser(2.5), shadow.RandomDisk(3.0), shadow.Castano()]
    for filter in filters:
        found, text = shadow.bias_for(filter), "scene: {meshes: [{path: 'builtin:box'}]}\nfilter: "
        radius = f", radius: {float(filter.radius):g}" if hasattr(filter, "radius") else ""
        bias = parse_config(f"{text}{{type: {filter.settings.type}{radius}}}").bias
        of_module = (found.constant.value, found.slope.value, found.normal_offset.value)
        np.testing.assert_allclose(of_module, (bias.constant, bias.slope, bias.normal_offset), rtol=1e-6)
    nearest = rules.FILTER_RULES["nearest"].bias
    assert float(shadow.bias_for(shadow.Nearest()).constant.value) == pytest.approx(nearest.constant)
    # A caster with two texels across keeps its shadow.
    assert float(shadow.bias_for(shadow.Nearest(), across=2.0).constant.value) == pytest.approx(2 * rules.PART)
    assert float(shadow.bias_for(shadow.Nearest(), across=1e6).constant.value) == pytest.approx(nearest.constant)
    with pytest.raises(ValueError, match="across is -1; expected"):
        shadow.bias_for(shadow.Nearest(), across=-1.0)
    beside = shadow.bias_for(shadow.PercentageCloser(2.5), shadow.ReceiverPlane())
    expected = (rules.plane_constant_for(2.5), 0)
    np.testing.assert_allclose((beside.constant.value, beside.slope.value), expected, rtol=1e-6)
    assert isinstance(beside.plane, shadow.ReceiverPlane)
    for plane in (shadow.AdaptiveBias(), shadow.ReceiverPlane(deepening=1.0), shadow.ReceiverPlane(fudge=1.0)):
        assert float(shadow.bias_for(shadow.Bilinear(), plane).constant.value) == 0
    little = shadow.bias_for(shadow.VarianceShadowMap(2.0))
    expected = rules.FILTER_RULES["vsm, radius 2.5"].bias[:2]
    assert (float(little.constant.value), float(little.slope.value)) == pytest.approx(expected)
    with pytest.raises(ValueError, match="with a traced radius"):
        jax.jit(lambda radius: shadow.bias_for(shadow.RandomDisk(radius)).slope.value)(2.0)
