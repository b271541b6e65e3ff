"""Bounded searches for numbers with respect to which the error has no derivative."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from .._types import HostArray

Box = Float64[HostArray, " a"]


class Least(NamedTuple):
    """The least error of a search, its place (a,), and how many errors were evaluated."""

    error: float
    values: Box
    evaluations: int


def search(
    error: Callable[[Box], float], start: Box, lower: Box, upper: Box, evaluations: int, part: float = 1.0
) -> Least:
    """The least error of a search: of about `evaluations` places within the bounds, and `start`.

    It is found by DIRECT (Jones, Perttunen & Stuckman 1993; Gablonsky & Kelley 2001), which divides the box into ever
    smaller ones about its best points. It needs no derivative, and jumps of the error do no harm.

    **Arguments:**

    - `start`, `lower`, `upper`: (a,).
    - `part`: the part of the box around `start` that is searched; 1 for the whole box.
    """
    from scipy.optimize import direct  # here, since it takes long to load

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
