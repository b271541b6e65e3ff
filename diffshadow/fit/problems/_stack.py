"""Problems of one structure as one, so that programs do not grow with their number."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._abstract import AbstractProblem
from ._technique import TechniqueProblem

# The most images that are evaluated at once.
_AT_ONCE = 4


class Stack(eqx.Module):
    """Fits of a technique to several images, evaluated a few at a time by one program.

    - `problems`: one problem whose arrays have a leading axis for the images.
    """

    problems: TechniqueProblem

    def difference(self, subject: Any) -> Float[Array, "n h w"]:
        """Those of all problems."""
        images = self.problems.reference.shape[0]
        # A few at once keep all cores busy, and none is left over, which would be a second program.
        at_once = max(k for k in range(1, _AT_ONCE + 1) if images % k == 0)
        return jax.lax.map(lambda problem: problem.difference(subject), self.problems, batch_size=at_once)

    @property
    def moves(self) -> bool:
        """False: maps and surfaces stay."""
        return False

    @property
    def count(self) -> Float[Array, " n"]:
        """How many pixels count in each."""
        return jax.vmap(lambda problem: problem.count)(self.problems)


def stacked(problems: Sequence[AbstractProblem]) -> tuple[AbstractProblem | Stack, ...]:
    """Fits of a technique that are of one structure as a `Stack`; all other problems as they are."""
    alone = tuple(problem for problem in problems if not isinstance(problem, TechniqueProblem))
    groups = of_one_structure([problem for problem in problems if isinstance(problem, TechniqueProblem)])
    return (*(group[0] if len(group) == 1 else Stack(together(group)) for group in groups), *alone)


def of_one_structure(problems: Sequence[TechniqueProblem]) -> list[list[TechniqueProblem]]:
    """The problems in groups whose arrays have equal shapes, those of large images first."""
    groups: dict[Any, list[TechniqueProblem]] = {}
    for problem in problems:
        leaves, structure = jax.tree.flatten(problem)
        groups.setdefault((structure, *((leaf.shape, leaf.dtype) for leaf in leaves)), []).append(problem)
    # In one order, whichever problem comes first: programs depend on it.
    return sorted(groups.values(), key=lambda group: -group[0].reference.size)


def together(problems: Sequence[TechniqueProblem]) -> TechniqueProblem:
    """One problem whose arrays have a leading axis for the images."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *problems)
