"""Fits: that they find what is known, keep bounds, never end worse, report truly, compile once, and refuse nonsense."""

import dataclasses
import functools
import gc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import compiled_programs, floor_and_card, problem, side_camera, sun, technique

from diffshadow.fit import (
    Anneal,
    Parameter,
    Parameters,
    Search,
    Solver,
    TechniqueProblem,
    fit,
    parameter_names,
    resolve,
    with_parameters,
    with_values,
)
from diffshadow.fit._history import Reporter
from diffshadow.fit.problems import Joint
from diffshadow.fit.solvers import Stop, optimistix_solver
from diffshadow.geometry import Scene
from diffshadow.reference import trace_visibility
from diffshadow.shadow import (
    Bias,
    FourTap,
    HardCompare,
    MapSettings,
    Nearest,
    PercentageCloser,
    RandomDisk,
    ShadowMapping,
    SlopeBias,
    SoftCompare,
    stratified,
)

SOLVERS = ("levenberg_marquardt", "dogleg", "bfgs", "lbfgs")
EACH_SOLVER = [
    "levenberg_marquardt",
    *(pytest.param(s, marks=pytest.mark.exhaustive) for s in ("dogleg", "bfgs", "lbfgs")),
]
SHORT = Anneal(start=1.0, end=0.1, phases=3)
BIAS = Parameter("bias.constant", 1.6, 0.0, 6.0)
RADIUS = Parameter("filter.radius", 2.0, 0.0, 8.0)


def disk(radius=2.0, bias=1.6, compare=None):
    return technique(RandomDisk(radius, stratified((2, 2))), bias, compare=compare)


def patient(name):
    """A solver that goes on as far as single precision takes it; one program serves many tests."""
    return Solver(name, 60, 1e-4, 1e-7)


@pytest.fixture(scope="module")
def known():
    """Its reference is what a bias of 0.8 texels, which leaves some acne, and a radius of 3.2 texels make of it."""
    return problem(disk(), target=disk(3.2, 0.8))


@pytest.fixture(scope="module")
def results(known):
    """The fit of a solver, and what it told step by step."""

    @functools.cache
    def found(solver):
        told = []
        return fit(known, [BIAS, RADIUS], solver=patient(solver), anneal=SHORT, on_step=told.append), told

    return found


@pytest.mark.parametrize("solver", EACH_SOLVER)
def test_fit_recovers_known_values(solver, known, results):
    result, _ = results(solver)
    assert result.fitted["filter.radius"] == pytest.approx(3.2, abs=0.15)
    # The reference's acne has hard edges, which a soft compare cannot follow to the end; minimisers stop earlier.
    slack = 0.15 if solver in ("levenberg_marquardt", "dogleg") else 0.5
    assert result.fitted["bias.constant"] == pytest.approx(0.8, abs=slack)
    before, after = (float(known.mean_square_error(t)) for t in (disk(), result.technique))
    assert after < 0.1 * before
    assert (result.flat, result.arrangement) == ([], None)


def test_what_on_step_raises_ends_the_fit_and_the_next_one_is_the_same(known, results, capfd):
    class StopError(Exception):
        pass

    def stop(step):
        if step.step == 3:
            raise StopError("enough")

    result, _ = results("levenberg_marquardt")
    how = {"solver": patient("levenberg_marquardt"), "anneal": SHORT}
    with pytest.raises(StopError, match="enough"):
        fit(known, [BIAS, RADIUS], **how, on_step=stop)
    # Nothing of JAX's own report of it.
    assert capfd.readouterr().err == ""
    said = []
    again = fit(
        known, [BIAS, RADIUS], **how, progress=lambda text, done: said.append((text.partition(", RMSE")[0], done))
    )
    assert again.fitted == result.fitted
    of_three = lambda step: (f"phase {step.phase + 1} of 3, step {step.step}", step.phase / 3)
    assert said == [of_three(step) for step in again.history]


@pytest.mark.parametrize("solver", EACH_SOLVER)
def test_history_is_in_order_and_true(solver, known, results):
    result, told = results(solver)
    assert told == result.history
    assert sorted(told, key=lambda step: (step.phase, step.step)) == told
    by_phase = [[s for s in told if s.phase == phase] for phase in range(3)]
    for phase, steps in enumerate(by_phase):
        assert [s.step for s in steps] == list(range(len(steps)))
        assert {s.width for s in steps} == {SHORT.widths[phase]}
    # Values are those of the parameters, and losses those that they have.
    assert told[0].values == pytest.approx((1.6, 2.0), abs=1e-5)
    for step in (told[0], by_phase[1][-1], told[-1]):
        mapping = disk(step.values[1], step.values[0], SoftCompare(step.width))
        assert step.loss == pytest.approx(float(known.mean_square_error(mapping)), rel=2e-3, abs=1e-7)
    assert result.steps == sum(phase.steps for phase in result.phases)


@pytest.mark.exhaustive
def test_values_that_are_counted_from_an_offset_are_reported_with_it(known):
    seen, far = [], 3.0 * 2**20
    counted = dataclasses.replace(BIAS, initial=far + 1.6, lower=far, upper=far + 6.0, offset=far)
    how = {"solver": patient(SOLVERS[0]), "anneal": SHORT, "search": Search(starts=2)}
    near, result = fit(known, [BIAS, RADIUS], **how), fit(known, [counted, RADIUS], **how, on_step=seen.append)
    # Their own numbers have the digits of single precision, far from 0 too.
    plus = lambda values: (values[0] + far, values[1])
    assert tuple(result.fitted.values()) == plus(tuple(near.fitted.values()))
    assert tuple(result.initial.values()) == plus(tuple(near.initial.values()))
    assert tuple(result.best.values()) == plus(tuple(near.best.values()))
    assert [phase.values for phase in result.phases] == [plus(phase.values) for phase in near.phases]
    assert [step.values for step in result.history] == [plus(step.values) for step in near.history]
    assert seen == result.history
    assert [start.end for start in result.starts] == [plus(start.end) for start in near.starts]
    assert [start.initial for start in result.starts] == [plus(start.initial) for start in near.starts]
    assert float(result.technique.bias.constant.value) == float(near.technique.bias.constant.value)
    assert (result.parameters, result.search.starts) == ((counted, RADIUS), 2)
    put = with_parameters(disk(), [counted, RADIUS], list(result.fitted.values()))
    assert float(put.bias.constant.value) == float(result.technique.bias.constant.value)


def test_a_trial_at_no_place_is_no_step():
    """Dogleg makes such trials on a bound, and goes on from where it was."""
    history = []
    reporter = Reporter(Parameters.of([BIAS]), history, None)
    reporter.begin(0, 1.0, np.zeros(1), np.array([0]))
    for y in (0.0, np.nan, np.pi / 2):
        reporter.add(0.25, np.array([y]))
    assert [(step.step, step.values) for step in history] == [(0, (3.0,)), (1, (6.0,))]


def test_the_history_has_the_loss_itself_where_the_solver_sees_scaled_residuals():
    history = []
    reporter = Reporter(Parameters.of([BIAS]), history, None)
    reporter.begin(0, 1.0, np.zeros(1), np.array([0]), scale=4.0)
    reporter.add(0.32, np.zeros(1))
    assert history[0].loss == pytest.approx(0.02)


@functools.cache
def loss_and_slopes():
    """The soft loss of values, and its derivatives; one program for all widths."""

    def loss(values, known, width):
        at = with_values(disk(compare=SoftCompare(width)), ("bias.constant", "filter.radius"), values)
        return known.mean_square_error(at)

    return eqx.filter_jit(jax.jacfwd(loss))


def slope_at(phase, known):
    """The norm of the derivatives of the loss at a phase's end by the parts of the bounds' distances."""
    spans = np.array([BIAS.upper - BIAS.lower, RADIUS.upper - RADIUS.lower])
    return np.linalg.norm(loss_and_slopes()(jnp.asarray(phase.values), known, jnp.asarray(phase.width)) * spans)


@pytest.mark.parametrize("solver", EACH_SOLVER)
def test_phases_and_choice_are_reported_truly(solver, known, results):
    result, _ = results(solver)
    assert [phase.width for phase in result.phases] == SHORT.widths
    losses = [phase.hard_loss for phase in result.phases]
    for phase in result.phases:
        at = with_values(disk(), ("bias.constant", "filter.radius"), jnp.array(phase.values))
        assert phase.hard_loss == pytest.approx(float(known.mean_square_error(at)), rel=1e-3)
        assert phase.gradient_norm == pytest.approx(slope_at(phase, known), rel=0.01, abs=1e-8)
        assert phase.result in ("successful", "max_steps reached")
    assert result.chosen == int(np.argmin(losses))
    start = float(known.mean_square_error(disk()))
    assert result.errors == pytest.approx((start**0.5, min(losses) ** 0.5), rel=1e-3)
    assert tuple(result.fitted.values()) == result.phases[result.chosen].values
    assert isinstance(result.technique.compare, HardCompare)
    assert float(resolve(result.technique, "filter.radius")) == pytest.approx(result.fitted["filter.radius"])
    assert result.initial == {"bias.constant": pytest.approx(1.6), "filter.radius": 2.0}


def test_a_start_that_is_best_is_kept(known):
    perfect = eqx.tree_at(lambda p: p.reference, known, known.technique.visibility(known.shadow_map, known.surface))
    result = fit(perfect, [BIAS, RADIUS], solver=patient("levenberg_marquardt"), anneal=SHORT)
    assert result.chosen == -1
    assert result.fitted == result.initial


@pytest.mark.parametrize("solver", ["levenberg_marquardt", pytest.param("lbfgs", marks=pytest.mark.exhaustive)])
def test_bounds_hold_and_a_start_on_a_bound_moves(solver, known):
    narrow = [Parameter("bias.constant", 1.6, 1.2, 6.0), Parameter("filter.radius", 0.0, 0.0, 8.0)]
    result = fit(known, narrow, solver=patient(solver), anneal=SHORT)
    values = np.array([step.values for step in result.history])
    assert (values >= np.array([1.2, 0.0]) - 1e-6).all()
    assert (values <= np.array([6.0, 8.0]) + 1e-6).all()
    assert result.fitted["filter.radius"] > 1
    assert result.fitted["bias.constant"] < 1.6


def narrowest():
    """A disk whose taps all lie in its middle, whatever its radius."""
    return eqx.tree_at(lambda t: t.filter.pattern.offsets, disk(), np.zeros_like(disk().filter.pattern.offsets))


def nearest():
    """A disk whose visibility changes by steps as its radius changes."""
    return technique(RandomDisk(2.0, stratified((2, 2)), "nearest"), 1.6)


@pytest.mark.parametrize("subject", [narrowest, pytest.param(nearest, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("solver", EACH_SOLVER)
def test_a_parameter_without_gradient_is_named(solver, subject, known):
    flat = eqx.tree_at(lambda p: p.technique, known, subject())
    result = fit(flat, [BIAS, RADIUS], solver=patient(solver), anneal=SHORT)
    assert result.flat == ["filter.radius"]
    assert result.fitted["filter.radius"] == pytest.approx(2.0, abs=1e-5)
    assert result.phases[result.chosen].hard_loss < float(flat.mean_square_error(subject()))
    assert result.fitted["bias.constant"] < 1.5


def test_a_second_fit_of_the_same_shapes_compiles_nothing(known, results):
    results("levenberg_marquardt")
    moved = eqx.tree_at(lambda p: p.reference, known, known.reference * 0.9)
    with compiled_programs() as compiled:
        jax.jit(lambda x: x + 1.2345)(jnp.ones(3))
        assert compiled, "the counter must see compilations"
        compiled.clear()
        # Other values, bounds, widths and tolerances' defaults: the same program.
        parameters = [Parameter("bias.constant", 1.0, 0.0, 5.0), Parameter("filter.radius", 1.0, 0.0, 9.0)]
        fit(moved, parameters, solver=patient("levenberg_marquardt"), anneal=Anneal(2.0, 0.2, 5))
    assert compiled == []


def test_a_fit_leaves_no_arrays_that_only_the_collector_frees(known, results):
    results("levenberg_marquardt")

    def left() -> int:
        fit(known, [BIAS, RADIUS], solver=patient("levenberg_marquardt"), anneal=SHORT)
        return len(jax.live_arrays())

    gc.disable()
    try:
        assert left() == left()
    finally:
        gc.enable()


def test_a_parameter_may_lie_elsewhere_than_its_name_says(known):
    bias = Parameter("bias", 1.6, 0.0, 6.0, path="bias.constant.value")
    assert (bias.where, BIAS.where) == ("bias.constant.value", "bias.constant")
    named = fit(known, [bias, RADIUS], solver=patient("levenberg_marquardt"), anneal=SHORT)
    plain = fit(known, [BIAS, RADIUS], solver=patient("levenberg_marquardt"), anneal=SHORT)
    assert named.fitted == {"bias": plain.fitted["bias.constant"], "filter.radius": plain.fitted["filter.radius"]}


def test_bounded_slope_bias_is_fitted_by_its_paths(known):
    slope = SlopeBias(0.5, least=0.1, most=3.0)
    mapping = ShadowMapping(RandomDisk(2.0, stratified((2, 2))), Bias(0.5, slope))
    assert parameter_names(mapping)[:4] == ["filter.radius", "bias.constant", "bias.slope.value", "bias.slope.least"]
    moved = with_values(mapping, ("bias.slope.most",), jnp.array([2.0]))
    assert float(moved.bias.slope.most) == 2
    with pytest.raises(ValueError, match=r"'bias.slope' names 3 numbers; expected one"):
        resolve(mapping, "bias.slope")


@pytest.fixture(scope="module")
def two_lights():
    """The same technique under two lights, which want other radii: 2.4 and 4 texels."""
    return [problem(disk(), light, target=disk(radius, 0.8)) for light, radius in (("directional", 2.4), ("spot", 4.0))]


@pytest.mark.exhaustive
def test_several_lights_are_fitted_together(two_lights):
    radius = lambda problems: fit(problems, [RADIUS], solver=patient("levenberg_marquardt"), anneal=Anneal(1.0, 0.2, 2))
    first, second, both = (radius(p) for p in (two_lights[0], two_lights[1], two_lights))
    assert first.fitted["filter.radius"] + 0.2 < both.fitted["filter.radius"] < second.fitted["filter.radius"] - 0.2
    joint = Joint.of(two_lights)
    pixels = [int(p.mask.sum()) for p in two_lights]
    errors = [float(p.mean_square_error(both.technique)) for p in two_lights]
    # Every pixel that counts weighs the same, under whichever light.
    assert float(joint.mean_square_error(both.technique)) == pytest.approx(np.average(errors, weights=pixels), rel=1e-5)
    assert min(float(joint.mean_square_error(r.technique)) for r in (first, second)) > float(
        joint.mean_square_error(both.technique)
    )


def test_a_problem_of_a_scene_is_the_one_of_its_parts():
    mesh = floor_and_card()
    scene = Scene(mesh, side_camera((64, 64)), sun(mesh))
    truth = trace_visibility(scene, samples=1)
    mapping = dataclasses.replace(disk(), map=MapSettings((64, 64)))
    one = TechniqueProblem.of(scene, mapping, truth)
    expected = problem(mapping)
    np.testing.assert_array_equal(one.shadow_map.depth, expected.shadow_map.depth)
    np.testing.assert_array_equal(one.surface.face, expected.surface.face)
    np.testing.assert_array_equal(one.mask, np.asarray(expected.mask) & truth.mask)
    np.testing.assert_array_equal(one.reference, truth.visibility)


def test_parameters_put_what_they_take():
    mapping = disk(2.5, 0.3)
    parameters = Parameters.of([BIAS, RADIUS])
    assert parameters.take(mapping).tolist() == pytest.approx([0.3, 2.5])
    moved = parameters.put(mapping, jnp.array([0.7, 1.5]))
    assert parameters.take(moved).tolist() == pytest.approx([0.7, 1.5])
    radius = parameters[(1,)]
    assert radius.take(moved).tolist() == [1.5]
    assert (float(radius.lower[0]), float(radius.upper[0])) == (RADIUS.lower, RADIUS.upper)


def test_no_problem_is_no_fit():
    with pytest.raises(ValueError, match="got no problem to fit; expected one, or one for each light"):
        fit([], [RADIUS])


def test_widths_shrink_geometrically_and_a_single_phase_has_the_last():
    assert Anneal(2.0, 0.125, 3).widths == pytest.approx([2.0, 0.5, 0.125])
    assert Anneal(2.0, 0.05, 1).widths == [0.05]


def test_names_and_values():
    mapping = technique(PercentageCloser(2.0, 5.0), 0.5, compare=SoftCompare(0.7))
    assert parameter_names(mapping) == [
        *("filter.radius", "bias.constant", "bias.slope", "bias.normal_offset", "compare.width")
    ]
    assert float(resolve(mapping, "bias.constant")) == float(resolve(mapping, "bias.constant.value")) == 0.5
    moved = with_values(mapping, ("filter.radius", "bias.slope"), jnp.array([1.5, 2.5]))
    assert float(moved.filter.radius) == 1.5
    assert float(moved.bias.slope.value) == 2.5
    assert float(moved.bias.constant.value) == 0.5


@pytest.mark.parametrize("value", [0.02, 0.3, 0.5, 0.98])
def test_bounded_and_free_values_are_each_others_inverse(value):
    bounds = Parameters.of([Parameter("a", 1.0, -1.0, 4.0), Parameter("b", 1.0, 0.0, 1e3)])
    x = bounds.lower + value * (bounds.upper - bounds.lower)
    np.testing.assert_allclose(bounds.to_bounded(bounds.to_free(x)), x, rtol=1e-5)
    # As single-precision numbers, the sum of 0.65 and 2.05 is more than 2.7.
    assert float(Parameters.of([Parameter("a", 1.0, 0.65, 2.7)]).at(jnp.ones(1))[0]) == np.float32(2.7)
    edge = bounds.to_bounded(bounds.to_free(bounds.lower))
    np.testing.assert_allclose(edge, bounds.lower + 0.01 * (bounds.upper - bounds.lower), rtol=1e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 2.0, 2.0), "the bounds of r are 2.0 and 2.0; expected finite numbers, lower < upper"),
        ((1.0, 3.0, 2.0), "the bounds of r are 3.0 and 2.0"),
        ((1.0, 0.0, float("inf")), "the bounds of r are 0.0 and inf"),
        ((float("nan"), 0.0, 1.0), "r starts at nan; expected a value within its bounds, 0.0 to 1.0"),
        ((2.0, 0.0, 1.0), "r starts at 2.0; expected .*: change initial, or widen the bounds"),
    ],
)
def test_impossible_parameters_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Parameter("r", *arguments)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "bias.konstant",
            r"no parameter 'bias.konstant' in a ShadowMapping; expected one of filter.radius, bias.constant",
        ),
        ("", r"no parameter '' in a ShadowMapping"),
        ("bias", r"'bias' names 3 numbers; expected one: filter.radius"),
        (
            "filter.pattern.offsets",
            r"'filter.pattern.offsets' names no single number that could be fitted; expected one of filter.radius",
        ),
        ("filter.lookup", r"'filter.lookup' names no single number that could be fitted"),
    ],
)
def test_names_of_nothing_are_refused(name, message, known):
    with pytest.raises(ValueError, match=message):
        resolve(known.technique, name)
    with pytest.raises(ValueError, match=message):
        fit(known, [Parameter(name, 0.5, 0.0, 1.0)])


def test_impossible_fits_are_refused(known):
    refuses = lambda match: pytest.raises(ValueError, match=match)
    with refuses("got no parameters to fit; expected at least one, such as bias.constant"):
        fit(known, [])
    for twice in ("bias.constant", "bias.constant.value"):
        with refuses(f"a parameter is named twice in bias.constant, {twice}; expected each once"):
            fit(known, [BIAS, Parameter(twice, 0.5, 0.0, 1.0)])
    with refuses("no pixel sees a surface within the light's frustum.*: move one of them"):
        fit(eqx.tree_at(lambda p: p.mask, known, jnp.zeros_like(known.mask)), [BIAS])
    with refuses("the visibility or the reference is not finite at the initial values"):
        fit(
            eqx.tree_at(lambda p: p.reference, known, known.reference * jnp.nan), [BIAS, RADIUS], solver=patient("bfgs")
        )
    with refuses("there is no parameter 'filter.radius'"):
        fit(eqx.tree_at(lambda p: p.technique, known, technique(Nearest())), [RADIUS])
    soft = eqx.tree_at(lambda p: p.technique, known, disk(compare=SoftCompare(1.0)))
    with refuses("compare.width cannot be fitted, because the fit itself anneals the compare; leave it out"):
        fit(soft, [Parameter("compare.width", 1.0, 0.1, 2.0)])


@pytest.mark.parametrize(
    ("kernel", "lower", "upper", "message"),
    [
        (
            PercentageCloser(2.0),
            0.0,
            8.0,
            "bounds go further than the technique allows: .*radius is 8.0 and max_radius is 2.0; expected",
        ),
        (RandomDisk(2.0), -1.0, 8.0, "radius is -1.0; expected a number at least 0 .*; narrow the bounds"),
        (FourTap(2.0), -1.0, 8.0, "radius is -1.0; expected a number at least 0 .*; narrow the bounds"),
    ],
    ids=["pcf", "disk", "four"],
)
def test_bounds_that_the_filter_does_not_allow_are_refused(kernel, lower, upper, message, known):
    with pytest.raises(ValueError, match=message):
        fit(
            eqx.tree_at(lambda p: p.technique, known, technique(kernel)),
            [Parameter("filter.radius", 2.0, lower, upper)],
        )


def test_bounds_that_the_bias_does_not_allow_are_refused(known):
    with pytest.raises(ValueError, match=r"bounds go further than the technique allows: .*value is -1\.0; expected"):
        fit(known, [Parameter("bias.constant", -0.5, -1.0, -0.2)])


@pytest.mark.parametrize("name", [*SOLVERS, "adam"])
def test_each_number_of_a_solver_is_where_it_belongs(name):
    solver, stop = Solver(name, 7, rtol=3e-3, atol=5e-7, learning_rate=0.02, noise=0.1), Stop(0.3, 0.4)
    made = optimistix_solver(solver, print, stop)
    assert (made.rtol, made.atol) == (3e-3, 5e-7)
    if name == "levenberg_marquardt":
        assert (made.noise, made.search.noise, made.stop) == (0.1, 0.1, stop)
    if name == "adam":
        assert made.descent.steps == 7
        np.testing.assert_allclose(made.search.learning_rate, 0.02)
