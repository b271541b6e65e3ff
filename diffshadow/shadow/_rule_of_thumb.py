"""The rule of thumb for the bias of a filter."""

import math

import numpy as np

from .._arithmetic import concrete
from ..settings import rules
from .biases import AbstractBias, Bias, ReceiverPlane
from .filters import AbstractFilter


def bias_for(filter: AbstractFilter, plane: AbstractBias | None = None, *, across: float = math.inf) -> Bias:
    """The bias for a filter that works in many scenes. A configuration without a bias uses this rule.

    The rule of thumb was measured over a collection of scenes. It has a constant bias, a slope bias and, under wide
    filters, a normal offset. A fit to a scene has a lower error. The documentation's page on rules of thumb has
    figures.

    **Arguments:**

    - `plane`: a `ReceiverPlane()` that is a part of the bias. The other parts are then smaller. A `ReceiverPlane` with
        other numbers was not measured. With a plane or an `AdaptiveBias`, the other parts are 0.

    **Raises** `ValueError` for a filter with a traced radius.

    !!! Example

        ```python
        filter = shadow.RandomDisk(3.0)
        bias = shadow.bias_for(filter)
        f"{bias.constant.value:.1f} and {bias.slope.value:.1f} texels"  # 2.5 and 2.2 texels
        ```
    """
    if not across > 0:
        raise ValueError(f"across is {across:g}; expected more than 0 texels, or leave it out")
    if plane is not None and not _is_measured(plane):
        return Bias(plane=plane)
    reach = filter.reach
    if reach is None and issubclass(filter.settings, rules.MEASURED):
        raise ValueError(
            "bias_for was called inside jax.jit (or grad, or vmap) for a filter with a traced radius; expected a "
            "known radius: make the bias outside"
        )
    numbers = rules.bias_of(filter.settings, reach or 0.0, plane=plane is not None, across=across)
    return Bias(*numbers, plane=plane)


def _is_measured(plane: AbstractBias) -> bool:
    """Whether rules were measured with such a plane."""
    if not isinstance(plane, ReceiverPlane):
        return False
    return plane.limit is None and plane.deepening is None and not np.any(concrete(plane.fudge))
