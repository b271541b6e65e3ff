"""The Python of docs/gradients.md runs, and its gradients are what central differences say."""

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

PAGE = Path(__file__).parent.parent / "docs" / "gradients.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
# Of the first block, which makes the scene, and of the others.
MOST_LINES = 14, 10
_NAMES: dict[str, Any] = {}
_RUN: list[str] = []


def names_after(count: int) -> dict[str, Any]:
    """The names that the page has defined after so many blocks, each of which runs once."""
    for block in BLOCKS[len(_RUN) : count]:
        exec(compile(block, PAGE.name, "exec"), _NAMES)
        _RUN.append(block)
    return _NAMES


def central(function: Any, places: tuple[Any, ...], number: int, steps: Any) -> np.ndarray:
    """Differences (p,) of `function` by each entry of `places[number]`, in `steps` (p,) of each."""
    slopes = []
    for step in np.diag(np.atleast_1d(np.asarray(steps, np.float32))):
        at = lambda sign, step=step: [
            place + sign * (step if np.ndim(place) else step[0]) if k == number else place
            for k, place in enumerate(places)
        ]
        slopes.append((float(function(*at(1))) - float(function(*at(-1)))) / (2 * step.sum()))
    return np.array(slopes)


def test_blocks_are_short():
    assert len(BLOCKS) > 4
    assert len(BLOCKS[0].splitlines()) <= MOST_LINES[0]
    assert max(len(block.splitlines()) for block in BLOCKS[1:]) <= MOST_LINES[1]


def test_gradients_by_bias_radius_and_width_are_those_of_differences():
    names = names_after(3)
    places = (1.0, 2.0, 0.5)
    mean = jax.jit(lambda *numbers: jnp.mean(names["soft"](*numbers)))
    for number, image in enumerate(names["by_numbers"]):
        expected = central(mean, places, number, 0.02)[0]
        assert abs(expected) > 0.01
        assert float(jnp.mean(image)) == pytest.approx(expected, rel=0.02)
    # The ends have one-sided differences.
    between = np.gradient(names["values"], 0.25)[1:-1]
    np.testing.assert_allclose(names["slopes"][1:-1], between, atol=0.01)


@pytest.mark.exhaustive
def test_gradients_by_a_lamp_and_a_pose_are_near_differences():
    names = names_after(5)
    places = names["lamp"].position, names["lamp"].direction, jnp.zeros(2)
    mean = jax.jit(lambda *places: jnp.mean(names["under_lamp"](*places), where=names["on_floor"]))
    found = [np.array(jnp.mean(image, (0, 1), where=names["on_floor"][..., None])) for image in names["by_lamp"]]
    for number, steps in ((0, (0.05, 0.05, 0.05)), (2, (0.03, 3.0))):
        expected = central(mean, places, number, steps)
        np.testing.assert_allclose(found[number], expected, atol=0.15 * np.abs(expected).max())


@pytest.mark.exhaustive
def test_gradients_by_vertices_and_suns_are_near_differences():
    names = names_after(6)
    knot, suns, along = names["knot"], names["suns"], jnp.array([0.03, 0.0, 0.0])
    lit = jax.jit(names["light_on_floor"])
    # All vertices together, so that many pixels see the outline move.
    for sun, by_vertices, by_sun in zip(suns, names["by_vertices"], names["by_suns"], strict=True):
        by_direction = (lit(knot.vertices, sun + along) - lit(knot.vertices, sun - along)) / 0.06
        assert float(by_sun[0]) == pytest.approx(float(by_direction), rel=0.15, abs=0.01)
        grown = [lit(knot.vertices * scale, sun) for scale in (1.02, 0.98)]
        by_scale = float(jnp.sum(by_vertices * knot.vertices))
        assert by_scale == pytest.approx(float(grown[0] - grown[1]) / 0.04, rel=0.15)
