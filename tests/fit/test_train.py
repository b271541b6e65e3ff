"""Training: that it finds what is known over several views, keeps bounds, never ends worse, and refuses nonsense."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import Waves, covered, doubled, floor_and_card, lamp, problem, shadows

from diffshadow.fit import Anneal, Solver, TechniqueProblem, mean_square_error, train
from diffshadow.fit._train import _compressed, _loss, _plain, _put, _stacked
from diffshadow.shadow import Bias, HardCompare, LinearBias, Separable, ShadowMapping, draw_shadow_map

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
    """The card over the floor under two lamps, whose references are what `TARGET` makes of it; the first once more."""
    mesh, first = floor_and_card(), problem(mapping(), "spot", target=TARGET)
    shadow_map = draw_shadow_map(mesh, lamp(mesh, (-0.4, 2.2, 1.8)), (64, 64))
    parts = [each(TARGET, shadow_map, first.surface) for each in (shadows, covered)]
    return [first, TechniqueProblem(mapping(), shadow_map, first.surface, *parts), first]


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
    """The loss, its gradient by reverse mode, and the compressed residuals."""
    numbers = lambda waves: (waves.first, waves.second)
    loss = lambda values: _loss(groups, technique, values, numbers)
    rows = _compressed(groups, lambda values: _put(technique, numbers, values), values)
    return *jax.value_and_grad(loss)(values), rows


def test_compressed_residuals_have_the_loss_and_its_gradient(views):
    """Against central differences, in double precision, and against each view on its own."""
    with jax.enable_x64(True):
        waves = doubled(Waves(jnp.asarray(0.7), jnp.asarray(0.4)))
        lower = lambda image: jnp.asarray(np.asarray(image)[:48])
        parts = lambda p: (p.surface, p.reference, p.mask)
        cut = eqx.tree_at(parts, views[0], jax.tree.map(lower, parts(views[0])))
        seen = [_plain(doubled(view), waves) for view in (views[1], cut, views[2])]
        groups = _stacked(seen)
        # Views with images of one size share a loop.
        assert len(groups) == 2
        values = np.array([0.7, 0.4])
        at = lambda values: tuple(map(np.asarray, losses(groups, waves, values)))
        loss, gradient, rows = at(values)
        difference = eqx.filter_jit(lambda view: view.difference(waves))
        each = [np.sum(np.asarray(difference(view)) ** 2) for view in seen]
        count = sum(np.asarray(view.mask).sum() for view in seen)
        np.testing.assert_allclose(loss, sum(each) / count, rtol=1e-9)
        np.testing.assert_allclose(np.sum(rows[:, -1] ** 2), loss, rtol=1e-9)
        np.testing.assert_allclose(2 * rows[:, :-1].T @ rows[:, -1], gradient, rtol=1e-7, atol=1e-12)
        expected = [(at(values + d)[0] - at(values - d)[0]) / 2e-6 for d in 1e-6 * np.eye(2)]
        assert gradient == pytest.approx(expected, rel=1e-3, abs=1e-8)
        assert np.abs(gradient).min() > 1e-4


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
