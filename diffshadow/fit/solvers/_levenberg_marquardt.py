"""Levenberg's and Marquardt's method with Nielsen's damping, as a solver of optimistix."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float

from ._settings import Stop

# The first step's damping, relative to the largest squared norm of a column of the Jacobian.
_FIRST_DAMPING = 0.01
# The first of several rejected steps shortens the next step by this factor. A good step lengthens it by at most the
# second factor.
_SHRINK, _MAX_GROWTH = 2.0, 3.0
# A fit with a noisy loss ends when the predicted reduction of a full step is less than this fraction of the noise.
_MIN_GAIN = 1e-3
# Added to the squares of the Jacobian's columns, relative to them, so that parameters with the same effect do no harm.
_RIDGE = 1e-6


class _State(eqx.Module):
    """`step_size` is 1 / μ; `shrink` is ν."""

    step_size: Array
    shrink: Array


class NielsenDamping(optx.AbstractSearch):
    """The damping of H. B. Nielsen, "Damping parameter in Marquardt's method" (1999).

    With ρ the actual reduction of the loss over the reduction by the linear model, the damping μ becomes

        μ · max(1/3, 1 - (2ρ - 1)³),  ν = 2    if ρ > 0, and the step is accepted
        μ · ν,                        ν = 2 ν  otherwise

    The `noise` of the loss, as a fraction of it, is added to both reductions: smaller changes carry no information, and
    the model is trusted there (Sun & Nocedal, "A trust region method for noisy unconstrained optimization",
    Mathematical Programming 202, 2023).
    """

    noise: float = 0.0

    def init(self, y: Array, f_info_struct: Any) -> _State:
        return _State(jnp.ones((), y.dtype), jnp.full((), _SHRINK, y.dtype))

    def step(
        self, first_step: Array, y: Array, y_eval: Array, f_info: Any, f_eval_info: Any, state: _State
    ) -> tuple[Array, Array, optx.RESULTS, _State]:
        noise = self.noise * f_info.as_min()
        predicted = noise - optx.ClassicalTrustRegion().predict_reduction(y_eval - y, f_info)
        actual = noise + f_info.as_min() - f_eval_info.as_min()
        accept = first_step | ((predicted > 0) & (actual > 0))
        ratio = actual / jnp.where(predicted > 0, predicted, 1)
        longer = state.step_size / jnp.maximum(1 / _MAX_GROWTH, 1 - (2 * ratio - 1) ** 3)
        steepest = jnp.max(jnp.sum(f_eval_info.jac.as_matrix() ** 2, axis=0))
        first = 1 / jnp.where(steepest > 0, _FIRST_DAMPING * steepest, 1)
        size = jnp.where(first_step, first, jnp.where(accept, longer, state.step_size / state.shrink))
        return size, accept, optx.RESULTS.successful, _State(size, jnp.where(accept, _SHRINK, 2 * state.shrink))


def _gain(jacobian: Float[Array, "n p"], residual: Float[Array, " n"]) -> Float[Array, ""]:
    """The greatest fraction by which a sum of squares can fall if residuals are linear.

    It is the squared cosine of the angle between the residual and the tangents, and zero at the best fit (Bates &
    Watts, "A relative offset orthogonality convergence criterion for nonlinear least squares", Technometrics 23, 1981).
    """
    along = jnp.matmul(jacobian.T, residual, precision="highest")
    square = jnp.matmul(jacobian.T, jacobian, precision="highest")
    eye = jnp.eye(along.size, dtype=along.dtype)
    length = jnp.sqrt(jnp.sum(square * eye, axis=0))
    scale = jnp.where(length > 0, 1 / length, 0)
    cosines = square * scale * scale[:, None] + jnp.where(length > 0, _RIDGE, 1) * eye
    factor = jax.lax.linalg.cholesky(cosines, symmetrize_input=False)
    # With L Lᵀ for the cosines, aᵀ (L Lᵀ)⁻¹ a is |L⁻¹ a|².
    part = jax.lax.linalg.triangular_solve(factor, (along * scale)[:, None], left_side=True, lower=True)
    total = jnp.sum(residual**2)
    return jnp.sum(part**2) / jnp.where(total > 0, total, 1)


class LevenbergMarquardt(optx.AbstractGaussNewton):
    """optimistix's solver, with Nielsen's damping. It also ends if the step after a rejected step would be short.

    This is MINPACK's `xtol`. optimistix ends only after an accepted step. There may be none if the minimum is at a jump
    of the loss, such as where a pixel changes from lit to shadowed. With `noise`, a fraction of the loss, the solver
    ends where the model predicts almost no reduction. `stop` ends it sooner.
    """

    rtol: float
    atol: float
    norm: Callable[[Any], Array]
    descent: optx.AbstractDescent
    search: optx.AbstractSearch
    verbose: Callable[..., None]
    noise: float
    stop: Stop

    def __init__(
        self,
        rtol: float,
        atol: float,
        verbose: Callable[..., None],
        noise: float = 0.0,
        stop: Stop = Stop(),  # noqa: B008
    ):
        self.rtol, self.atol, self.norm, self.verbose = rtol, atol, optx.max_norm, verbose
        self.stop = stop
        self.descent = optx.DampedNewtonDescent(linear_solver=lx.QR())
        self.search, self.noise = NielsenDamping(noise), noise

    def terminate(
        self, fn: Any, y: Float[Array, " p"], args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Array, optx.RESULTS]:
        done, result = super().terminate(fn, y, args, options, state, tags)
        short = jnp.abs(state.y_eval - y) < jnp.maximum(self.stop.shortest, self.atol + self.rtol * jnp.abs(y))
        accepted = state.num_steps_since_acceptance == 0
        gain = _gain(state.f_info.jac.as_matrix(), state.f_info.residual)
        least = jnp.maximum(self.stop.least_gain, _MIN_GAIN if self.noise > 0 else 0.0)
        flat = accepted & ~state.first_step & (gain < least)
        return done | (jnp.all(short) & ~accepted) | flat, result
