"""Training: that it finds what is known over several views, keeps bounds, never ends worse, and refuses nonsense."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import problem

from diffshadow.fit import Anneal, Solver, mean_square_error, train
from diffshadow.fit._train import _compressed, _loss, _plain, _put, _selected, _stacked
from diffshadow.shadow import Bias, HardCompare, LinearBias, PerceptronBias, Separable, ShadowMapping, SoftCompare

SHORT = Anneal(start=1.0, end=0.03, phases=3)


def mapping(terms=None, weights=(0.6, 0.2), offset=0.2):
    return ShadowMapping(Separable(weights), Bias(normal_offset=offset, terms=terms or LINEAR))


LINEAR = LinearBias({"one": 0.5, "slope": 0.3})
TARGET = mapping(LinearBias({"one": 0.9, "slope": 0.6}), (0.9, 0.5))


def bias_and_filter(technique):
    return technique.bias.terms, technique.filter.weights


def terms(technique):
    return technique.bias.terms


def offset(technique):
    return technique.bias.normal_offset


def all_numbers(technique):
    """What the tests of every run train, so that they share one program."""
    return *bias_and_filter(technique), offset(technique)


SOLVER = Solver(max_steps=20)


@pytest.fixture(scope="module")
def views():
    """The card over the floor under a sun and a spot light, whose references are what `TARGET` makes of them."""
    return [problem(mapping(), light, target=TARGET) for light in ("directional", "spot", "directional")]


def test_training_finds_the_kernel_and_the_bias_that_made_the_references(views):
    seen = []
    found = train(views, all_numbers, solver=SOLVER, anneal=SHORT, on_phase=seen.append)
    assert found.loss < 0.1 * found.initial_loss
    # They start 0.3 away.
    np.testing.assert_allclose(found.technique.filter.weights, (0.9, 0.5), atol=0.12)
    assert isinstance(found.technique.compare, HardCompare)
    assert seen == found.phases
    assert [phase.width for phase in found.phases] == SHORT.widths
    assert found.loss == found.phases[found.chosen].hard_loss
    assert found.loss == pytest.approx(mean_square_error(views, found.technique), rel=1e-5)
    assert float(offset(found.technique).value) == pytest.approx(0.2, abs=0.12)


@eqx.filter_jit
def losses(groups, technique, values):
    """The loss under the technique's compare, its gradient by reverse mode, and the compressed residuals."""
    loss = lambda values: _loss(groups, technique, values, terms)
    rows = _compressed(groups, lambda values: _put(technique, terms, values), values)
    return *jax.value_and_grad(loss)(values), rows


def test_compressed_residuals_have_the_loss_and_its_gradient(views):
    """Against central differences, in double precision, and against each view on its own."""
    with jax.enable_x64(True):
        doubled = lambda tree: jax.tree.map(lambda x: jnp.asarray(x, float) if eqx.is_inexact_array(x) else x, tree)
        network = PerceptronBias.correcting(LINEAR, (2,), seed=1)
        network = eqx.tree_at(lambda bias: bias.last, network, jnp.array([0.3, -0.2]))
        technique = doubled(dataclasses.replace(mapping(network), compare=SoftCompare(1.0)))
        groups = _stacked([_plain(doubled(view), technique) for view in views])
        # Views of one light share a loop.
        assert len(groups) == 2
        values, _ = jax.flatten_util.ravel_pytree(_selected(technique, terms))
        loss, gradient, rows = (np.asarray(x) for x in losses(groups, technique, values))
        each = [np.sum(np.asarray(view.difference(technique)) ** 2) for view in map(doubled, views)]
        count = sum(int(view.count) for view in views)
        np.testing.assert_allclose(loss, sum(each) / count, rtol=1e-9)
        np.testing.assert_allclose(np.sum(rows[:, -1] ** 2), loss, rtol=1e-9)
        np.testing.assert_allclose(2 * rows[:, :-1].T @ rows[:, -1], gradient, rtol=1e-7, atol=1e-12)
        step = 1e-6
        for k in range(values.size):
            low, high = (float(losses(groups, technique, values.at[k].add(h))[0]) for h in (-step, step))
            assert gradient[k] == pytest.approx((high - low) / (2 * step), rel=1e-3, abs=1e-8)
        assert (np.abs(gradient) > 1e-7).sum() > values.size / 2


@pytest.mark.exhaustive
@pytest.mark.parametrize("solver", [Solver("adam", 30, learning_rate=0.05), Solver("dogleg", 10)], ids=lambda s: s.name)
def test_other_solvers_get_better_too(views, solver):
    found = train(views, bias_and_filter, solver=solver, anneal=Anneal(0.3, 0.3, 1))
    assert found.loss < 0.5 * found.initial_loss
    assert found.phases[0].steps <= solver.max_steps


def test_training_keeps_lower_bounds_and_never_ends_worse(views):
    # The references have an offset of 0.2.
    start, lower = [dataclasses.replace(view, technique=mapping(offset=1.5)) for view in views], (-np.inf, -np.inf, 1.0)
    found = train(start, all_numbers, lower=lower, solver=SOLVER, anneal=SHORT)
    assert 1.0 <= float(offset(found.technique).value) < 1.5
    assert found.loss < found.initial_loss
    # It may begin where it ended, which rounding has not moved beyond the bound.
    again = [dataclasses.replace(view, technique=found.technique) for view in views]
    assert train(again, all_numbers, lower=lower, solver=SOLVER, anneal=SHORT).loss <= found.loss
    perfect = [dataclasses.replace(view, technique=TARGET) for view in views]
    stays = train(perfect, all_numbers, anneal=Anneal(5.0, 5.0, 1), solver=SOLVER)
    assert stays.initial_loss < 1e-9
    assert stays.chosen == -1
    assert stays.loss == stays.initial_loss


@pytest.mark.exhaustive
def test_what_is_not_selected_stays(views):
    found = train(views, bias_and_filter, solver=Solver(max_steps=3), anneal=Anneal(1.0, 1.0, 1))
    assert found.loss < found.initial_loss
    assert offset(found.technique).value == offset(views[0].technique).value


def test_nonsense_is_refused(views):
    with pytest.raises(ValueError, match="got no view to train on; expected one or more problems"):
        train([], terms)
    with pytest.raises(ValueError, match="where selects no number of the technique; expected some"):
        train(views, lambda technique: technique.compare)
    with pytest.raises(ValueError, match="a number starts below its lower bound; expected each at or above it"):
        train(views, offset, lower=1.0)
    blind = [dataclasses.replace(views[0], mask=jnp.zeros_like(views[0].mask))]
    with pytest.raises(ValueError, match="no pixel of any view counts"):
        train(blind, terms)
    with pytest.raises(ValueError, match="the anneal has 0 phases"):
        train(views, terms, anneal=Anneal(phases=0))
    with pytest.raises(ValueError, match="the solver's max_steps is 0"):
        train(views, terms, solver=Solver(max_steps=0))
