"""Penumbra width."""

import numpy as np
from numpy.typing import ArrayLike

from ._inputs import check_on_host


def penumbra_width(profile: ArrayLike, spacing: float = 1.0, low: float = 0.1, high: float = 0.9) -> float:
    """Width of the transition from dark to light in a `profile` across a shadow's edge.

    **Arguments:**

    - `profile`: (n,), visibility along a line that crosses one edge, in either direction.
    - `spacing`: the distance between neighbouring samples, in any unit.
    - `low`, `high`: the visibilities between which the width is measured, 0 <= low < high <= 1.

    **Returns:** the distance, in the unit of `spacing`, from where the profile last leaves `low` to where it first
    reaches `high`, interpolated linearly between samples.

    **Raises** `ValueError` if the profile has no such transition, or an argument is out of range.
    """
    check_on_host(profile)
    values = np.asarray(profile, dtype=np.float64)
    if values.ndim != 1 or len(values) < 2 or not np.isfinite(values).all():
        raise ValueError(
            f"the profile has shape {values.shape}; expected (n,) with at least 2 samples, all of them finite"
        )
    if not 0 <= low < high <= 1:
        raise ValueError(f"low is {low} and high is {high}; expected 0 <= low < high <= 1")
    if not spacing > 0:
        raise ValueError(f"spacing is {spacing}; expected a positive distance between samples")
    if values[0] > values[-1]:
        values = values[::-1]
    bright = np.flatnonzero(values >= high)
    dark = np.flatnonzero(values[: bright[0]] <= low) if len(bright) else bright
    if not len(dark):
        raise ValueError(
            f"the profile runs from {values.min():.4g} to {values.max():.4g} and never rises from {low} to {high}; "
            "expected it to cross one shadow edge: make it longer, or move low and high closer together"
        )
    first, last = int(bright[0]), int(dark[-1])
    # Each crossing lies between this sample and its neighbour inside the transition.
    end = first - (values[first] - high) / (values[first] - values[first - 1])
    begin = last + (low - values[last]) / (values[last + 1] - values[last])
    return float((end - begin) * spacing)
