"""Problems of one structure as one, so that programs do not grow with their number."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._abstract import AbstractProblem
from ._technique import TechniqueProblem


class Stack(eqx.Module):
    """Fits of a technique to several images, evaluated one after another by one program.

    - `problems`: one problem whose arrays have a leading axis for the images.
    """

    problems: TechniqueProblem

    def difference(self, subject: Any) -> Float[Array, "n h w"]:
        """Those of all problems."""
        return jax.lax.map(lambda problem: problem.difference(subject), self.problems)

    @property
    def moves(self) -> bool:
        """False: maps and surfaces stay."""
        return False

    @property
    def count(self) -> Float[Array, " n"]:
        """How many pixels count in each."""
        return jax.vmap(lambda problem: problem.count)(self.problems)


def stacked(problems: Sequence[AbstractProblem]) -> tuple[AbstractProblem | Stack, ...]:
    """Fits of a technique that are of one structure as a `Stack`; all other problems as they are, in their order."""
    groups: dict[Any, list[AbstractProblem]] = {}
    for i, problem in enumerate(problems):
        leaves, structure = jax.tree.flatten(problem)
        key = (structure, *((leaf.shape, leaf.dtype) for leaf in leaves))
        groups.setdefault(key if isinstance(problem, TechniqueProblem) else i, []).append(problem)
    together = lambda group: Stack(jax.tree.map(lambda *leaves: jnp.stack(leaves), *group))
    return tuple(group[0] if len(group) == 1 else together(group) for group in groups.values())
