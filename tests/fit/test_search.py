"""Searches for numbers that lay out the map: that they find the best of a grid, keep bounds, and refuse nonsense."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import Waves, drawn, floor_and_card, quad, side_camera, sun

from diffshadow.fit import Anneal, Parameter, Search, Solver, TechniqueProblem, fit
from diffshadow.fit._search import search
from diffshadow.geometry import PinholeCamera, Scene, merge
from diffshadow.raster import draw_surface
from diffshadow.reference import trace_visibility
from diffshadow.shadow import (
    Bias,
    Cascades,
    MapSettings,
    Nearest,
    ShadowMap,
    ShadowMapping,
)

SPACING = Parameter("layout.logarithmic", 0.2, 0.0, 1.0)
SHORT = Anneal(start=1.0, end=0.2, phases=2)


def jumpy(x: np.ndarray) -> float:
    """Steps of a hundredth on a slope that is least at (0.3, 0.7)."""
    return float(np.round(np.abs(x - [0.3, 0.7]).sum(), 2))


def test_a_search_finds_the_least_of_a_function_with_jumps():
    lower, upper = np.zeros(2), np.ones(2)
    found = search(jumpy, np.array([0.9, 0.1]), lower, upper, 100)
    assert found.error <= 0.02
    assert 50 <= found.evaluations <= 150
    # A part of the box lies about the start, moved to within the bounds.
    tried = []
    corner = np.array([0.0, 1.0])
    near = search(lambda x: tried.append(x.copy()) or jumpy(x), corner, lower, upper, 30, part=0.25)
    assert (np.array(tried) >= [0, 0.75]).all()
    assert (np.array(tried) <= [0.25, 1]).all()
    assert near.error == pytest.approx(jumpy(near.values))


def test_a_search_never_ends_worse_than_it_began():
    start = np.array([0.123])
    found = search(lambda x: float((x != start).any()), start, np.zeros(1), np.ones(1), 10)
    assert found.error == 0
    assert found.values == start


def along_posts() -> Scene:
    """Posts beside a plane that runs from the camera to its far plane."""
    ground = quad((0, 0, -25), (12, 0, 0), (0, 0, -26))
    posts = [quad((x, 0.7, -1 - 40 * (k / 6) ** 2), (0.2, 0, 0), (0, 0.7, 0)) for k in range(6) for x in (-1.2, 1.0)]
    mesh = merge([ground, *posts])
    camera = PinholeCamera((0, 1.6, 1), (0, 1.1, -9), fov_y=60.0, near=0.2, far=50.0, resolution=(64, 64))
    return Scene(mesh, camera, sun(mesh, (0.5, -1.0, -0.4)))


@pytest.fixture(scope="module")
def seen():
    scene = along_posts()
    return scene, draw_surface(scene.mesh, scene.camera), trace_visibility(scene, 1, "sobol", 0)


def problem(seen, layout) -> TechniqueProblem:
    scene, surface, truth = seen
    technique = ShadowMapping(Nearest(), Bias(1.0), map=MapSettings((32, 32)), layout=layout)
    return TechniqueProblem.of(scene, technique, truth, surface=surface)


@pytest.mark.exhaustive
def test_the_spacing_of_cascades_is_found(seen):
    made = problem(seen, Cascades(3, 0.2, margin=2.0))
    at = lambda spacing: dataclasses.replace(made.technique, layout=Cascades(3, spacing, margin=2.0))
    error = lambda technique: float(made.laid_out(technique).mean_square_error(technique))
    grid = [error(at(float(spacing))) for spacing in np.linspace(0, 1, 17)]
    result = fit(made, [SPACING], search=Search(evaluations=40))
    found = error(result.technique)
    assert found == pytest.approx(result.phases[-1].hard_loss)
    assert found <= 1.02 * min(grid)
    assert max(grid) > 1.2 * min(grid)
    (problem_after,) = result.problems
    assert isinstance(problem_after, TechniqueProblem)
    assert float(problem_after.mean_square_error(result.technique)) == pytest.approx(found)
    # Every evaluation is recorded, and none leaves the bounds.
    assert [step.step for step in result.history] == list(range(len(result.history)))
    assert all(0 <= step.values[0] <= 1 for step in result.history)
    assert min(step.loss for step in result.history) == pytest.approx(found)


class Bands(Waves):
    """Waves that lay out a map: `first` and `second`, in order, are stored in it, and a third number is not."""

    bias: Any = 0.0

    def lays_out(self, name):
        return name in ("first", "second")

    def prepare(self, scene, surface=None):
        if self.first >= self.second:
            raise ValueError("the bands are out of order")
        depth = np.repeat(np.float32([self.first, self.second]), 4).reshape(2, 4)
        return ShadowMap(jnp.asarray(depth), scene.light)

    def visibility(self, state, surface):
        x = surface.position[..., 0]
        return 0.3 + 0.2 * jnp.sin(state.depth[0, 0] * x + state.depth[1, 0] * x**2) + 0.1 * self.bias


def bands(*values):
    first, second, bias = (jnp.asarray(value, jnp.float32) for value in values)
    return Bands(first, second, bias=bias)


# These bounds allow a first number that is greater than the second.
ENDS = [Parameter("first", 0.2, 0.0, 0.9), Parameter("second", 0.5, 0.1, 1.0)]
SHIFT = Parameter("bias", 1.0, 0.0, 4.0)


@pytest.fixture(scope="module")
def found():
    """A problem of bands, and the fit of all of their numbers."""
    mesh = floor_and_card()
    scene, surface = Scene(mesh, side_camera(), sun(mesh)), drawn("directional", 64, 64)[0]
    start, truth = bands(0.2, 0.5, 1.0), bands(0.35, 0.8, 2.0)
    seen = truth.visibility(truth.prepare(scene), surface)
    made = TechniqueProblem(start, start.prepare(scene), surface, seen, surface.mask, scene)
    return made, fit(made, [SHIFT, *ENDS], anneal=SHORT, solver=Solver("lbfgs", 10), search=Search(evaluations=12))


@pytest.mark.exhaustive
def test_a_bias_is_fitted_by_gradient_between_the_searches(found):
    _, result = found
    assert [phase.searched > 0 for phase in result.phases] == [True, False, False, True, False]
    # A search changes all, and the other phases keep the layout.
    values = [list(result.initial.values()), *(phase.values for phase in result.phases)]
    for phase, before, after in zip(result.phases, values[:-1], values[1:], strict=True):
        assert phase.searched or after[1:] == pytest.approx(before[1:], abs=1e-5)
    assert values[1][0] != values[0][0]
    assert values[2][0] != pytest.approx(values[1][0], abs=1e-3)
    assert not result.flat


def test_a_search_draws_the_map_again_and_refuses_what_does_not_suit_the_scene(found):
    made, result = found
    _, first, second = result.fitted.values()
    assert first < second
    error = float(made.laid_out(result.technique).mean_square_error(result.technique))
    assert error == pytest.approx(min(phase.hard_loss for phase in result.phases), rel=1e-4)
    assert error < 0.5 * result.phases[0].hard_loss < 0.5 * made.mean_square_error(made.technique)
    assert any(step.values[1] >= step.values[2] and step.loss == 1.0 for step in result.history)


SLICES = Cascades(distances=(1.0, 2.5, 50.0), margin=2.0)


@pytest.mark.exhaustive
def test_the_ends_of_slices_stay_in_order(seen):
    made = problem(seen, SLICES)
    # These bounds allow a first slice that ends after the second.
    ends = [Parameter("layout.distances.0", 1.0, 0.5, 40.0), Parameter("layout.distances.1", 2.5, 2.0, 45.0)]
    result = fit(made, ends, search=Search(evaluations=20))
    first, second = result.fitted.values()
    assert first < second
    assert result.phases[0].hard_loss < 0.9 * made.mean_square_error(made.technique)
    assert any(step.values[0] >= step.values[1] and step.loss == 1.0 for step in result.history)


def test_mistakes_are_named(found):
    made, _ = found
    with pytest.raises(ValueError, match="no scene to draw the map from"):
        fit(dataclasses.replace(made, scene=None), ENDS[:1])
    with pytest.raises(ValueError, match=r"further than the map's layout allows: .*out of order"):
        fit(made, [Parameter("first", 0.2, 0.0, 0.6)])
    with pytest.raises(ValueError, match="evaluations is 0; expected a whole number at least 1"):
        fit(made, [Parameter("first", 0.2, 0.0, 0.4)], search=Search(evaluations=0))


@pytest.mark.exhaustive
def test_bounds_that_a_layout_does_not_allow_are_named(seen):
    made = problem(seen, Cascades(3, 0.2, margin=2.0))
    with pytest.raises(ValueError, match=r"further than the technique allows: .*logarithmic is 2.0; expected a number"):
        fit(made, [Parameter("layout.logarithmic", 0.2, 0.0, 2.0)])
