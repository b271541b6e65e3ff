"""Derivatives of all that has any: against central differences in magnitude, and of reverse against forward mode.

A row is a function of three to ten numbers. It draws nothing where a small piece can be called by itself.
"""

import numpy as np
import pytest
from derivatives import ROWS, found
from derivatives import of_geometry, of_raster  # noqa: F401

NAMES = list(ROWS)


def scale_of(*leaves):
    return max(np.abs(leaf).max(initial=0) for leaf in leaves)


@pytest.mark.parametrize("name", NAMES)
def test_value_is_finite_and_follows_each_number(name):
    known = found(name)
    assert all(np.isfinite(value).all() for value in known.values)
    for number in range(len(ROWS[name].at)):
        changes = [scale_of(slope[number]) / max(scale_of(value), 1e-3) for slope, value in zip(known.differences, known.values, strict=True)]
        assert max(changes) > 1e-6, f"number {number} changes nothing"


@pytest.mark.parametrize("name", NAMES)
def test_forward_mode_equals_central_differences(name):
    known, made = found(name), ROWS[name]
    if made.is_still:
        assert all((slope == 0).all() for slope in known.forward)
        return
    for leaf, (slope, difference, value) in enumerate(zip(known.forward, known.differences, known.values, strict=True)):
        for number in range(len(made.at)):
            most = scale_of(slope[number], difference[number])
            off = scale_of(slope[number] - difference[number])
            rounding = 1e-14 / made.step * max(scale_of(value), 1.0)
            assert off <= made.tolerance * most + rounding, f"leaf {leaf} by number {number}: {off:.3g} of {most:.3g}"


@pytest.mark.parametrize("name", [name for name in NAMES if ROWS[name].backward])
def test_reverse_mode_agrees_with_forward_mode(name):
    known = found(name)
    np.testing.assert_allclose(known.backward, known.expected, rtol=1e-8, atol=1e-9 * scale_of(known.expected))
