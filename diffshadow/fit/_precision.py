"""The precision of fitted values: how well an image determines them."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float
from scipy.ndimage import gaussian_filter

from .._arithmetic import as_float
from .._types import HostArray
from .problems import REACH_OF_BLUR, Joint

# A combination of parameters is undetermined if it changes the image by less than this fraction of the best
# combination's change, or if its standard deviation exceeds this fraction of the distance between its bounds.
_MIN_EFFECT = 1e-3
_MAX_SPREAD = 0.1
# A parameter belongs to a combination if its component is at least this fraction of the largest.
_PART = 0.3
# The distance within which residuals are correlated, in standard deviations of the blur. It covers a texel, because all
# pixels of a texel share its error of the outline.
_CORRELATED = 4


# The shifts of the grid of texels for the other drawings, in texels. With the unshifted grid, they form a lattice with
# each of five fractions of a texel once along either axis.
_SHIFTS = ((0.2, 0.4), (0.4, -0.2), (-0.4, 0.2), (-0.2, -0.4))


class Precision(NamedTuple):
    """The covariance of fitted values, to first order, from the Jacobian at the end of the phase that was chosen.

    Let `r` be the pixels' residuals, `J` their derivatives and `B` the blur under which they are compared. The error of
    a least-squares fit is (JᵀB²J)⁻¹ JᵀB² r. Errors of the model dominate the residuals; the noise of the reference is
    far smaller. The covariance is the sum of three parts.

    *The scatter of the residuals.* This is the sandwich (JᵀB²J)⁻¹ S (JᵀB²J)⁻¹ with S the covariance of the score
    g = Σᵢ sᵢ, sᵢ = (B²J)ᵢ rᵢ. A texel moves an outline equally for all pixels that see it, so neighbours are
    correlated. S is therefore the estimate of Conley, "GMM estimation with cross sectional dependence", Journal of
    Econometrics 92 (1999),

        S = Σᵢⱼ w(xᵢ - xⱼ) w(yᵢ - yⱼ) sᵢ sⱼᵀ,   w(d) = max(0, 1 - |d| / L),

    which is a mean over all offsets of a grid of L x L pixels. For each offset, the sums over the grid's cells are
    treated as independent. L is four times the blur's standard deviation, which covers a texel. With L = 1, without
    blur, this is the estimate of White, "A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48
    (1980).

    *The remaining step.* Pixels jump from lit to shadowed as poses move, so a fit ends near the minimum rather than at
    it. The square δδᵀ of the step δ = -(JᵀB²J)⁻¹ g is an estimate of that error.

    *Other grids of texels.* The position of the map's texels is arbitrary, and a caster as thin as a texel looks
    different on every grid. At the end of a fit of lights or meshes, maps are therefore drawn again with K = 4 grids
    that are shifted by a fraction of a texel. Grid k has the residuals rₖ and the step δₖ = -(JᵀB²J)⁻¹ JᵀB² rₖ. To
    first order, the fit would have ended at this distance on that grid. The mean (1/K) Σₖ δₖ δₖᵀ is the third part.

    Fits of a technique alone do not draw maps again, so they lack the third part. Maps without a regular grid of texels
    use δδᵀ as the third part: warped maps, and maps with pages or with cascades of several sizes. Deviations for
    casters thinner than a texel are then too small.

    - `names`: the parameters whose gradient is not zero throughout.
    - `deviations`: their standard deviations, in their units; large for undetermined parameters.
    - `correlations`: (p, p), in [-1, 1].
    - `undetermined`: each entry names the parameters of a combination that the image hardly depends on.
    """

    names: tuple[str, ...]
    deviations: dict[str, float]
    correlations: list[list[float]]
    undetermined: list[tuple[str, ...]]


def on_grids(
    joint: Joint, own: Sequence[Float[Array | HostArray, "..."]], roots: Float[HostArray, " v"]
) -> list[Float[HostArray, "k _ _"]]:
    """The differences at the end of a phase, (k, h, w) for each image: first with the maps' own grids of texels and
    then, in fits of lights or meshes, with shifted grids.

    **Arguments:**

    - `joint`: the joint problem of the phase, with the values at its end.
    - `own`: its differences with the maps' own grids, with the loss's weights.
    - `roots`: (v,), roots of these weights.
    """
    grids = [_each_image(own)]
    for shift in _SHIFTS if joint.moves else ():
        # Not one program, because its parts share the programs of all other drawings.
        moved = joint.each(lambda problem, shift=shift: dataclasses.replace(problem, shift=as_float(shift)))
        differences, overflow = moved.differences(moved.subject)
        # If silhouettes exceed their memory on another grid, the estimate omits that grid.
        if not overflow:
            grids.append([image * root for image, root in zip(_each_image(differences), roots, strict=True)])
    return [np.stack(images) for images in zip(*grids, strict=True)]


def _each_image(images: Sequence[Float[Array | HostArray, "..."]]) -> list[Float[HostArray, "_ _"]]:
    return [image for several in images for image in np.asarray(several)]


def precision_of(
    names: Sequence[str],
    differences: Sequence[Float[HostArray, "k _ _"]],
    slopes: Sequence[Float[HostArray, "p _ _"]],
    blurs: Sequence[float],
    span: Float[HostArray, " p"],
    channels: int = 1,
) -> Precision:
    """The precision of a least-squares fit to several images.

    **Arguments:**

    - `differences`: (k, h, w), the residuals of each image before the blur: first on the map's own grid, and then on
      any other grids.
    - `slopes`: (p, h, w), their derivatives with respect to each parameter as a fraction of the distance `span` (p,)
      between its bounds.
    - `blurs`: standard deviation, in pixels, of the Gaussian under which each image is compared; 0 for none.
    - `channels`: the number of consecutive images that are the channels of one picture. Their residuals are correlated.
    """
    images = list(zip(differences, slopes, blurs, strict=True))
    if not all(np.isfinite(difference).all() and np.isfinite(slope).all() for difference, slope, _ in images):
        return Precision((), {}, [], [])
    used = [i for i in range(len(names)) if any(np.any(slope[i]) for slope in slopes)]
    kept = tuple(names[i] for i in used)
    if not used:
        return Precision((), {}, [], [])
    blurred = [_blurred(slope[used], blur) for _, slope, blur in images]
    columns = np.concatenate([each.reshape(len(used), -1) for each in blurred], axis=1).T
    # One column for each grid.
    residuals = np.concatenate([_blurred(each, blur).reshape(len(each), -1) for each, _, blur in images], axis=1).T
    scores = [each[0] * _blurred(slope, blur) for (each, _, blur), slope in zip(images, blurred, strict=True)]
    pictures = [np.sum(scores[i : i + channels], axis=0) for i in range(0, len(scores), channels)]
    scatter = np.concatenate(
        [_root_of_covariance(score, blur) for score, blur in zip(pictures, blurs[::channels], strict=True)], axis=1
    )
    _, effect, ways = np.linalg.svd(np.linalg.qr(columns, mode="r"), full_matrices=False)
    # Along the principal directions, from the best determined to the worst. A fit with zero residuals is exact.
    inverse = 1 / np.maximum(effect, _NO_EFFECT) ** 2
    steps = inverse[:, None] * (ways @ (columns.T @ residuals))
    steps[:, 1:] /= max(steps.shape[1] - 1, 1) ** 0.5
    # The covariance is the product of this and its transpose, so it is positive even if a combination has almost no
    # effect.
    root = np.column_stack([inverse[:, None] * (ways @ scatter), steps])
    lost = (effect < _MIN_EFFECT * effect[0]) | (np.linalg.norm(root, axis=1) > _MAX_SPREAD)
    undetermined = []
    for way in np.abs(ways[lost]):
        group = tuple(name for name, part in zip(kept, way, strict=True) if part >= _PART * way.max())
        if group not in undetermined:
            undetermined.append(group)
    root = ways.T @ root
    covariance, deviation = root @ root.T, np.linalg.norm(root, axis=1)
    product = np.outer(deviation, deviation)
    correlation = np.divide(covariance, product, out=np.eye(len(used)), where=product > 0)
    deviations = dict(zip(kept, (deviation * np.asarray(span)[used]).tolist(), strict=True))
    return Precision(kept, deviations, np.clip(correlation, -1, 1).tolist(), undetermined)


# Smaller effects are raised to this value, so that the squares of their inverses are finite.
_NO_EFFECT = 1e-50


def _blurred(images: Float[HostArray, "n h w"], deviation: float) -> Float[HostArray, "n h w"]:
    wide = np.asarray(images, np.float64)
    return gaussian_filter(wide, (0, deviation, deviation), mode="constant", truncate=REACH_OF_BLUR)


def _root_of_covariance(scores: Float[HostArray, "p h w"], blur: float) -> Float[HostArray, "p n"]:
    """A matrix R, where R Rᵀ is the covariance of the sum of `scores` over all pixels with correlated neighbours."""
    side = max(1, round(_CORRELATED * blur))
    # Sums over every square of `side` x `side` pixels that overlaps the image, as differences of running sums.
    padded = np.pad(scores, ((0, 0), (side, side - 1), (side, side - 1)))
    running = padded.cumsum(axis=1).cumsum(axis=2)
    rows = running[:, side:] - running[:, :-side]
    return (rows[:, :, side:] - rows[:, :, :-side]).reshape(len(scores), -1) / side
