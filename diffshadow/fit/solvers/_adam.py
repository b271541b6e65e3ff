"""Adam (Kingma & Ba, "Adam: a method for stochastic optimization", ICLR 2015), as a descent for optimistix."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from ..._arithmetic import as_float, as_int

_MEAN_DECAY, _SQUARE_DECAY = 0.9, 0.99
_LEAST = 1e-8


class _State(eqx.Module):
    """Running means of the gradient and of its square, and their number of updates."""

    mean: Float[Array, " p"]
    square: Float[Array, " p"]
    count: Array


class _Descent(optx.AbstractDescent):
    """Steps of Adam, whose length falls to 0 along half a cosine over `steps`.

    - `report`: called with every loss and its position.
    """

    report: Any
    steps: int = eqx.field(static=True)

    def init(self, y: Array, f_info_struct: Any) -> _State:
        return _State(jnp.zeros_like(y), jnp.zeros_like(y), as_int(0))

    def query(self, y: Array, f_info: Any, state: _State) -> _State:
        self.report(loss_this_step=("", f_info.f), y=("", y))
        mean = _MEAN_DECAY * state.mean + (1 - _MEAN_DECAY) * f_info.grad
        square = _SQUARE_DECAY * state.square + (1 - _SQUARE_DECAY) * f_info.grad**2
        return _State(mean, square, state.count + 1)

    def step(self, step_size: Array, state: _State) -> tuple[Array, optx.RESULTS]:
        # Both means start from 0; dividing by the sum of their weights corrects for it.
        weight = lambda decay: 1 - decay ** state.count.astype(state.mean.dtype)
        root = jnp.sqrt(state.square / weight(_SQUARE_DECAY)) + _LEAST
        shrunk = step_size * (1 + jnp.cos(jnp.pi * jnp.minimum(state.count / self.steps, 1))) / 2
        return -shrunk * state.mean / weight(_MEAN_DECAY) / root, optx.RESULTS.successful


class Adam(optx.AbstractGradientDescent):
    """A first-order minimiser for optimistix.

    - `rtol`, `atol`, `norm`: the tolerances and the norm of its termination, as for all solvers of optimistix.
    """

    rtol: float
    atol: float
    norm: Callable[[Any], Array]
    descent: optx.AbstractDescent
    search: optx.AbstractSearch

    def __init__(self, learning_rate: float, steps: int, rtol: float, atol: float, report: Any):
        self.rtol, self.atol, self.norm = rtol, atol, optx.max_norm
        self.descent = _Descent(report, steps)
        self.search = optx.LearningRate(as_float(learning_rate))
