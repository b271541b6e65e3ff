"""Losses and solvers of users: that they find what is known, are judged and reported truly, and mistakes are named."""

import contextlib
import dataclasses
import json
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scenes import compiled_programs, problem, technique

from diffshadow import study
from diffshadow._progress import show_with
from diffshadow.fit import Anneal, Parameter, Search, Solver, Sureness, fit
from diffshadow.fit._own_loss import OwnLoss, Seen
from diffshadow.shadow import RandomDisk, SoftCompare, stratified

SHORT = Anneal(start=1.0, end=0.1, phases=3)
BIAS = Parameter("bias.constant", 1.6, 0.0, 6.0)
RADIUS = Parameter("filter.radius", 2.0, 0.0, 8.0)


def disk(radius=2.0, bias=1.6, compare=None):
    return technique(RandomDisk(radius, stratified((2, 2))), bias, compare=compare)


@pytest.fixture(scope="module")
def known():
    """Its reference is what a bias of 0.8 texels and a radius of 3.2 texels make of it."""
    return problem(disk(), target=disk(3.2, 0.8))


def absolute(predicted, reference, mask):
    """The mean absolute error."""
    return jnp.sum(jnp.abs(predicted - reference), where=mask) / jnp.sum(mask)


class Differences(eqx.Module):
    """Residuals whose squares sum to `factor` times the mean square error."""

    factor: jax.Array = eqx.field(converter=jnp.asarray, default=1.0)

    def __call__(self, predicted, reference, mask):
        return jnp.where(mask, predicted - reference, 0) * jnp.sqrt(self.factor / jnp.sum(mask))


def mean_absolute_error(known, radius, bias, compare=None):
    visibility = disk(radius, bias, compare).visibility(known.shadow_map, known.surface)
    return float(absolute(visibility, known.reference, known.mask))


@pytest.fixture(scope="module")
def least_absolute(known):
    """A fit by a number and a minimiser of optimistix, and what it told."""
    told = []
    solver = Solver(method=optx.BFGS(1e-4, 1e-6), max_steps=60)
    return fit(known, [BIAS, RADIUS], solver=solver, anneal=SHORT, loss=absolute, on_step=told.append), told


@pytest.fixture(scope="module")
def by_residuals(known):
    """A fit by residuals and a least-squares solver of optimistix."""
    solver = Solver(method=optx.Dogleg(1e-4, 1e-7), max_steps=60)
    return fit(known, [BIAS, RADIUS], solver=solver, anneal=SHORT, loss=Differences())


@pytest.mark.exhaustive
def test_a_number_and_a_minimiser_find_known_values(least_absolute, known):
    result, _ = least_absolute
    assert result.fitted["filter.radius"] == pytest.approx(3.2, abs=0.15)
    assert result.fitted["bias.constant"] == pytest.approx(0.8, abs=0.5)
    assert result.precision is None
    assert result.flat == []


@pytest.mark.exhaustive
def test_the_hard_compare_judges_by_the_users_loss(least_absolute, known):
    result, _ = least_absolute
    for phase in result.phases:
        bias, radius = phase.values
        assert phase.hard_loss == pytest.approx(mean_absolute_error(known, radius, bias), rel=1e-3)
    assert result.chosen == int(np.argmin([phase.hard_loss for phase in result.phases]))
    start, end = (error**2 for error in result.errors)
    assert start == pytest.approx(mean_absolute_error(known, 2.0, 1.6), rel=1e-3)
    assert end == pytest.approx(min(phase.hard_loss for phase in result.phases), rel=1e-4)


@pytest.mark.exhaustive
def test_a_saved_fit_calls_a_users_loss_by_its_name(least_absolute, tmp_path):
    result, _ = least_absolute
    folder = study.save_fit(result, tmp_path / "mine")
    page, stored = (folder / "report.html").read_text(), json.loads((folder / "result.json").read_text())
    assert result.is_own_loss
    assert "hard loss" in page
    assert "hard RMSE" not in page
    assert f"{result.phases[0].hard_loss:.4g}" in page, "the loss itself, not its root"
    assert stored["solver"]["initial_loss"] == pytest.approx(result.errors[0] ** 2)
    assert stored["solver"]["name"] == "optimistix' BFGS"


@pytest.mark.exhaustive
def test_numbers_of_a_users_loss_and_solver_are_no_part_of_the_program(by_residuals, known):
    with compiled_programs() as compiled:
        solver = Solver(method=optx.Dogleg(1e-4, 1e-7), max_steps=60)
        again = fit(known, [BIAS, RADIUS], solver=solver, anneal=SHORT, loss=Differences(4.0))
    assert compiled == []
    assert again.errors == pytest.approx(tuple(2 * error for error in by_residuals.errors), rel=1e-3)


@pytest.mark.exhaustive
def test_a_fit_shows_its_steps_unless_it_has_a_listener(by_residuals, known):
    told = []

    @contextlib.contextmanager
    def display(name):
        yield lambda *state: told.append((name, *state))

    how = {"solver": Solver(method=optx.Dogleg(1e-4, 1e-7), max_steps=60), "anneal": SHORT, "loss": Differences()}
    show_with(display)
    try:
        fit(known, [BIAS, RADIUS], **how)
        shown = list(told)
        fit(known, [BIAS, RADIUS], **how, on_step=lambda _: None)
    finally:
        show_with(None)
    assert told == shown
    assert len(shown) == len(by_residuals.history)
    first = by_residuals.history[0]
    assert shown[0] == ("fit", f"phase 1 of 3, step 0, loss {first.loss:.5g}", 0.0)
    assert shown[-1][2] == pytest.approx(2 / 3)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "solver",
    [
        optx.Dogleg(1e-4, 1e-7),
        optx.LevenbergMarquardt(1e-4, 1e-7),
        optx.BFGS(1e-4, 1e-7),
        optx.NonlinearCG(1e-4, 1e-7),
        optx.NelderMead(1e-4, 1e-7),
        optx.BestSoFarMinimiser(optx.BFGS(1e-4, 1e-7)),
    ],
    ids=lambda solver: type(solver).__name__,
)
def test_solvers_of_optimistix_find_known_values(solver, known):
    result = fit(known, [BIAS, RADIUS], solver=Solver(method=solver, max_steps=60), anneal=SHORT)
    assert result.fitted["filter.radius"] == pytest.approx(3.2, abs=0.15)
    assert result.fitted["bias.constant"] == pytest.approx(0.8, abs=0.5)
    # Nelder and Mead's method begins at several places.
    assert any(step.values == pytest.approx((1.6, 2.0), abs=1e-5) for step in result.history[:3])
    assert result.precision is not None


@pytest.mark.exhaustive
def test_several_images_are_given_one_by_one_and_count_alike(known):
    other = dataclasses.replace(known, mask=known.mask & (jnp.arange(64)[:, None] > 24))
    shapes = []

    def loss(predicted, reference, mask):
        shapes.append((predicted.shape, reference.shape, mask.shape))
        return absolute(predicted, reference, mask)

    result = fit([known, other], [BIAS, RADIUS], anneal=SHORT, loss=loss)
    assert set(shapes) == {((64, 64),) * 3}
    each = [float(absolute(disk().visibility(p.shadow_map, p.surface), p.reference, p.mask)) for p in (known, other)]
    assert result.errors[0] ** 2 == pytest.approx(np.mean(each), rel=1e-3)
    assert result.history[0].loss != 0


def test_a_stack_has_the_rows_of_its_images():
    images = Seen(*(jnp.arange(12.0).reshape(3, 2, 2) * k for k in (1, 2)), jnp.ones((3, 2, 2), bool))
    loss = OwnLoss.of(Differences(), [(2, 2)])
    rows = loss.rows(images)
    for k in range(3):
        np.testing.assert_allclose(rows[k], Differences()(*(each[k] for each in images)).ravel(), rtol=1e-6)
    np.testing.assert_allclose(loss.of_rows(rows), np.mean(np.arange(12.0).reshape(3, 4) ** 2, axis=1), rtol=1e-6)


@pytest.mark.parametrize(
    ("loss", "message"),
    [
        ("worst", r"the loss is of type str; expected a fit.Loss, such as Loss\(\"worst\"\), or a function"),
        (Differences, "the loss is the class Differences; expected a fit.Loss"),
        (lambda p, r, m: None, "the loss returns an object of type NoneType; expected a function of three"),
        (lambda p, r, m: m, "the loss returns an array of bool; expected a function of three"),
        (lambda p, r, m: p if len(p) > 3 else jnp.sum(p), "a number for some images and residuals for others"),
    ],
)
def test_what_is_no_loss_is_refused(loss, message):
    with pytest.raises(TypeError, match=message):
        OwnLoss.of(loss, [(2, 2), (4, 4)])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"loss": lambda p, r, m: absolute(p, r, m) - 5}, r"the loss is -4.* at the initial values; expected 0 or"),
        (
            {"loss": absolute, "solver": optx.Dogleg(1e-4, 1e-6)},
            "the loss returns a number, and optimistix' Dogleg needs residuals; expected a minimiser, or an array",
        ),
        ({"loss": absolute, "solver": Solver()}, "a number, and levenberg_marquardt needs residuals"),
        (
            {"loss": absolute, "sureness": Sureness(front=3)},
            "a front of 3 points was requested with a loss",
        ),
    ],
)
def test_losses_that_do_not_suit_what_is_asked_for_are_refused(settings, message, known):
    with pytest.raises(ValueError, match=message):
        fit(known, [BIAS], **settings)


@pytest.mark.parametrize(
    ("solver", "message"),
    [
        (optx.Newton(1e-4, 1e-6), 'the solver is of type Newton; expected a fit.Solver, such as Solver("adam"), or a'),
        (optx.BFGS, "the solver is the class BFGS; expected a fit.Solver"),
        ("bfgs", "the solver is of type str; expected a fit.Solver"),
    ],
)
def test_what_is_no_solver_is_refused(solver, message):
    with pytest.raises(TypeError, match=re.escape(message)):
        Solver.of(solver)


def test_a_users_loss_sees_whole_images(known):
    solver = Solver(method=optx.BFGS(1e-4, 1e-6), max_steps=60)
    how = {"anneal": Anneal(1.0, 0.1, 1), "solver": solver, "search": Search(pixels=100)}
    result = fit(known, [BIAS, RADIUS], loss=absolute, **how)
    expected = mean_absolute_error(known, 2.0, 1.6, SoftCompare(0.1))
    assert result.history[0].loss == pytest.approx(expected, rel=1e-3)
