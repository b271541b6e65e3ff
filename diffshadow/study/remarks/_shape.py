"""What a fit of a shape comes to, in words, and reasons not to rely on it."""

from collections.abc import Iterator

import numpy as np

from ..._words import counted
from ...fit import FittedShape
from ..record._runs import BEST_ALREADY, ShapeMetrics, Verdict
from ._course import STILL_FALLING


def shape_verdict(result: FittedShape, measured: ShapeMetrics) -> Verdict:
    """The verdict of a fit of a shape.

    **Arguments:** `measured`: how close it is.
    """
    overlap = f"{np.mean([light.rays for light in measured.lights]):.1%}"
    if result.chosen < 0:
        kind = BEST_ALREADY
        text = (
            f"no phase ended better than the start, which is the result: its shadows overlap their targets to {overlap}"
        )
    else:
        kind, before = "fitted", np.mean([light.before for light in measured.lights])
        steps = counted(len(result.history), "step")
        text = f"the shadows overlap their targets to {overlap} by rays, from {before:.1%}, in {steps}"
    if measured.unseen:
        unseen = np.mean([light.rays for light in measured.unseen])
        text += f", and to {unseen:.1%} under lights that the fit has not seen"
    if measured.chamfer is not None and measured.size is not None:
        text += f"; the shape is {measured.chamfer / measured.size:.2%} of its size from the truth on average"
    pairs, remedies = measured.self_intersections, []
    if pairs:
        text += f"; the surface intersects itself in {counted(pairs, 'pair')} of faces"
        remedies = [
            "raise normal_consistency of the phases of fit.shape, to 0.001 for example, for a surface that crosses "
            "itself less"
        ]
    return Verdict(kind=kind, sentence=text, remedies=remedies)


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
