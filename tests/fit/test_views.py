"""Fits to several views: their loss, the stack that evaluates them, and the sample of their pixels."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import Programs, Waves, covered, floor_and_card, lamp, problem, shadows, sun, technique
from scipy.optimize import minimize_scalar

from diffshadow.fit import (
    Anneal,
    Loss,
    Parameter,
    Parameters,
    Search,
    Solver,
    Sureness,
    TechniqueProblem,
    fit,
)
from diffshadow.fit._judge import Judge
from diffshadow.fit.problems import Joint, squares
from diffshadow.fit.problems._stack import Stack, of_one_structure
from diffshadow.shadow import RandomDisk, draw_shadow_map, stratified
from diffshadow.shadow.kernels._padded_map import pad

BIAS = Parameter("bias.constant", 1.6, 0.0, 6.0)
RADIUS = Parameter("filter.radius", 2.0, 0.0, 8.0)
SOLVER = Solver("levenberg_marquardt", 60, 1e-4, 1e-7)
SHORT = Anneal(1.0, 0.2, 2)
LOSSES = {
    "mean": Loss(),
    "worst": Loss("worst").in_phase(0.5),
    "maximum": Loss("worst"),
    "cvar": Loss("cvar", fraction=0.35),
    "smooth cvar": Loss("cvar", fraction=0.35).in_phase(0.25),
}

# Of the pixels of two views; many tests share the programs of these samples.
SOME = 1600
FEW = Search(pixels=SOME)

# Five images of 20 pixels in all.
COUNTS = np.array([3, 7, 5, 2, 3])
SHARES = np.float32(COUNTS / 20)
ERRORS = np.array([0.04, 0.01, 0.09, 0.05, 0.02])


def disk(radius=2.0, bias=1.6, compare=None):
    return technique(RandomDisk(radius, stratified((2, 2))), bias, compare=compare)


def view(direction, radius=2.0, bias=1.6):
    """The card under another sun; its reference is what such a disk makes of it."""
    base = problem(disk())
    mesh = floor_and_card()
    shadow_map = draw_shadow_map(mesh, sun(mesh, direction), (64, 64))
    truth = shadows(disk(radius, bias), shadow_map, base.surface)
    return TechniqueProblem(
        base.technique, shadow_map, base.surface, truth, covered(base.technique, shadow_map, base.surface)
    )


@pytest.fixture(scope="module")
def views():
    """Two views of one structure that want other radii; of the second, a part of the pixels counts."""
    first, second = view((0.5, -1.0, -0.3), 2.4), view((-0.4, -1.0, 0.5), 4.5)
    part = np.asarray(second.mask) & (np.arange(64)[:, None] > 24)
    return [first, eqx.tree_at(lambda p: p.mask, second, jnp.asarray(part))]


@pytest.fixture(scope="module")
def small(views):
    """A view of the others' kind with a smaller image and a smaller map."""
    lower = lambda tree: jax.tree.map(lambda image: jnp.asarray(np.asarray(image)[:48]), tree)
    parts = lambda p: (p.surface, p.reference, p.mask, p.shadow_map.depth)
    *images, depth = parts(views[0])
    return eqx.tree_at(parts, views[0], (*map(lower, images), jnp.asarray(np.asarray(depth)[::2, ::2])))


def waves(first=0.7, second=0.4):
    return Waves(jnp.asarray(first, jnp.float32), jnp.asarray(second, jnp.float32))


def waving(view, first):
    """The view as waves see it; its reference is that of others."""
    parts = lambda p: (p.technique, p.reference)
    return eqx.tree_at(parts, view, (waves(), waves(first).visibility(None, view.surface)))


@pytest.fixture(scope="module")
def waved(views):
    """Both views as waves see them; the second has the greater error."""
    return [waving(views[0], 0.5), waving(views[1], 1.1)]


FIRST, SECOND = Parameter("first", 0.7, -2.0, 3.0), Parameter("second", 0.4, -2.0, 2.0)


def fitted(problems, *parameters, **settings):
    """A fit, of both numbers if none is given: so tests share their programs."""
    return fit(problems, parameters or [BIAS, RADIUS], solver=SOLVER, anneal=SHORT, **settings)


def closed_form(loss, errors):
    """The loss of errors (5,), from its definition and pixel by pixel, in double precision."""
    errors, shares = np.asarray(errors, np.float64), COUNTS / 20
    if loss.over == "mean":
        return float(shares @ errors)
    if loss.over == "worst" and loss.power is None:
        return float(errors.max())
    if loss.over == "worst":
        return float((shares @ errors ** float(loss.power)) ** (1 / float(loss.power)))
    if loss.power is not None:
        power, fraction = float(loss.power), float(loss.fraction)
        excess = lambda t: shares @ np.logaddexp(0, power * (errors / t - 1))
        smooth = lambda t: t * (1 + excess(t) / power / fraction)
        return float(minimize_scalar(smooth, bounds=(0.001, 1.0), options={"xatol": 1e-10}).fun)
    worst = np.sort(np.repeat(errors, COUNTS))[::-1]
    return float(worst[: round(float(loss.fraction) * 20)].mean())


@eqx.filter_jit
def weights_of_all(errors, shares):
    """Those of each loss, by one program."""
    return {name: loss.weights(errors, shares) for name, loss in LOSSES.items()}


@pytest.mark.parametrize("name", LOSSES)
def test_weights_are_the_gradient_of_the_loss_and_make_it_of_the_errors(name):
    loss, weights_at = LOSSES[name], lambda errors: np.asarray(weights_of_all(np.float32(errors), SHARES)[name])
    weights = weights_at(ERRORS)
    assert weights @ ERRORS == pytest.approx(closed_form(loss, ERRORS), rel=1e-5)
    steps = 1e-6 * np.eye(5)
    slopes = [(closed_form(loss, ERRORS + d) - closed_form(loss, ERRORS - d)) / 2e-6 for d in steps]
    np.testing.assert_allclose(weights, slopes, rtol=1e-3, atol=1e-6)
    # Homogeneous: larger errors have the same weights.
    np.testing.assert_allclose(weights_at(7 * ERRORS), weights, rtol=1e-4)


@pytest.mark.parametrize("name", ["worst", "smooth cvar"])
def test_change_of_the_weights_adds_half_the_second_derivative_of_smooth_losses(name):
    loss = LOSSES[name]
    gradients = np.random.default_rng(0).normal(size=(5, 2)) * ERRORS[:, None]
    step, one = 1e-4 * ERRORS.mean(), np.eye(5)
    at = lambda a, b: closed_form(loss, ERRORS + step * (a + b))
    hessian = np.array([[(at(a, b) - at(a, -b) - at(-a, b) + at(-a, -b)) / (4 * step**2) for a in one] for b in one])
    bends = np.asarray(eqx.filter_jit(loss.curvature_rows)(np.float32(ERRORS), SHARES, np.float32(gradients)))
    expected = gradients.T @ hessian @ gradients / 2
    np.testing.assert_allclose(bends.T @ bends, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_losses_that_are_not_smooth_bend_nothing():
    numbers = [jnp.asarray(each, jnp.float32) for each in (ERRORS, SHARES, np.zeros((5, 2)))]
    for name in ("mean", "maximum", "cvar"):
        assert LOSSES[name].curvature_rows(*numbers) is None


def test_views_without_an_error_or_a_pixel_make_no_trouble():
    for weights in weights_of_all(np.zeros(5, np.float32), SHARES).values():
        assert np.isfinite(weights).all()
    # A view without pixels has no weight, whatever stands in its place.
    errors, shares = np.float32([0.1, 0.2, 9.0, 0.1, 0.2]), np.float32([0.3, 0.3, 0.0, 0.2, 0.2])
    for weights in map(np.asarray, weights_of_all(errors, shares).values()):
        assert weights[2] == 0
        assert weights.sum() == pytest.approx(1, abs=0.6)


def test_power_grows_from_phase_to_phase_unless_the_loss_is_the_mean():
    for over in ("worst", "cvar"):
        assert [float(Loss(over).in_phase(part).power) for part in (0.0, 0.5, 1.0)] == pytest.approx([4, 16, 64])
        assert Loss(over).in_phase(0.3).exact().power is None
    assert Loss("mean").in_phase(0.5).power is None


def test_differences_are_weighted_by_their_sign():
    difference = np.float32([-0.5, 0.0, 0.5])
    twice = jax.jit(lambda x: (signed(x), jax.vmap(jax.grad(lambda x: signed(x) ** 2))(x)))
    signed = Loss(false_shadow=4.0, false_light=9.0).signed
    values, slope = twice(difference)
    np.testing.assert_allclose(values, [-1.0, 0.0, 1.5], rtol=1e-6)
    np.testing.assert_allclose(slope, [2 * 4 * -0.5, 0, 2 * 9 * 0.5], rtol=1e-6)
    # A factor of 0 leaves no gradient that is not a number.
    assert np.isfinite(jax.jit(jax.vmap(jax.grad(Loss(false_shadow=0.0).signed)))(difference)).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"fraction": 0.0}, "fraction is 0.0; expected a number greater than 0 and at most 1"),
        ({"false_light": 0.0, "false_shadow": 0.0}, "one of them greater than 0"),
        ({"false_light": float("nan")}, "false_light is nan"),
    ],
)
def test_impossible_losses_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Loss(**settings)


def test_a_stack_has_the_images_errors_and_shares_of_its_problems(views):
    mapping = disk(3.0, 0.8)
    apart, together = (
        Joint.of(views, Loss("worst", false_light=2.0)),
        Joint.of(views, Loss("worst", false_light=2.0)).stacked(),
    )
    assert [type(each) for each in together.problems] == [Stack]
    (images, _), ((stack,), _) = apart.differences(mapping), together.differences(mapping)
    for one, other in zip(images, np.asarray(stack), strict=True):
        np.testing.assert_allclose(np.asarray(one)[0], other, atol=1e-6)
    np.testing.assert_allclose(apart.shares, together.shares, rtol=1e-6)
    np.testing.assert_allclose(squares(images), squares((stack,)), rtol=1e-5)
    assert [float(x) for x in apart.losses(mapping)[:2]] == pytest.approx(
        [float(x) for x in together.losses(mapping)[:2]]
    )


def test_maps_of_a_stack_are_in_one_atlas(views):
    atlases, problems = {}, [views[1], *views]
    stack = Joint.of(problems).stacked(atlases).problems[0]
    assert stack.numbers.tolist() == [0, 1, 0]
    assert Joint.of(problems).stacked(atlases).problems[0].atlas is stack.atlas
    # A square of texels that is wider than the atlas' margins allow.
    for view, number in zip(views, (1, 0), strict=True):
        reading = stack.atlas.reading(view.shadow_map, jnp.asarray(number))
        assert (pad(reading, 2).margin, pad(reading, 40).margin) == (16, 40)
        np.testing.assert_array_equal(pad(reading, 40).depth, pad(view.shadow_map, 40).depth)


def test_problems_of_several_structures_are_a_stack_and_problems(views, waved, small):
    lower, mapping = waving(small, 1.1), waves(0.9)
    # Large images come first.
    joint = Joint.of([lower, *waved]).stacked()
    assert [type(each) for each in joint.problems] == [Stack, TechniqueProblem]
    pixels = np.array([float(each.mask.sum()) for each in (*waved, lower)])
    np.testing.assert_allclose(joint.shares, pixels / pixels.sum(), rtol=1e-6)
    errors = [float(each.mean_square_error(mapping)) for each in (*waved, lower)]
    np.testing.assert_allclose(squares(joint.differences(mapping)[0]), errors, rtol=1e-5)
    assert float(joint.mean_square_error(mapping)) == pytest.approx(np.average(errors, weights=pixels), rel=1e-5)
    # Lights of another kind are a structure of their own.
    spot = eqx.tree_at(lambda p: p.shadow_map.light, views[0], lamp(floor_and_card()))
    groups = of_one_structure([spot, *views, spot])
    assert [[id(each) for each in group] for group in groups] == [[id(spot)] * 2, [id(each) for each in views]]


def test_a_judge_finds_the_same_of_all_images_by_one_program(waved, small, monkeypatch):
    first, second = waved
    # The third has the first's surface, and the second has another one.
    second = eqx.tree_at(lambda p: p.surface.position, second, 1.1 * second.surface.position)
    third = dataclasses.replace(first, reference=second.reference)
    joint = Joint.of([waving(small, 1.1), first, second, third], Loss("worst", false_light=2.0))
    values, found = jnp.asarray([0.9, 0.3]), []
    # Image by image; then by one program, with the maps in an atlas, and without one.
    for many, texels in ((64, 1 << 31), (4, 1 << 31), (4, 0)):
        monkeypatch.setattr("diffshadow.fit._judge._MANY", many)
        monkeypatch.setattr("diffshadow.fit.problems._stack._MAX_TEXELS", texels)
        judge = Judge(joint, Parameters.of([FIRST, SECOND]))
        losses = judge.losses(values, judge.loss)
        found.append([*losses.errors.tolist(), float(losses.compared), float(losses.whole), *judge.sides(values)])
        stack = judge._stacked().joint.problems[0]
        assert (stack.atlas is None) == (texels == 0)
        assert stack.sights.tolist() == [0, 1, 0]
    # 54 bytes for each pixel of three surfaces, and 5 for each of four images.
    assert judge._copied == 54 * (2 * 64 + 48) * 64 + 5 * (3 * 64 + 48) * 64
    assert len(set(np.round(found[0][:4], 5))) == 4
    assert found[1] == pytest.approx(found[0], rel=1e-5)
    assert found[2] == pytest.approx(found[0], rel=1e-5)


def twice(view):
    """The view and itself, with a map of its own, so that the atlas is as large as that of other tests."""
    return [view, eqx.tree_at(lambda p: p.shadow_map, view, jax.tree.map(jnp.array, view.shadow_map))]


mean_square_error = eqx.filter_jit(lambda view, subject: view.mean_square_error(subject))


def check_the_worst(views, parameter, made, values):
    """That a fit of `parameter` by the worst view is better by that than the best of `values` by the mean, and as good
    as any of them, where `made` makes the technique of a value."""
    worst = fitted(views, parameter, loss=Loss("worst"))
    root_errors = lambda technique: [float(mean_square_error(view, technique)) ** 0.5 for view in views]
    of_worst, errors = root_errors(worst.technique), np.array([root_errors(made(value)) for value in values.tolist()])
    of_mean = errors[np.argmin(errors**2 @ [float(view.count) for view in views])]
    assert max(of_worst) < 0.97 * max(of_mean)
    assert max(of_worst) < 1.02 * errors.max(axis=1).min()
    # The judge has the maximum itself.
    assert worst.phases[worst.chosen].hard_loss == pytest.approx(max(of_worst) ** 2, rel=1e-4)


@pytest.mark.exhaustive
def test_worst_view_is_better_by_its_own_loss(waved):
    check_the_worst(waved, FIRST, waves, np.linspace(0.5, 1.1, 61))


@pytest.mark.exhaustive
def test_factors_of_signs_move_the_bias_to_their_side(views):
    wanting = lambda view, bias: eqx.tree_at(
        lambda p: p.reference, view, shadows(disk(2.0, bias), view.shadow_map, view.surface)
    )
    views = [wanting(views[0], 0.4), wanting(views[1], 2.5)]
    bias = lambda **factors: fitted(views, search=FEW, loss=Loss(**factors)).fitted["bias.constant"]
    # A larger bias leaves fewer pixels too dark, and more too light.
    assert bias(false_light=20.0) + 0.05 < bias() < bias(false_shadow=20.0) - 0.05


@pytest.mark.exhaustive
def test_a_sample_stands_for_the_whole(views):
    whole, mapping = views[1], disk(3.0, 0.8)
    count = int(whole.mask.sum())
    samples = [whole.sampled(1024, seed) for seed in range(40)]
    assert {each.reference.shape for each in samples} == {(16, 64)}
    assert [float(each.count) for each in samples] == pytest.approx([count] * 40, rel=1e-6)
    errors = np.array([float(each.mean_square_error(mapping)) for each in samples])
    expected = float(whole.mean_square_error(mapping))
    assert errors.std() > 0.01 * expected
    assert errors.mean() == pytest.approx(expected, abs=4 * errors.std() / len(errors) ** 0.5)


@pytest.mark.exhaustive
def test_pixels_of_a_sample_keep_their_taps(views):
    whole, mapping = views[1], disk(3.0, 0.8)
    sample, mask = whole.sampled(1024, 0), np.asarray(whole.mask)
    taken = np.asarray(sample.mask)
    assert taken.sum() > 200
    # No two pixels see the same place.
    places = np.asarray(whole.surface.position)[mask]
    found = np.abs(np.asarray(sample.surface.position)[taken][:, None] - places).sum(axis=-1).argmin(axis=1)
    assert len(set(found)) == len(found)
    expected = np.asarray(whole.difference(mapping))[mask][found]
    own = np.asarray(sample.difference(mapping) / jnp.sqrt(sample.weight))[taken]
    np.testing.assert_allclose(own, expected, atol=1e-6)


def test_a_sample_of_more_than_count_is_all_of_them(views):
    few = np.zeros((64, 64), bool)
    few[30:37, 20:47] = np.asarray(views[0].mask)[30:37, 20:47]
    whole, mapping = eqx.tree_at(lambda p: p.mask, views[0], jnp.asarray(few)), disk(3.0, 0.8)
    sample = whole.sampled(1024, 0)
    assert (np.asarray(sample.weight)[np.asarray(sample.mask)] == 1).all()
    assert int(sample.mask.sum()) == float(sample.count) == few.sum()
    error = float(whole.mean_square_error(mapping))
    assert float(sample.mean_square_error(mapping)) == pytest.approx(error, rel=1e-5)
    none = eqx.tree_at(lambda p: p.mask, views[0], jnp.zeros((64, 64), bool)).sampled(1024, 0)
    assert float(none.count) == 0
    assert float(none.mean_square_error(mapping)) == 0


@pytest.fixture
def programs(monkeypatch):
    stand_in = Programs(0.3)
    monkeypatch.setattr("diffshadow.fit._run.compiled", stand_in)
    return stand_in


def test_views_are_sampled_only_where_more_pixels_count(views, programs, monkeypatch):
    joint, pixels = Joint.of(views), sum(int(each.mask.sum()) for each in views)
    assert joint.count == pixels
    counts, of_joint = [], Joint.sampled
    sample = lambda joint, count, *more: counts.append(count) or of_joint(joint, count, *more)
    monkeypatch.setattr(Joint, "sampled", sample)
    for most in (pixels, pixels - 1):
        fitted(views, search=Search(pixels=most))
    # One sample serves all phases.
    assert counts == [pixels - 1]
    assert len(programs.made) == 2
    monkeypatch.undo()
    assert Joint.of(views[0]).sampled(300).problems[0].reference.shape == (16, 16)
    sampled = joint.sampled(640)
    assert [each.reference.shape for each in sampled.problems] == [(16, 16)] * 2
    # Views keep their shares.
    np.testing.assert_allclose(sampled.shares, joint.shares, rtol=1e-5)


@pytest.mark.exhaustive
@pytest.mark.parametrize("over", ["worst", "cvar"])
def test_samples_for_the_worst_views_have_the_errors_of_whole_images(over, waved, programs, monkeypatch):
    check_samples_for_the_worst(over, waved, [FIRST, SECOND], monkeypatch)


def check_samples_for_the_worst(over, views, parameters, monkeypatch):
    starts, corrected = [], Joint.corrected
    monkeypatch.setattr(Joint, "corrected", lambda *a: starts.append((*a, corrected(*a))) or starts[-1][-1])
    fitted(views, *parameters, search=FEW, loss=Loss(over, fraction=0.5, false_light=3.0), sureness=Sureness(front=3))
    assert len(starts) >= 4  # two phases, and other points of the front
    assert len({float(sample.loss.false_light) for sample, *_ in starts}) > 1
    hard_errors = lambda joint: np.asarray(joint.hard().losses(joint.hard().subject).errors)
    for sample, errors, *_, made in starts:
        assert np.argmax([each.reference.size for each in sample.problems]) == np.argmax(errors)
        whole = Joint(sample.subject, tuple(views), sample.loss)
        np.testing.assert_allclose(errors, hard_errors(whole), rtol=1e-4)
        np.testing.assert_allclose(hard_errors(made), errors, rtol=1e-4)
        assert abs(hard_errors(sample) / errors - 1).max() > 0.01


def test_the_worst_views_have_three_quarters_of_the_pixels(views):
    joint, taken = Joint.of([*views, *views]), {}
    sizes = lambda count, worst: [p.reference.size for p in joint.sampled(count, worst, taken).problems]
    # A sample has 1, 4 or a multiple of 8 pixels of each place in a tile.
    assert sizes(8192, [2]) == [1024, 1024, 6144, 1024]
    assert len(taken) == 3  # views 0 and 2 are one, and so are 1 and 3
    assert sizes(8192, [2, 1]) == [1024, 2048, 2048, 1024]
    assert sizes(8192, []) == sizes(8192, range(4)) == [2048] * 4
    assert joint.sampled(8192, [2], taken).problems[2] is joint.sampled(8192, [2], taken).problems[2]


def test_the_worst_views_may_have_maps_of_any_size(waved, small, programs, monkeypatch):
    """Samples of other sizes are other programs."""
    of_joint, calls = Joint.sampled, []

    def in_turns(joint, count, worst, samples):
        calls.append(worst)
        return of_joint(joint, count, [len(calls) % 2], samples)

    monkeypatch.setattr(Joint, "sampled", in_turns)
    monkeypatch.setattr(Joint, "corrected", lambda sample, *_: sample)
    found = fitted([waved[0], waving(small, 1.1)], FIRST, SECOND, search=FEW, loss=Loss("worst"))
    assert len(calls) == len(found.phases) == len(programs.made) == 2
    assert programs.made[0] != programs.made[1]
    assert found.phases[1].values > found.phases[0].values


def test_a_sample_without_errors_is_corrected_no_more_than_fourfold(waved):
    sampled = Joint.of(waved).sampled(SOME, [1])
    errors = np.asarray(sampled.hard().losses(sampled.hard().subject).errors)
    corrected = sampled.corrected(jnp.asarray(errors * [1e-3, 1e3]))
    assert [float(problem.factor) for problem in corrected.problems] == [0.25, 4.0]
