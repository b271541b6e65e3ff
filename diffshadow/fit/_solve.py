"""The compiled program of a phase: least squares from the free values of its parameters to their best."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from ..shadow import Overflow
from ._history import Report, report_overflow
from ._parameters import Parameters
from .problems import Images, Joint, multiplied, products, squares
from .solvers import Solver, Stop, optimistix_options, optimistix_solver

Stacks = tuple[Float[Array, "..."], ...]
"""The derivatives of images by each parameter, (p, n, h, w)."""


class Solution(NamedTuple):
    """The end of a phase.

    Derivatives are with respect to each parameter's fraction of the distance between its bounds: comparable, and free
    of the change of variables.

    - `value`: (a,), the free values of the active parameters.
    - `gradient`: (a,), of the mean square of the compared differences.
    - `slope`: (a,), norms of the columns of the residuals' Jacobian, 0 where a parameter changes nothing.
    - `differences`, `slopes`: of each problem, (n, h, w) and (a, n, h, w), before the blur, with the loss's weights.
    - `roots`: (v,), of these weights.
    """

    value: Float[Array, " a"]
    gradient: Float[Array, " a"]
    slope: Float[Array, " a"]
    differences: Images
    slopes: Stacks
    roots: Float[Array, " v"]
    steps: Array
    result: optx.RESULTS


def _solve(
    joint: Joint, parameters: Parameters, y: Array, solver: Solver, token: Array, scale: Array, stop: Stop
) -> Solution:
    def residual(y: Array, args: tuple[Joint, Parameters, Array]) -> tuple[Array, tuple[Images, Stacks, Array]]:
        # A solver needs several products with the Jacobian. As a linear function it would be compiled, and evaluated,
        # once for each; here it is a matrix, found once together with the residuals.
        joint, parameters, scale = args
        fraction = parameters.fraction(y)
        fixed = jax.lax.stop_gradient(fraction)
        differences, slopes, overflow = _with_slopes(joint, parameters, fixed)
        if joint.moves:
            report_overflow(token, overflow, y)
        compared, sloping = joint.compared(differences), jax.vmap(joint.compared)(slopes)
        roots, curvature_rows = _weights(joint, compared, sloping)
        weighted = lambda stacks: jax.vmap(lambda images: multiplied(images, roots))(stacks)
        change = fraction - fixed
        along = jnp.matmul(_columns(weighted(sloping)), change, precision="highest")
        rows = [_flat(multiplied(compared, roots)) + along]
        if curvature_rows is not None:
            rows.append(jnp.matmul(curvature_rows, change, precision="highest"))
        return scale * jnp.concatenate(rows), (multiplied(differences, roots), weighted(slopes), roots)

    solution = optx.least_squares(
        residual,
        optimistix_solver(solver, Report(token), stop),
        y,
        (joint, parameters, scale),
        optimistix_options(solver),
        has_aux=True,
        max_steps=solver.max_steps,
        throw=False,
    )
    differences, slopes, roots = solution.state.aux
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


def _weights(joint: Joint, compared: Images, slopes: Stacks) -> tuple[Float[Array, " v"], Float[Array, "v p"] | None]:
    """The roots of the loss's weights, and the rows that stand for their change."""
    errors = squares(compared)
    gradients = 2 * jax.vmap(lambda slope: products(compared, slope), out_axes=1)(slopes)
    return jnp.sqrt(joint.loss.weights(errors, joint.shares)), joint.loss.curvature_rows(
        errors, joint.shares, gradients
    )


def _with_slopes(joint: Joint, parameters: Parameters, fraction: Float[Array, " p"]) -> tuple[Images, Stacks, Overflow]:
    """All differences at a `fraction` (p,) of the distance between the bounds, and their derivatives by each.

    **Returns:** images (n, h, w), stacks of them (p, n, h, w), and whether silhouettes are missing from a map.
    """

    def differences(fraction: Array) -> tuple[Images, Overflow]:
        return joint.differences(parameters.put(joint.subject, parameters.at(fraction)))

    # Few parameters, many pixels: forward.
    pushed = jax.vmap(lambda way: jax.jvp(differences, (fraction,), (way,), has_aux=True), out_axes=(None, 0, None))
    return pushed(jnp.eye(fraction.shape[0], dtype=fraction.dtype))


def _flat(images: Images) -> Float[Array, " n"]:
    return jnp.concatenate([image.ravel() for image in images])


def _columns(stacks: Stacks) -> Float[Array, "n p"]:
    return jnp.concatenate([stack.reshape(stack.shape[0], -1) for stack in stacks], axis=1).T


solve: Any = eqx.filter_jit(_solve)
"""`solve(joint, parameters, y, solver, token, scale, stop)`: a phase from the free values `y`.

`token` names the reporter of its steps, and `scale` multiplies the residuals.
"""
