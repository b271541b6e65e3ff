"""Bounded searches for numbers without a derivative of the error."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .._types import HostArray

Box = Float64[HostArray, " a"]


class Least(NamedTuple):
    """The lowest error of a search, its position (a,), and the number of evaluations."""

    error: float
    values: Box
    evaluations: int


def search(
    error: Callable[[Box], float], start: Box, lower: Box, upper: Box, evaluations: int, part: float = 1.0
) -> Least:
    """The lowest error of a search with about `evaluations` points within the bounds, and `start`.

    The search is DIRECT (Jones, Perttunen & Stuckman 1993; Gablonsky & Kelley 2001), which divides the box into ever
    smaller boxes around its best points. It needs no derivative, and jumps of the error do no harm.

    **Arguments:**

    - `start`, `lower`, `upper`: (a,).
    - `part`: the fraction of the box around `start` that is searched; 1 for the whole box.
    """
    from scipy.optimize import direct  # Imported here, because it is slow to load.

    tried: list[tuple[float, Box]] = []

    def evaluate(values: Box) -> float:
        tried.append((error(values), values.copy()))
        return tried[-1][0]

    evaluate(start)
    half = (upper - lower) * (part / 2)
    middle = np.clip(start, lower + half, upper - half)
    box = list(zip(middle - half, middle + half, strict=True))
    direct(evaluate, box, maxfun=evaluations, maxiter=evaluations, vol_tol=0, len_tol=0)
    least, values = min(tried, key=lambda one: one[0])
    return Least(least, values, len(tried))
