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
MAX_LINES = 14, 10
_NAMES: dict[str, Any] = {}
_RUN: list[str] = []


def names_after(count: int) -> dict[str, Any]:
    """The names that the page's first `count` blocks define. Each block runs once."""
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
    scene, *others = [block for block in BLOCKS if "torch" not in block]
    assert len(others) == 7
    assert len(scene.splitlines()) <= MAX_LINES[0]
    assert max(sum(bool(line) for line in block.splitlines()) for block in others) <= MAX_LINES[1]


@pytest.mark.exhaustive
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
    # Where the shadow is, and not only how large, for its area hardly changes.
    weights = np.asarray(names["on_floor"]) * np.linspace(0, 1, 64, dtype=np.float32)
    weights /= weights.sum()
    lit = jax.jit(lambda *places: jnp.sum(weights * names["under_lamp"](*places)))
    for number, steps in ((0, (0.1, 0.1, 0.1)), (2, (0.05, 6.0))):
        found = np.einsum("yx,yxp->p", weights, np.asarray(names["by_lamp"][number]))
        expected = central(lit, places, number, steps)
        if number == 0:
            np.testing.assert_allclose(found, expected, atol=0.15 * np.abs(expected).max())
        else:
            # The knot's tube is a few texels wide here, and parts of its outlines are lost.
            np.testing.assert_allclose(found, expected, rtol=0.35)


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


@pytest.mark.exhaustive
def test_points_within_pixels_bring_the_gradient_by_a_sun_near_differences():
    names = names_after(7)
    found, sun = names["by_sun"], names["sun"].direction
    expected = central(jax.jit(names["light_with_points"]), (sun,), 0, (0.03, 0.03, 0.03))
    assert np.linalg.norm(found - expected) < 0.15 * np.linalg.norm(expected)


@pytest.mark.exhaustive
def test_gradients_in_pytorch_are_those_of_differences_and_of_jax():
    torch = pytest.importorskip("torch")
    names = names_after(9)
    expected = float(jnp.mean(names["by_numbers"][0]))
    assert float(names["bias"].grad) == pytest.approx(expected, rel=1e-4)
    mean = names["to_torch"](lambda *numbers: jnp.mean(names["soft"](*numbers)))
    numbers = [torch.tensor(number, requires_grad=True) for number in (1.0, 2.0, 0.5)]
    # Single precision: PyTorch would have it double, and says so.
    with pytest.warns(UserWarning, match="double precision"):
        assert torch.autograd.gradcheck(mean, numbers, eps=0.02, atol=0.005, rtol=0.05)
    given = [torch.tensor(np.asarray(x), requires_grad=True) for x in (names["knot"].vertices, names["suns"][0])]
    names["to_torch"](names["light_on_floor"])(*given).backward()
    for tensor, of_jax in zip(given, (names["by_vertices"][0], names["by_suns"][0]), strict=True):
        np.testing.assert_allclose(tensor.grad.numpy(), of_jax, rtol=1e-3, atol=1e-5)


@pytest.mark.exhaustive
def test_gradients_of_the_picture_are_near_differences():
    names = names_after(8)
    # Of a picture that is darker to the left, so that it matters where the knot is.
    weights = np.linspace(0, 1, 64, dtype=np.float32)[:, None] / 64**2
    mean = jax.jit(lambda offset: jnp.sum(weights * names["picture"](offset)))
    found = np.einsum("yxcp,x->p", np.asarray(names["by_offset"]), weights[:, 0])
    expected = central(mean, (jnp.zeros(3),), 0, (0.01, 0.01, 0.01))
    # The knot's tube is a few pixels wide here, and parts of its outlines that hide others are lost.
    assert found[0] == pytest.approx(expected[0], rel=0.25)
