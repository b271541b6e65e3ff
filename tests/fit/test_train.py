"""Training: that it finds what is known over several views, keeps bounds, never ends worse, and refuses nonsense."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import Waves, problem, technique

from diffshadow.fit import Anneal, Solver, TechniqueProblem, mean_square_error, train
from diffshadow.shadow import Bias, HardCompare, LinearBias, Nearest, Separable, ShadowMapping

SHORT = Anneal(start=1.0, end=0.03, phases=3)
SOLVER = Solver(max_steps=20)
START, TARGET = (1.2, 0.7), (0.9, 0.5)


def numbers(technique):
    """All that is trained of waves."""
    return technique.first, technique.second


def waves(values):
    return Waves(*(jnp.asarray(value, jnp.float32) for value in values))


def half(problem):
    """With the lower rows of its image."""
    parts = lambda p: (p.surface, p.reference, p.mask)
    cut = jax.tree.map(lambda image: jnp.asarray(np.asarray(image)[:32]), parts(problem))
    return eqx.tree_at(parts, problem, cut)


@pytest.fixture(scope="module")
def views():
    """Images of waves by the numbers `TARGET`, of two sizes and of other pixels."""
    seen = problem(technique(Nearest()))
    truth = jax.jit(lambda surface: waves(TARGET).visibility(None, surface))(seen.surface)
    mask = np.broadcast_to(np.arange(64) < 40, (64, 64))
    whole = TechniqueProblem(waves(START), seen.shadow_map, seen.surface, truth, jnp.asarray(mask))
    return [whole, half(whole), dataclasses.replace(whole, mask=jnp.asarray(~mask))]


def test_training_finds_the_numbers_that_made_the_references(views):
    seen = []
    found = train(views, numbers, solver=SOLVER, anneal=SHORT, on_phase=seen.append)
    assert found.loss < 0.1 * found.initial_loss
    np.testing.assert_allclose(numbers(found.technique), TARGET, atol=0.02)
    assert isinstance(found.technique.compare, HardCompare)
    assert seen == found.phases
    assert [phase.width for phase in found.phases] == SHORT.widths
    assert found.loss == found.phases[found.chosen].hard_loss
    assert found.initial_loss == pytest.approx(mean_square_error(views, waves(START)), rel=1e-5)


def mapping(terms=None, weights=(0.6, 0.2), offset=0.2):
    return ShadowMapping(Separable(weights), Bias(normal_offset=offset, terms=terms or LINEAR))


LINEAR = LinearBias({"one": 0.5, "slope": 0.3})
KERNEL = mapping(LinearBias({"one": 0.9, "slope": 0.6}), (0.9, 0.5))


def bias_and_filter(technique):
    return technique.bias.terms, technique.filter.weights


def offset(technique):
    return technique.bias.normal_offset


def all_of_them(technique):
    return *bias_and_filter(technique), offset(technique)


@pytest.fixture(scope="module")
def shadowed():
    """The card over the floor under a sun and a spot light, whose references are what `KERNEL` makes of them."""
    return [problem(mapping(), light, target=KERNEL) for light in ("directional", "spot", "directional")]


@pytest.mark.exhaustive
def test_training_finds_the_kernel_and_the_bias_that_made_the_references(shadowed):
    found = train(shadowed, all_of_them, solver=SOLVER, anneal=SHORT)
    assert found.loss < 0.1 * found.initial_loss
    # They start 0.3 away.
    np.testing.assert_allclose(found.technique.filter.weights, (0.9, 0.5), atol=0.12)
    assert found.loss == pytest.approx(mean_square_error(shadowed, found.technique), rel=1e-5)
    assert float(offset(found.technique).value) == pytest.approx(0.2, abs=0.12)


@pytest.mark.exhaustive
@pytest.mark.parametrize("solver", [Solver("adam", 30, learning_rate=0.05), Solver("dogleg", 10)], ids=lambda s: s.name)
def test_other_solvers_get_better_too(views, solver):
    found = train(views, numbers, solver=solver, anneal=Anneal(0.3, 0.3, 1))
    assert found.loss < 0.5 * found.initial_loss
    assert found.phases[0].steps <= solver.max_steps


def test_training_keeps_lower_bounds_and_never_ends_worse(views):
    # The references have 0.9.
    start, lower = [dataclasses.replace(view, technique=waves((1.4, 0.7))) for view in views], (1.0, -np.inf)
    found = train(start, numbers, lower=lower, solver=SOLVER, anneal=SHORT)
    assert 1.0 <= float(found.technique.first) < 1.1
    assert found.loss < found.initial_loss
    # It may begin where it ended, which rounding has not moved beyond the bound.
    again = [dataclasses.replace(view, technique=found.technique) for view in views]
    assert train(again, numbers, lower=lower, solver=SOLVER, anneal=SHORT).loss <= found.loss
    perfect = [dataclasses.replace(view, technique=waves(TARGET)) for view in views]
    stays = train(perfect, numbers, anneal=Anneal(5.0, 5.0, 1), solver=SOLVER)
    assert stays.initial_loss < 1e-9
    assert stays.chosen == -1
    assert stays.loss == stays.initial_loss


@pytest.mark.exhaustive
def test_what_is_not_selected_stays(views):
    found = train(views, first, solver=Solver(max_steps=3), anneal=Anneal(1.0, 1.0, 1))
    assert found.loss < found.initial_loss
    assert found.technique.second == views[0].technique.second


def first(technique):
    return technique.first


def test_nonsense_is_refused(views):
    with pytest.raises(ValueError, match="got no view to train on; expected one or more problems"):
        train([], numbers)
    with pytest.raises(ValueError, match="where selects no number of the technique; expected numbers"):
        train(views, lambda technique: technique.compare)
    with pytest.raises(ValueError, match="a number starts below its lower bound; expected no number below it"):
        train(views, numbers, lower=1.0)
    blind = [dataclasses.replace(views[0], mask=jnp.zeros_like(views[0].mask))]
    with pytest.raises(ValueError, match="no pixel of any view counts"):
        train(blind, numbers)
