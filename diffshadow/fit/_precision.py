"""How well an image determines what was fitted to it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._types import HostArray

# A combination of parameters that moves the image by less than this share of what the best-seen one does, or whose
# standard deviation is more than this share of its bounds' distance, is not determined by it.
_LEAST_EFFECT = 1e-3
_MOST_SPREAD = 0.1
# A parameter belongs to a combination if its part is at least this share of the largest.
_PART = 0.3


class Precision(NamedTuple):
    """The covariance of fitted values, to first order, from the Jacobian at the end of the last phase.

    With `r` the pixels' residuals and `J` their derivatives it is (JᵀJ)⁻¹ Jᵀ diag(r²) J (JᵀJ)⁻¹ (White, "A
    heteroskedasticity-consistent covariance matrix estimator", Econometrica 48, 1980): residuals and derivatives are
    large at the same few pixels, those of the outlines. Where differences count blurred, by B, it is
    (JᵀB²J)⁻¹ JᵀB² diag(r²) B²J (JᵀB²J)⁻¹. It takes pixels for independent before they are blurred, which neighbours on
    one outline are only roughly.

    - `names`: of the parameters that it holds, those whose gradient is not zero throughout.
    - `deviations`: their standard deviations, in their units; not a number for what is not determined.
    - `correlations`: (p, p), in [-1, 1].
    - `undetermined`: each entry names the parameters of a combination that the image hardly depends on.
    """

    names: tuple[str, ...]
    deviations: dict[str, float]
    correlations: list[list[float]]
    undetermined: list[tuple[str, ...]]


def precision_of(
    names: Sequence[str],
    triangle: Float[HostArray, "p p"],
    scatter: Float[HostArray, "p p"],
    span: Float[HostArray, " p"],
) -> Precision:
    """The precision of a least-squares fit.

    **Arguments:**

    - `triangle`: (p, p), the factor R of `BJ`, with `J` the Jacobian of the residuals with respect to each parameter's
        share of the distance `span` (p,) between its bounds.
    - `scatter`: (p, p), JᵀB² diag(r²) B²J.
    """
    used = [int(i) for i in np.flatnonzero(np.abs(triangle).max(axis=0) > 0)]
    kept = tuple(names[i] for i in used)
    if not used or not (np.isfinite(triangle).all() and np.isfinite(scatter).all()):
        return Precision((), {}, [], [])
    _, effect, ways = np.linalg.svd(np.asarray(triangle, np.float64)[:, used], full_matrices=False)
    # Along the ways that the image tells best to worst, whose effects are independent. Where nothing is left to doubt,
    # the fit is exact and so are its values.
    inverse = 1 / np.maximum(effect, 1e-100) ** 2
    along = inverse[:, None] * (ways @ np.asarray(scatter, np.float64)[np.ix_(used, used)] @ ways.T) * inverse
    lost = (effect < _LEAST_EFFECT * effect[0]) | (np.sqrt(np.maximum(np.diag(along), 0)) > _MOST_SPREAD)
    undetermined = []
    for way in np.abs(ways[lost]):
        group = tuple(name for name, part in zip(kept, way, strict=True) if part >= _PART * way.max())
        if group not in undetermined:
            undetermined.append(group)
    covariance = ways.T @ along @ ways
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
    product = np.outer(deviation, deviation)
    correlation = np.divide(covariance, product, out=np.eye(len(used)), where=product > 0)
    deviations = dict(zip(kept, (deviation * np.asarray(span)[used]).tolist(), strict=True))
    return Precision(kept, deviations, np.clip(correlation, -1, 1).tolist(), undetermined)
