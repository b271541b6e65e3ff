"""The steps of a fit, reported while it runs."""

import contextlib
import itertools
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._arithmetic import as_int
from .._progress import Update
from ..shadow import Overflow
from ._parameters import Parameters


class Step(NamedTuple):
    """One evaluation of the loss during a fit.

    - `phase`: number of the phase, from 0; `step`: number of the step within the phase, from 0; `width`: width of the
      soft compare, in texels; 0 for the hard compare.
    - `loss`: the mean square error under that compare, or a user's loss; `values`: the parameters' values there.
    - `start`: the number of the current start, from 0.
    """

    phase: int
    step: int
    width: float
    loss: float
    values: tuple[float, ...]
    start: int = 0


def shown_steps(
    update: Update, phases: Sequence[Any], starts: int, is_own_loss: bool, on_step: Callable[[Step], None] | None
) -> Callable[[Step], None]:
    """Passes each step to `on_step`, and shows it with `update`. With several `starts`, the number of steps is unknown
    if only the best start runs some of the `phases`."""
    count = len(phases) * starts if starts == 1 or all(phase.shared for phase in phases) else None

    def show(step: Step) -> None:
        start = f"start {step.start + 1} of {starts}, " if starts > 1 else ""
        error = f"loss {step.loss:.5g}" if is_own_loss else f"RMSE {max(step.loss, 0) ** 0.5:.5f}"
        done = None if count is None else (step.start * len(phases) + step.phase) / count
        update(f"{start}phase {step.phase + 1} of {len(phases)}, step {step.step}, {error}", done)
        if on_step is not None:
            on_step(step)

    return show


class Report(eqx.Module):
    """optimistix calls this at every step. It passes the numbers to the reporter of `token`.

    `ordered`: whether JAX keeps the order. A program on several devices cannot keep an order. The first device reports,
    in its own order.
    """

    token: Array
    ordered: bool = eqx.field(static=True, default=True)

    def __call__(self, *, loss_this_step, y, **_):
        # Optimistix minimises half the sum of squares.
        jax.debug.callback(_dispatch, self.token, 2 * loss_this_step[1], y[1], ordered=self.ordered)


def report_loss(token: Array, loss: Array, y: Float[Array, " a"]) -> None:
    """Reports an evaluation of the `loss` at `y` at run time. `token` identifies the reporter.

    For solvers that do not call `Report`. A solver may evaluate several points at once, so reports come in the
    program's own order.
    """
    jax.debug.callback(_dispatch, token, loss, y)


def report_overflow(token: Array, overflow: Overflow, y: Float[Array, " a"]) -> None:
    """Reports at run time whether silhouettes were missing at `y`. `token` identifies the reporter."""
    jax.debug.callback(_dispatch_overflow, token, overflow, y)


_REPORTERS: dict[int, "Reporter"] = {}
_TOKENS = itertools.count()


def _dispatch(token, loss, y):
    reporter = _REPORTERS.get(int(token))
    if reporter is None:
        return
    try:
        reporter.add(float(loss), np.asarray(y))
    except BaseException as error:
        reporter.error = error
        raise


def _dispatch_overflow(token, overflow, y):
    reporter = _REPORTERS.get(int(token))
    if reporter is not None and overflow:
        reporter.add_overflow(np.asarray(y))


class Reporter:
    """Collects the steps of one fit. A compiled phase outlives its reporter, so the reporter is found by number.

    `with_offsets`: adds the parameters' offsets to the values of a step.
    """

    def __init__(
        self,
        parameters: Parameters,
        history: list[Step],
        on_step: Callable[[Step], None] | None,
        with_offsets: Callable[[tuple[float, ...]], tuple[float, ...]] = lambda values: values,
    ):
        self.lower, self.upper = np.asarray(parameters.lower), np.asarray(parameters.upper)
        self.history, self.on_step, self.with_offsets = history, on_step, with_offsets
        self.number = next(_TOKENS)
        self.token = as_int(self.number)
        self.start, self.phase, self.width, self.step, self.scale = 0, 0, 0.0, 0, 1.0
        self.free, self.active = np.zeros_like(self.lower), np.arange(self.lower.size)
        self.overflowed: list[tuple[float, ...]] = []
        self.error: BaseException | None = None
        self._known = len(history)

    def begin(self, phase: int, width: float, free: np.ndarray, active: np.ndarray, scale: float = 1.0) -> None:
        """Later steps belong to `phase`. The width of its soft compare is `width` texels.

        **Arguments:**

        - `free`: (p,), the free values of all parameters; `active`: the indices of parameters that the phase changes.
        - `scale`: scale of the residuals that the solver sees.
        """
        self.phase, self.width, self.step, self.scale = phase, width, 0, scale
        self.free, self.active = np.array(free), active
        self.overflowed.clear()
        self._known = len(self.history)

    def again(self) -> None:
        """Removes the steps of the current phase, which starts again."""
        del self.history[self._known :]
        self.overflowed.clear()
        self.step = 0

    def add(self, loss: float, y: np.ndarray) -> None:
        """Adds an evaluation of `loss` at the free values `y` (a,) of the active parameters.

        Values that are not finite are left out. Dogleg tries such values where the Jacobian is singular, for example on
        a bound, and then continues from the previous point.
        """
        if np.isfinite(y).all():
            self.record(loss / self.scale**2, self._values(y))

    def record(self, loss: float, values: tuple[float, ...]) -> None:
        """Adds an evaluation of `loss` at `values` (p,) of all parameters."""
        step = Step(self.phase, self.step, self.width, loss, self.with_offsets(values), self.start)
        self.step += 1
        self.history.append(step)
        if self.on_step is not None:
            self.on_step(step)

    def add_overflow(self, y: np.ndarray) -> None:
        """An evaluation at the free values `y` (a,) of the active parameters, at which silhouettes were missing."""
        self.overflowed.append(self._values(y))

    def _values(self, y: np.ndarray) -> tuple[float, ...]:
        # NumPy, because a callback must not wait for JAX.
        free = self.free.copy()
        free[self.active] = y
        return tuple((self.lower + (self.upper - self.lower) * (1 + np.sin(free)) / 2).tolist())

    @contextlib.contextmanager
    def own_errors(self) -> Iterator[None]:
        """Raises the error that `on_step` raised within a program. It replaces the error that JAX makes from it and
        logs."""
        log, is_foreign = logging.getLogger(jax.debug.callback.__module__), lambda _: self.error is None
        log.addFilter(is_foreign)
        try:
            yield
        except RuntimeError:
            if self.error is None:
                raise
            raise self.error from None
        finally:
            log.removeFilter(is_foreign)

    def __enter__(self) -> "Reporter":
        _REPORTERS[self.number] = self
        return self

    def __exit__(self, *_) -> None:
        _REPORTERS.pop(self.number, None)
