"""Metrics on images whose errors are known exactly."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow.metrics import (
    ShadowErrors,
    chamfer_distance,
    count_self_intersections,
    false_light_rate,
    false_shadow_rate,
    flicker,
    intersection_over_union,
    mae,
    measure_aliasing,
    measure_errors,
    penumbra_width,
    psnr,
    rmse,
    ssim,
)

ALL = [rmse, mae, psnr, ssim, false_shadow_rate, false_light_rate, measure_errors]


def edge(columns=10, rows=10, lit_from=5):
    """Dark on the left, lit on the right."""
    return np.broadcast_to(np.where(np.arange(columns) >= lit_from, 1.0, 0.0), (rows, columns)).copy()


def test_differences_of_known_images():
    reference = np.array([[0.0, 1.0], [0.5, 1.0]])
    image = np.array([[0.5, 1.0], [0.5, 0.0]])
    assert mae(image, reference) == 1.5 / 4
    assert rmse(image, reference) == pytest.approx(math.sqrt(1.25 / 4), rel=1e-15)
    assert psnr(image, reference) == pytest.approx(-10 * math.log10(1.25 / 4), rel=1e-14)
    mask = np.array([[True, True], [True, False]])
    assert mae(image, reference, mask) == pytest.approx(0.5 / 3, rel=1e-15)
    assert rmse(image, reference, mask) == pytest.approx(math.sqrt(0.25 / 3), rel=1e-15)


def test_equal_images_have_no_error():
    image = np.random.default_rng(0).uniform(size=(20, 30))
    assert (mae(image, image), rmse(image, image), psnr(image, image)) == (0, 0, math.inf)
    assert ssim(image, image) == pytest.approx(1, abs=1e-12)
    assert (false_shadow_rate(image, image), false_light_rate(image, image)) == (0, 0)


def test_ssim_of_constant_images_is_the_luminance_term():
    a, b = 0.25, 0.75
    expected = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    assert ssim(np.full((16, 12), a), np.full((16, 12), b)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("masked", [False, True])
def test_ssim_matches_its_definition_window_by_window(masked):
    rng = np.random.default_rng(1)
    x, y = rng.uniform(size=(2, 17, 14))
    mask = rng.uniform(size=x.shape) < 0.6 if masked else np.ones(x.shape, bool)
    values = []
    for row, column in np.argwhere(mask):
        r, c = np.ogrid[: x.shape[0], : x.shape[1]]
        w = np.exp(-((r - row) ** 2 + (c - column) ** 2) / (2 * 1.5**2)) * mask
        w = np.where((np.abs(r - row) <= 5) & (np.abs(c - column) <= 5), w, 0)
        w /= w.sum()
        mx, my = np.sum(w * x), np.sum(w * y)
        vx, vy, cov = np.sum(w * (x - mx) ** 2), np.sum(w * (y - my) ** 2), np.sum(w * (x - mx) * (y - my))
        top = (2 * mx * my + 0.01**2) * (2 * cov + 0.03**2)
        values.append(top / ((mx**2 + my**2 + 0.01**2) * (vx + vy + 0.03**2)))
    assert ssim(x, y, mask) == pytest.approx(np.mean(values), rel=1e-10)


def test_false_rates_count_a_pixel_by_the_light_it_is_wrong_about():
    reference, image = edge(), edge()
    image[2, 8] = 0.0  # acne
    image[3, 8] = 0.25  # acne, filtered
    image[4, 8] = 0.75
    image[5, 1] = 1.0  # a leak
    image[6, 1] = 0.5
    assert false_shadow_rate(image, reference) == 2 / 100
    assert false_light_rate(image, reference) == 1.5 / 100


@pytest.mark.parametrize(("band", "shadow", "light"), [(0, 10, 10), (1, 0, 10), (2, 0, 0)])
def test_false_rates_leave_out_a_band_along_the_edge(band, shadow, light):
    reference, image = edge(), edge()
    image[:, 5] = 0  # in touch with the edge
    image[:, 3] = 1  # one pixel further away
    assert false_shadow_rate(image, reference, band=band) == shadow / 100
    assert false_light_rate(image, reference, band=band) == light / 100


def test_penumbra_belongs_to_the_band_and_the_mask_makes_no_edge():
    reference = edge()
    reference[:, 5] = 0.5
    image = 1 - reference
    # Columns 0-4 are dark, 6-9 lit; a band of 1 leaves out columns 4 and 6.
    assert false_shadow_rate(image, reference) == 30 / 100
    assert false_light_rate(image, reference) == 40 / 100
    mask = np.zeros((10, 10), bool)
    mask[:, 6:] = True
    assert false_shadow_rate(image, reference, mask) == 1
    assert false_light_rate(image, reference, mask) == 0


@pytest.mark.parametrize("turn", [1, -1])
def test_penumbra_width_of_a_ramp(turn):
    # The ramp rises from 0 at x = 10 to 1 at x = 30.
    profile = np.clip((np.arange(50) - 10) / 20, 0, 1)[::turn]
    assert penumbra_width(profile) == pytest.approx(16, rel=1e-12)
    assert penumbra_width(profile, spacing=0.25) == pytest.approx(4, rel=1e-12)
    assert penumbra_width(profile, low=0.0, high=1.0) == pytest.approx(20, rel=1e-12)
    assert penumbra_width(profile, low=0.33, high=0.41) == pytest.approx(1.6, rel=1e-12)


def test_penumbra_width_of_a_hard_edge_is_within_a_sample():
    assert penumbra_width(np.array([0.0, 0.0, 1.0, 1.0])) == pytest.approx(0.8)


def test_penumbra_width_wants_a_step():
    with pytest.raises(ValueError, match=r"runs from 0\.3 to 1 and never rises from 0\.1 to 0\.9"):
        penumbra_width([0.3, 0.6, 1.0])
    with pytest.raises(ValueError, match=r"shape \(2, 2\)"):
        penumbra_width(np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"low is 0\.9 and high is 0\.1"):
        penumbra_width([0.0, 1.0], low=0.9, high=0.1)
    with pytest.raises(ValueError, match="spacing is 0"):
        penumbra_width([0.0, 1.0], spacing=0.0)


def test_measure_errors_gathers_the_single_metrics():
    rng = np.random.default_rng(3)
    reference, image = edge(), rng.uniform(size=(10, 10))
    mask = rng.uniform(size=(10, 10)) < 0.8
    errors = measure_errors(jnp.asarray(image), jnp.asarray(reference), jnp.asarray(mask), band=2)
    image = np.asarray(jnp.asarray(image))
    assert isinstance(errors, ShadowErrors)
    assert errors.as_dict() == {
        "rmse": rmse(image, reference, mask),
        "mae": mae(image, reference, mask),
        "ssim": ssim(image, reference, mask),
        "false_shadow_rate": false_shadow_rate(image, reference, mask, 2),
        "false_light_rate": false_light_rate(image, reference, mask, 2),
    }
    assert all(type(value) is float for value in errors.as_dict().values())


@pytest.mark.parametrize("metric", ALL)
def test_unfit_images_are_refused(metric):
    image = edge()
    with pytest.raises(ValueError, match=r"shape \(10, 10\) and the reference \(10, 9\)"):
        metric(image, image[:, 1:])
    with pytest.raises(ValueError, match=r"shape \(10,\)"):
        metric(image[0], image[0])
    with pytest.raises(ValueError, match="none of the 100 pixels"):
        metric(image, image, np.zeros((10, 10), bool))
    with pytest.raises(ValueError, match="type float64; expected booleans"):
        metric(image, image, np.ones((10, 10)))
    with pytest.raises(ValueError, match=r"reference holds values .* the first 255 at .* an image of 8 bits by 255"):
        metric(image, np.where(image > 0.5, 255, 0))
    spoilt = image.copy()
    spoilt[3, 4] = np.nan
    with pytest.raises(ValueError, match=r"visibility holds values .* 1, the first nan at row 3, column 4"):
        metric(spoilt, image)


@pytest.mark.parametrize("rate", [false_shadow_rate, false_light_rate, measure_errors])
@pytest.mark.parametrize("band", [-1, True])
def test_bands_that_are_no_number_of_pixels_are_refused(rate, band):
    with pytest.raises(ValueError, match=f"band is {band}"):
        rate(edge(), edge(), band=band)


def test_overlap_of_shadows_counts_dark_pixels():
    assert intersection_over_union(edge(lit_from=4), edge(lit_from=5)) == 0.8
    assert intersection_over_union(edge(lit_from=5), 1 - edge(lit_from=5)) == 0
    assert intersection_over_union(np.ones((2, 2)), np.ones((2, 2))) == 1


def test_self_intersections_are_pairs_of_faces_that_pass_through_each_other():
    level = [[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]
    through, above, beside = (
        [[x, 0, z], [x, 0.2, z + 1], [x, -0.2, z + 1]] for x, z in ((0, -0.5), (0, 0.5), (9, -0.5))
    )
    pair = np.arange(6).reshape(2, 3)
    for other, count in ((through, 1), (above, 0), (beside, 0), (level, 0)):
        assert count_self_intersections(np.array(level + other), pair) == count
        assert count_self_intersections(np.array(other + level), pair) == count
    # Faces with a common vertex do not count.
    assert count_self_intersections(np.array(level + through[1:]), np.array([[0, 1, 2], [0, 3, 4]])) == 0
    # Of all pairs in a soup of large and small faces, none is overlooked.
    rng = np.random.default_rng(0)
    soup = (
        rng.uniform(-1, 1, (30, 1, 3))
        + rng.normal(size=(30, 3, 3)) * np.where(np.arange(30) % 7, 0.4, 1.5)[:, None, None]
    )
    alone = [count_self_intersections(soup[[i, j]].reshape(6, 3), pair) for i in range(30) for j in range(i)]
    assert sum(alone) > 10
    assert count_self_intersections(soup.reshape(-1, 3), np.arange(90).reshape(30, 3)) == sum(alone)


def test_chamfer_distance_of_parallel_squares_is_their_distance():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    far = chamfer_distance((corners, faces), (corners + np.array([0, 0, 0.3]), faces), samples=40_000)
    assert far == pytest.approx(0.3, abs=1e-3)
    # Samples of one surface are half of 1 / sqrt(density) apart on average.
    assert chamfer_distance((corners, faces), (corners, faces), samples=40_000) == pytest.approx(0.0025, rel=0.1)
    # Nor does the number of faces: a hundred of them in a corner have no more samples than their area.
    step = 0.01
    fan = [[0.0, 0, 0], *([step, step * k / 100, 0] for k in range(101))]
    beside = corners + np.array([step, 0, 0])
    small, large = [[0, k + 1, k + 2] for k in range(100)], [[102, 103, 104], [102, 104, 105]]
    fine = np.concatenate([fan, beside]), np.array([*small, *large])
    assert chamfer_distance(fine, fine, samples=40_000) == pytest.approx(0.0025, rel=0.1)
    # Corners of a mesh do not count, only its surface.
    split = np.concatenate([corners, [[0.5, 0, 0]]]), np.array([[0, 4, 2], [4, 1, 2], [0, 2, 3]])
    assert chamfer_distance((corners, faces), split, samples=40_000) < 0.004


def test_flicker_is_the_change_of_the_error_and_not_of_the_shadow():
    truth = np.stack([edge(lit_from=k) for k in (3, 4, 5)])
    assert flicker(truth, truth) == 0
    # An error that stays is no flicker.
    assert flicker(truth * 0.5 + 0.25 * (1 - truth), truth * 0.5 + 0.25 * (1 - truth)) == 0
    off = truth.copy()
    off[1, 0, :4] = 0.4
    # Four of 100 pixels change by 0.4, there and back; the first three are dark, the fourth is not lit yet.
    assert flicker(off, truth) == pytest.approx(math.sqrt(4 * 0.4**2 / 100))
    mask = np.ones(truth.shape, bool)
    mask[1, 0] = False
    assert flicker(off, truth, mask) == 0


@pytest.mark.parametrize(
    ("shapes", "said"), [(((1, 4, 4),) * 2, "at least two frames"), (((2, 4, 4), (2, 4, 5)), "expected the same shape")]
)
def test_flicker_needs_frames_of_one_shape(shapes, said):
    with pytest.raises(ValueError, match=said):
        flicker(*map(np.zeros, shapes))


@pytest.mark.parametrize(
    "measure",
    [
        lambda x: rmse(x, np.ones((4, 4))),
        lambda x: flicker(np.ones((2, 4, 4)), jnp.stack([x, x])),
        lambda x: penumbra_width(x[0]),
        lambda x: intersection_over_union(x, np.ones((4, 4))),
        lambda x: count_self_intersections(x[:, :3], np.array([[0, 1, 2]])),
        lambda x: measure_aliasing(x, np.ones((4, 4), bool)),
    ],
)
def test_metrics_within_a_trace_are_refused_by_name(measure):
    with pytest.raises(
        ValueError, match=r"a metric was called inside jax.jit .or grad, or vmap.*written with jax.numpy"
    ):
        jax.grad(lambda x: measure(x * jnp.ones((4, 4))))(1.0)


def test_flicker_needs_pixels_that_count_in_both_frames():
    mask = np.zeros((2, 4, 4), bool)
    mask[0, 0], mask[1, 1] = True, True
    with pytest.raises(ValueError, match="no pixel of the mask in common"):
        flicker(np.zeros((2, 4, 4)), np.zeros((2, 4, 4)), mask)
