"""The compiled program of a phase: least squares from the free values of its parameters to their best values."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from ..shadow import Overflow
from ._history import Report, report_loss, report_overflow
from ._parameters import Parameters
from .problems import Images, Joint, compressed, multiplied, products, squares
from .solvers import Solver, Stop, optimistix_options, optimistix_solver

Stacks = tuple[Float[Array, "..."], ...]
"""The derivatives of images with respect to each parameter, (p, n, h, w)."""


class Solution(NamedTuple):
    """The end of a phase.

    Derivatives are with respect to each parameter as a fraction of the distance between its bounds. They are
    comparable, and independent of the change of variables.

    - `value`: (a,), the free values of the active parameters.
    - `gradient`: (a,), gradient of the mean square of the compared differences, or of a user's loss.
    - `slope`: (a,), norms of the columns of the residuals' Jacobian; 0 if a parameter changes nothing.
    - `differences`, `slopes`: each problem's differences (n, h, w) and their derivatives (a, n, h, w), before the blur,
      with the loss's weights.
    - `roots`: (v,), roots of these weights.

    The last three are empty with a user's loss.
    """

    value: Float[Array, " a"]
    gradient: Float[Array, " a"]
    slope: Float[Array, " a"]
    differences: Images
    slopes: Stacks
    roots: Float[Array, " v"]
    steps: Array
    result: optx.RESULTS


class _Own(NamedTuple):
    """The values of a user's loss at one point: the residuals of compared images, (n,), or the loss, (1,); and their
    derivatives with respect to each parameter's fraction, (n, a)."""

    rows: Float[Array, " n"]
    columns: Float[Array, "n a"]


_Evaluated = tuple[Images, Stacks, Float[Array, " v"]] | _Own
"""The values at one point: differences, slopes and roots as in `Solution`, or rows and columns of a user's loss."""


def _solve(
    joint: Joint, parameters: Parameters, y: Array, solver: Solver, token: Array, scale: Array, stop: Stop
) -> Solution:
    is_scalar = joint.own is not None and joint.own.is_scalar

    def evaluated(y: Array, args: tuple[Joint, Parameters, Array]) -> tuple[Array, _Evaluated, Overflow]:
        # A solver needs several products with the Jacobian. A linear function would be compiled and evaluated once for
        # each product. A matrix is computed once, together with the residuals.
        joint, parameters, scale = args
        fraction = parameters.fraction(y)
        fixed = jax.lax.stop_gradient(fraction)
        rows = _rows if joint.own is None else _rows_of_own
        found, known, overflow = rows(joint, parameters, fixed, fraction - fixed)
        # Optimistix minimises half the sum of squares.
        return scale**2 * found[0] / 2 if is_scalar else scale * found, known, overflow

    def residual(y: Array, args: tuple[Joint, Parameters, Array]) -> tuple[Array, _Evaluated]:
        found, known, overflow = evaluated(y, args)
        if joint.moves:
            report_overflow(token, overflow, y)
        if solver.method is not None:
            report_loss(token, 2 * found if is_scalar else jnp.sum(found**2), y)
        return found, known

    args: Any = joint, parameters, scale
    method: Any = optimistix_solver(solver, Report(token, joint.devices == 1), stop)
    options, until = optimistix_options(solver), {"max_steps": solver.max_steps, "throw": False}
    run = optx.minimise if is_scalar else optx.least_squares
    solution = run(residual, method, y, args, options, has_aux=True, **until)
    # The solvers of this package keep the values at their end. Others may not.
    known = solution.state.aux if solver.method is None else evaluated(solution.value, args)[1]
    if isinstance(known, _Own):
        end, jacobian = jnp.full(1, 0.5) if is_scalar else known.rows, known.columns
        differences, slopes, roots = (), (), jnp.zeros(0)
    else:
        differences, slopes, roots = known
        end, jacobian = _flat(joint.compared(differences)), _columns(jax.vmap(joint.compared)(slopes))
    return Solution(
        value=solution.value,
        gradient=2 * jnp.matmul(end, jacobian, precision="highest"),
        slope=jnp.sqrt(jnp.sum(jacobian**2, axis=0)),
        differences=differences,
        slopes=slopes,
        roots=roots,
        steps=solution.stats["num_steps"],
        result=solution.result,
    )


def _rows(
    joint: Joint, parameters: Parameters, fixed: Float[Array, " a"], change: Float[Array, " a"]
) -> tuple[Float[Array, " n"], _Evaluated, Overflow]:
    """The residuals at the fractions `fixed` + `change`, to first order in `change`, and the values at `fixed`."""
    differences, slopes, overflow = _with_slopes(joint, parameters, fixed)
    compared, sloping = joint.compared(differences), jax.vmap(joint.compared)(slopes)
    roots, curvature_rows = _weights(joint, compared, sloping)
    weighted = lambda stacks: jax.vmap(lambda images: multiplied(images, roots))(stacks)
    if joint.devices > 1:
        few, jacobian = compressed(multiplied(compared, roots), weighted(sloping), joint.devices)
        rows = [few + jnp.matmul(jacobian, change, precision="highest")]
    else:
        along = jnp.matmul(_columns(weighted(sloping)), change, precision="highest")
        rows = [_flat(multiplied(compared, roots)) + along]
    if curvature_rows is not None:
        rows.append(jnp.matmul(curvature_rows, change, precision="highest"))
    return jnp.concatenate(rows), (multiplied(differences, roots), weighted(slopes), roots), overflow


def _rows_of_own(
    joint: Joint, parameters: Parameters, fixed: Float[Array, " a"], change: Float[Array, " a"]
) -> tuple[Float[Array, " n"], _Evaluated, Overflow]:
    """Like `_rows`, for a user's loss. A scalar loss has its value, (1,), instead of residuals."""

    def rows(fraction: Array) -> tuple[Array, Overflow]:
        images, overflow = joint.rows(parameters.put(joint.subject, parameters.at(fraction)))
        if joint.own is not None and joint.own.is_scalar:
            return jnp.mean(jnp.concatenate(images), axis=0), overflow
        count = sum(len(each) for each in images)
        return jnp.concatenate([each.ravel() for each in images]) / count**0.5, overflow

    found, slopes, overflow = _pushed(rows, fixed)
    return found + jnp.matmul(slopes.T, change, precision="highest"), _Own(found, slopes.T), overflow


def _weights(joint: Joint, compared: Images, slopes: Stacks) -> tuple[Float[Array, " v"], Float[Array, "v p"] | None]:
    """The roots of the loss's weights, and the rows for the change of the weights."""
    errors = squares(compared)
    gradients = 2 * jax.vmap(lambda slope: products(compared, slope), out_axes=1)(slopes)
    return jnp.sqrt(joint.loss.weights(errors, joint.shares)), joint.loss.curvature_rows(
        errors, joint.shares, gradients
    )


def _with_slopes(joint: Joint, parameters: Parameters, fraction: Float[Array, " p"]) -> tuple[Images, Stacks, Overflow]:
    """All differences at a `fraction` (p,) of the distance between the bounds, and their derivatives with respect to
    each fraction.

    **Returns:** images (n, h, w), stacks of images (p, n, h, w), and whether silhouettes are missing from a map.
    """

    def differences(fraction: Array) -> tuple[Images, Overflow]:
        return joint.differences(parameters.put(joint.subject, parameters.at(fraction)))

    return _pushed(differences, fraction)


def _pushed(function: Callable[[Array], tuple[Any, Overflow]], fraction: Float[Array, " p"]) -> tuple[Any, Any, Any]:
    """The result of `function` at `fraction` (p,), its derivatives with respect to each fraction along a first axis,
    and its second result."""
    # Forward mode, because there are few parameters and many pixels.
    pushed = jax.vmap(lambda way: jax.jvp(function, (fraction,), (way,), has_aux=True), out_axes=(None, 0, None))
    return pushed(jnp.eye(fraction.shape[0], dtype=fraction.dtype))


def _flat(images: Images) -> Float[Array, " n"]:
    return jnp.concatenate([image.ravel() for image in images])


def _columns(stacks: Stacks) -> Float[Array, "n p"]:
    return jnp.concatenate([stack.reshape(stack.shape[0], -1) for stack in stacks], axis=1).T


solve: Any = eqx.filter_jit(_solve)
"""`solve(joint, parameters, y, solver, token, scale, stop)`: a phase from the free values `y`.

`token` identifies the reporter of its steps, and `scale` multiplies the residuals.
"""
