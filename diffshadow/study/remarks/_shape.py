"""What a fit of a shape comes to, in words, and reasons not to rely on it."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..._words import counted
from ...fit import FittedShape
from ._course import STILL_FALLING
from ._verdict import BEST_ALREADY, Verdict


def shape_verdict(result: FittedShape, measured: Mapping[str, Any]) -> Verdict:
    """The verdict of a fit of a shape.

    **Arguments:** `measured`: its metrics, as in `result.json`.
    """
    mean = lambda lights, key: float(np.mean([light[key] for light in lights]))
    lights, steps = measured["lights"], counted(len(result.history), "step")
    overlap = f"{mean(lights, 'rays'):.1%}"
    if result.chosen < 0:
        kind = BEST_ALREADY
        text = (
            f"no phase ended better than the start, which is the result: its shadows overlap their targets to {overlap}"
        )
    else:
        kind = "fitted"
        text = f"the shadows overlap their targets to {overlap} by rays, from {mean(lights, 'before'):.1%}, in {steps}"
    if measured.get("unseen"):
        text += f", and to {mean(measured['unseen'], 'rays'):.1%} under lights that the fit has not seen"
    if measured.get("chamfer") is not None:
        text += f"; the shape is {measured['chamfer'] / measured['size']:.2%} of its size from the truth on average"
    pairs, remedies = measured["self_intersections"], []
    if pairs:
        text += f"; the surface intersects itself in {counted(pairs, 'pair')} of faces"
        remedies = [
            "raise normal_consistency of the phases of fit.shape, to 0.001 for example, for a surface that crosses "
            "itself less"
        ]
    return Verdict(kind, text, remedies)


def shape_remarks(result: FittedShape) -> Iterator[str]:
    """A sentence if the error still fell at the end of the phase that gave the result."""
    losses = [loss for phase, loss in result.history if phase == result.chosen]
    if len(losses) < 2:
        return
    late = max(len(losses) // 4, 1)
    # By minima, since steps of this size may miss a little.
    early, least = min(losses[:-late]), min(losses)
    if early > 0 and 1 - least / early > STILL_FALLING:
        yield (
            f"the error still fell when phase {result.chosen + 1} ended, which gave the result, by "
            f"{1 - least / early:.0%} in its last {counted(late, 'step')}: raise its steps, "
            f"fit.shape.phases.{result.chosen}.steps"
        )
