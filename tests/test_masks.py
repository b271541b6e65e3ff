"""Masks and weights: a mask is as good as a crop, and what lies outside of it changes nothing.

A row of the table is a function of two images and a mask. It is tried with a mask of a half, which no function may
take for the whole.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scenes import Waves, map_of, surface_at

from diffshadow import fit, metrics
from diffshadow._arithmetic import as_float
from diffshadow.fit.problems._arranged import weighted_difference
from diffshadow.fit.problems._joint import Joint
from diffshadow.reference import Reference
from diffshadow.study.runs._explained import _mean_square, _variance, best_change

SHAPE = 12, 20
CROP = slice(3, 11), slice(2, 14)


def images(count=2):
    """Visibilities, a part of them dark or lit, and a reference that is close; of all pixels."""
    rng = np.random.default_rng(3)
    y, x = np.indices(SHAPE)
    truth = np.clip(0.5 + 1.7 * np.sin(0.45 * x + 0.3 * y + 0.3 * np.arange(count)[:, None, None]), 0, 1)
    return np.clip(truth + rng.normal(0, 0.2, truth.shape), 0, 1), truth


class Given(Waves):
    """Stands for a technique that draws the images it was given."""

    def __init__(self, image):
        self.first = self.second = as_float(0.0)
        self.image = as_float(image)

    image: object = None

    def visibility(self, state, surface):
        return self.image


def technique_problem(image, truth, mask, **more):
    surface = surface_at(np.zeros((*image.shape, 3)), (0, 1, 0))
    return fit.TechniqueProblem(
        Given(image), map_of(np.ones((4, 6))), surface, as_float(truth), jnp.asarray(mask), **more
    )


def of_joint(loss=None):
    """The loss of a fit to one image, and its error."""

    def of(image, truth, mask):
        problem = technique_problem(image, truth, mask)
        found = Joint.of(problem, loss).losses(problem.subject)
        return [float(found.whole), *map(float, found.errors)]

    return of


def of_weights(image, truth, mask):
    """The mean square difference that fits of lights make small: some pixels count less."""
    weight = as_float(np.where(mask, 0.5 + 0.5 * (np.nan_to_num(truth, nan=0.0) > 0.5), 0.0))
    found = weighted_difference(as_float(image), as_float(truth), weight)
    return float(jnp.sum(found**2) / jnp.sum(weight))


def absolute(predicted, reference, mask):
    """A user's loss, which divides by the pixels that count."""
    return jnp.sum(jnp.abs(predicted - reference)) / jnp.sum(mask)


def residuals(predicted, reference, mask):
    """A user's residuals, which rely on images that agree where no pixel counts."""
    return predicted - reference


def noise(image, truth, mask):
    none = np.zeros((*truth.shape, 3), np.float32)
    of = Reference(
        truth.astype(np.float32), mask, none, none, np.zeros(mask.shape, np.int32), 4, image.astype(np.float32)
    )
    return of.noise_floor


def changed(image, truth, mask):
    # Of an inverted reference; a mask that is no mirror image of itself.
    return best_change([image], 1 - truth, mask)


def extents(image, truth, mask):
    return list(metrics.measure_aliasing(4 * image, mask).as_dict().values())


def perceived(image, truth, mask):
    # Its filters reach into what lies outside, where pictures agree: the reference is the same there.
    return metrics.flip(*(np.stack([each] * 3, axis=-1) for each in (image, np.where(mask, truth, 0.4))), mask)[0]


class Row(NamedTuple):
    """A function of image, reference and mask; whether a crop is the same; what may be in an image where it does not
    count; and the tolerance, relative to the value, of sums in single precision."""

    of: object
    crops: bool = True
    garbage: tuple = (np.nan, 1e9, -1e9)
    tolerance: float = 1e-12


_SINGLE = 2e-6
ROWS = {
    "mae": Row(metrics.mae),
    "rmse": Row(metrics.rmse),
    "psnr": Row(metrics.psnr),
    "ssim": Row(metrics.ssim, tolerance=1e-10),
    "false shadow": Row(metrics.false_shadow_rate),
    "false shadow without a band": Row(lambda *given: metrics.false_shadow_rate(*given, band=0)),
    "false light": Row(metrics.false_light_rate),
    "false light within two pixels": Row(lambda *given: metrics.false_light_rate(*given, band=2)),
    "all errors": Row(lambda *given: list(metrics.measure_errors(*given).as_dict().values()), tolerance=1e-10),
    "extents of texels": Row(
        lambda image, truth, mask: list(metrics.measure_aliasing(4 * image, mask).as_dict().values())
    ),
    # Colours are from 0 to 1.
    "flip": Row(perceived, crops=False, garbage=(0.0, 1.0, 0.3)),
    "noise of a reference": Row(noise, tolerance=_SINGLE),
    "error of a fit to one image": Row(of_joint(), tolerance=_SINGLE),
    "the worst image": Row(of_joint(fit.Loss("worst")), tolerance=_SINGLE),
    "false light counts more": Row(of_joint(fit.Loss(false_shadow=0.5, false_light=3.0)), tolerance=_SINGLE),
    "a user's loss": Row(of_joint(absolute), tolerance=_SINGLE),
    "a user's residuals": Row(of_joint(residuals), tolerance=_SINGLE),
    "differences under weights": Row(of_weights, tolerance=_SINGLE),
    "what a fit leaves": Row(lambda *given: (_mean_square(*given), _variance(given[1], given[2]))),
    "another reference that would do": Row(lambda *given: list(changed(*given)[2:]), crops=False),
}
_FLICKER = "flicker"


def value_of(name, image, truth, mask):
    if name == _FLICKER:
        return np.array([metrics.flicker(image, truth, mask)])
    return np.atleast_1d(np.asarray(ROWS[name].of(image[0], truth[0], mask[0]), float))


NAMES = [*ROWS, _FLICKER]
ROWS_AND_FLICKER = ROWS | {_FLICKER: Row(None)}


def masks():
    """Of two frames: a rectangle; and a half whose border is no straight line, and another one in the second frame."""
    crop = np.zeros((2, *SHAPE), bool)
    crop[:, *CROP] = True
    y, x = np.indices(SHAPE)
    return crop, np.stack([2 * x + y % 3 < 19, 2 * x + y % 4 < 22])


@pytest.mark.parametrize("name", [name for name in NAMES if ROWS_AND_FLICKER[name].crops])
def test_a_mask_is_as_good_as_a_crop(name):
    image, truth = images()
    crop, _ = masks()
    small = [each[:, *CROP] for each in (image, truth, crop)]
    expected = value_of(name, *small)
    np.testing.assert_allclose(value_of(name, image, truth, crop), expected, rtol=ROWS_AND_FLICKER[name].tolerance)


@pytest.mark.parametrize("name", NAMES)
def test_what_lies_outside_of_the_mask_changes_nothing(name):
    image, truth = images()
    _, half = masks()
    known = value_of(name, image, truth, half)
    assert np.isfinite(known).all()
    for number in ROWS_AND_FLICKER[name].garbage:
        spoilt = np.where(half, image, number)
        np.testing.assert_array_equal(value_of(name, spoilt, truth, half), known)
        # The reference too, where it may be anything.
        if name not in REFERENCE_IS_FINITE:
            np.testing.assert_array_equal(value_of(name, spoilt, np.where(half, truth, number), half), known)


REFERENCE_IS_FINITE = {"a user's loss", "a user's residuals"}
"""A user's loss sees the reference at all pixels."""


@pytest.mark.parametrize("name", NAMES)
def test_a_half_mask_is_not_the_whole(name):
    image, truth = images()
    _, half = masks()
    whole, other = np.ones_like(half), ~half
    values = [value_of(name, image, truth, mask) for mask in (half, whole, other)]
    assert all(np.abs(values[0] - value).max() > 1e-4 * np.abs(values[0]).max() for value in values[1:])


def test_several_images_count_by_their_pixels():
    """The errors of images with masks of other sizes, and the mean over all pixels that count."""
    image, truth = images()
    _, half = masks()
    half[1, 4:] = False
    problems = [technique_problem(*each) for each in zip(image, truth, half, strict=True)]
    subject = problems[0].subject
    # Both draw the first image.
    expected = np.array([np.mean((image[0] - t)[m] ** 2) for t, m in zip(truth, half, strict=True)])
    counts = half.sum(axis=(1, 2))
    for loss, whole in ((None, np.average(expected, weights=counts)), (fit.Loss("worst"), expected.max())):
        found = Joint.of(problems, loss).losses(subject)
        np.testing.assert_allclose(found.errors, expected, rtol=_SINGLE)
        np.testing.assert_allclose(found.whole, whole, rtol=_SINGLE)


def test_a_sample_holds_only_pixels_that_count():
    _, truth = images()
    _, half = masks()
    problem = technique_problem(np.where(half[0], 7.0, np.nan), np.where(half[0], truth[0], 1e9), half[0])
    sample = problem.sampled(40, 0)
    assert float(jnp.max(jnp.where(sample.mask, sample.reference, 0))) <= 1
    assert float(sample.count) == half[0].sum()


def test_pixels_stand_for_as_many_as_their_weight_says():
    image, truth = images()
    _, half = masks()
    weight = 1 + np.indices(SHAPE)[0] % 3
    problem = technique_problem(image[0], truth[0], half[0], weight=weight)
    expected = np.average((image[0] - truth[0]) ** 2, weights=weight * half[0])
    assert float(problem.mean_square_error(problem.subject)) == pytest.approx(expected, rel=_SINGLE)


def test_channels_of_a_picture_count_where_its_mask_does():
    """By the differences of a picture problem, whose picture is made here."""
    from diffshadow.fit._own_loss import Seen

    image, truth = (np.stack([each[0], each[1], each[0] ** 2]) for each in images())
    _, half = masks()
    weight = as_float(half[0])
    spoilt = np.where(half[0], image, np.nan)
    found = weighted_difference(as_float(spoilt), as_float(truth), weight)
    np.testing.assert_allclose(found, np.where(half[0], image - truth, 0), atol=1e-6)
    counts = jnp.broadcast_to(weight > 0, found.shape)
    seen = Seen.of(as_float(spoilt), as_float(truth), counts)
    np.testing.assert_allclose(seen.predicted, np.where(half[0], image, truth), atol=1e-6)
