"""ꟻLIP of pictures whose error is known, and of shadows."""

import sys
from itertools import pairwise

import numpy as np
import pytest

from diffshadow.metrics import flip

pytest.importorskip("flip_evaluator", reason="it has no wheel for this Python")

LINEAR_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def shaded(shadow: float, columns: int = 32) -> np.ndarray:
    """A grey wall whose left half is in a shadow, which leaves this fraction of its brightness."""
    picture = np.full((24, columns, 3), (0.7, 0.65, 0.6))
    picture[:, : columns // 2] *= shadow
    return picture


def hunt_lab(colour) -> np.ndarray:
    """CIELAB (D65) of an sRGB colour, with a and b scaled by 0.01 L: the paper's sections 4.1.2 and 4.1.3."""
    srgb = np.asarray(colour, np.float64)
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    xyz = LINEAR_TO_XYZ @ linear / LINEAR_TO_XYZ.sum(axis=1)
    x, y, z = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    lightness = 116 * y - 16
    return np.array([lightness, 0.01 * lightness * 500 * (x - y), 0.01 * lightness * 200 * (y - z)])


def colour_error(one, other) -> float:
    """The paper's error of two uniform pictures, which have no features."""
    hyab = lambda a, b: (abs(a[0] - b[0]) + np.hypot(*(a - b)[1:])) ** 0.7
    most = hyab(hunt_lab((0, 1, 0)), hunt_lab((0, 0, 1)))
    error, knee = hyab(hunt_lab(one), hunt_lab(other)), 0.4 * most
    return 0.95 * error / knee if error < knee else 0.95 + 0.05 * (error - knee) / (most - knee)


def test_without_its_package_the_error_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(ImportError, match=r"needs the package flip-evaluator.*pip install flip-evaluator"):
        flip(shaded(0.5), shaded(0.5))


def test_equal_pictures_have_no_error():
    mean, errors = flip(shaded(0.5), shaded(0.5))
    assert mean == 0
    assert errors.shape == (24, 32)
    assert not errors.any()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((0, 0, 0), (1, 1, 1)),
        ((0, 1, 0), (0, 0, 1)),
        ((0.3, 0.3, 0.3), (0.35, 0.35, 0.35)),
        ((0.6, 0.5, 0.4), (0.3, 0.25, 0.2)),
    ],
)
def test_uniform_pictures_have_the_error_of_their_colours(one, other):
    mean, errors = flip(np.full((6, 8, 3), one), np.full((6, 8, 3), other))
    assert mean == pytest.approx(colour_error(one, other), abs=2e-4)
    np.testing.assert_allclose(errors, mean, atol=1e-5)


def test_error_grows_with_the_difference_and_is_symmetric():
    means = [flip(shaded(shadow), shaded(1.0))[0] for shadow in (1.0, 0.95, 0.8, 0.5, 0.1)]
    assert all(less < more for less, more in pairwise(means))
    there, back = flip(shaded(0.5), shaded(0.8)), flip(shaded(0.8), shaded(0.5))
    assert there[0] == back[0]
    np.testing.assert_array_equal(there[1], back[1])


def test_order_of_rows_and_columns_does_not_matter():
    rng = np.random.default_rng(0)
    picture, reference = rng.uniform(size=(2, 20, 28, 3))
    _, errors = flip(picture, reference)
    for turn in (lambda a: a[::-1], lambda a: a[:, ::-1], lambda a: a.swapaxes(0, 1)):
        mean, turned = flip(turn(picture), turn(reference))
        np.testing.assert_allclose(turned, turn(errors), atol=1e-5)
        assert mean == pytest.approx(errors.mean(), abs=1e-6)


@pytest.mark.parametrize(
    ("picture", "reference", "mask", "message"),
    [
        (np.zeros((4, 5)), np.zeros((4, 5, 3)), None, r"picture has shape \(4, 5\); expected \(height, width, 3\)"),
        (
            np.zeros((4, 5, 3)),
            np.zeros((4, 5, 4)),
            None,
            r"reference has shape \(4, 5, 4\); expected \(height, width, 3",
        ),
        (
            np.zeros((4, 5, 3)),
            np.zeros((5, 4, 3)),
            None,
            r"picture has shape \(4, 5, 3\) and the reference \(5, 4, 3\)",
        ),
        (np.zeros((0, 5, 3)), np.zeros((0, 5, 3)), None, r"shape \(0, 5, 3\)"),
        (np.zeros((4, 5, 3)), np.zeros((4, 5, 3)), np.ones((5, 4), bool), r"mask has shape \(5, 4\)"),
        (np.zeros((4, 5, 3)), np.zeros((4, 5, 3)), np.zeros((4, 5), bool), "mask holds none of the 20 pixels"),
        (
            np.full((4, 5, 3), 99, np.uint8),
            np.zeros((4, 5, 3)),
            None,
            r"60 values outside \[0, 1\].*divide bytes by 255",
        ),
        (np.zeros((4, 5, 3)), np.full((4, 5, 3), np.nan), None, r"reference holds 60 values .*row 0, column 0"),
        (np.full((4, 5, 3), -0.1), np.zeros((4, 5, 3)), None, "picture holds 60 values"),
    ],
)
def test_what_cannot_be_compared_is_refused(picture, reference, mask, message):
    with pytest.raises(ValueError, match=message):
        flip(picture, reference, mask)
