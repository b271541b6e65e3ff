"""Problems of one structure as one, so that programs do not grow with their number."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_array, as_int
from ..._device import chunk_size
from ...shadow import Atlas, ShadowMap
from .._own_loss import Seen
from ._abstract import AbstractProblem
from ._technique import TechniqueProblem

# The most pixels of images that are evaluated at once, on a CPU and on a GPU.
_AT_ONCE = 1 << 14, 1 << 19
# The most texels of an atlas, whose indices are 32-bit numbers, and the most atlases that are kept: a fit of a layout
# draws its maps again and again.
_MAX_TEXELS, _MAX_ATLASES = (1 << 31) - 1, 4


Atlases = dict[tuple[int, ...], tuple[Atlas, Any]]
"""Atlases and their maps, by the maps' ids."""


class Stack(eqx.Module):
    """Fits of a technique to several images, evaluated a few at a time by one program.

    - `problems`: one problem whose arrays have a leading axis for the images.
    - `atlas`, `numbers`: where their maps are, (n,), if these can be in an atlas. The problems then hold no depths.
    """

    problems: TechniqueProblem
    atlas: Atlas | None = None
    numbers: Int[Array, " n"] | None = None

    @classmethod
    def of(cls, problems: Sequence[TechniqueProblem], atlas: Atlas | None, numbers: Sequence[int]) -> "Stack":
        """Of problems of one structure, whose maps have these `numbers` in the atlas."""
        if atlas is None:
            return cls(together(problems))
        bare = [eqx.tree_at(lambda p: p.shadow_map.depth, problem, None) for problem in problems]
        return cls(together(bare), atlas, as_int(numbers))

    def difference_and_overflow(self, subject: Any) -> tuple[Float[Array, "n h w"], None]:
        """The differences of all problems. Nothing is drawn that could overflow."""
        return self._of_each(lambda problem: problem.difference(subject)), None

    def seen(self, subject: Any) -> tuple[Seen, None]:
        """What a user's loss compares. Nothing is drawn that could overflow."""
        return self._of_each(lambda problem: problem.seen(subject)[0]), None

    def _of_each(self, function: Callable[[TechniqueProblem], Any]) -> Any:
        """What `function` makes of each problem with its map, along a first axis."""
        images, *sides = self.problems.reference.shape
        # Several small ones keep all cores busy, and none is left over, which would be a second program.
        most = max(chunk_size(*_AT_ONCE) // math.prod(sides), 1)
        at_once = max(k for k in range(1, min(most, images) + 1) if images % k == 0)

        def of_one(given: tuple[TechniqueProblem, Int[Array, ""] | None]) -> Any:
            problem, number = given
            if self.atlas is not None and number is not None:
                shadow_map: Any = problem.shadow_map
                problem = dataclasses.replace(problem, shadow_map=self.atlas.reading(shadow_map, number))
            return function(problem)

        return jax.lax.map(of_one, (self.problems, self.numbers), batch_size=at_once)

    def compared(self, differences: Float[Array, "n h w"]) -> Float[Array, "n h w"]:
        """All of them."""
        return differences

    @property
    def moves(self) -> bool:
        """False: maps and surfaces stay."""
        return False

    @property
    def count(self) -> Float[Array, " n"]:
        """How many pixels count in each."""
        return jax.vmap(lambda problem: problem.count)(self.problems)


def stacked(problems: Sequence[AbstractProblem], atlases: Atlases) -> tuple[AbstractProblem | Stack, ...]:
    """Fits of a technique that are of one structure as a `Stack`; all other problems as they are.

    **Arguments:** `atlases`: those made so far, which are used again.
    """
    alone = tuple(problem for problem in problems if not isinstance(problem, TechniqueProblem))
    own = [problem for problem in problems if isinstance(problem, TechniqueProblem)]
    groups = of_one_structure(own)
    return (*(group[0] if len(group) == 1 else _stack(group, own, atlases) for group in groups), *alone)


def stacked_order(problems: Sequence[AbstractProblem]) -> list[int]:
    """The indices of fits of a technique in the order in which `stacked` has them."""
    return [number for group in _numbers_of_one_structure(problems) for number in group]


def _stack(group: Sequence[TechniqueProblem], among: Sequence[TechniqueProblem], atlases: Atlases) -> Stack:
    """The stack of a group, which shares an atlas with all problems whose maps have its size."""
    like = group[0].shadow_map
    if not isinstance(like, ShadowMap) or like.silhouettes is not None:
        return Stack(together(group))
    maps: dict[int, Any] = {id(p.shadow_map): p.shadow_map for p in among if _fits(p.shadow_map, like)}
    if Atlas.size(len(maps), like.depth.shape) > _MAX_TEXELS:
        return Stack(together(group))
    numbers = {key: number for number, key in enumerate(maps)}
    if tuple(maps) not in atlases:
        # With the maps, so that their ids stay their own.
        atlases[tuple(maps)] = Atlas.of([*maps.values()]), maps
        while len(atlases) > _MAX_ATLASES:
            atlases.pop(next(iter(atlases)))
    atlas, _ = atlases[tuple(maps)]
    return Stack.of(group, atlas, [numbers[id(problem.shadow_map)] for problem in group])


def _fits(shadow_map: Any, like: ShadowMap) -> bool:
    """Whether a map may be in one atlas with another."""
    is_plain = isinstance(shadow_map, ShadowMap) and shadow_map.silhouettes is None
    return is_plain and shadow_map.depth.shape == like.depth.shape


def of_one_structure[P](problems: Sequence[P]) -> list[list[P]]:
    """The problems, or other modules with a `reference`, in groups whose arrays have equal shapes, large images
    first."""
    return [[problems[number] for number in group] for group in _numbers_of_one_structure(problems)]


def _numbers_of_one_structure(problems: Sequence[Any]) -> list[list[int]]:
    groups: dict[Any, list[int]] = {}
    for number, problem in enumerate(problems):
        leaves, structure = jax.tree.flatten(problem)
        groups.setdefault((structure, *((leaf.shape, leaf.dtype) for leaf in leaves)), []).append(number)
    # In one order, whichever problem comes first: programs depend on it.
    return sorted(groups.values(), key=lambda group: -problems[group[0]].reference.size)


def together[P](problems: Sequence[P]) -> P:
    """One module whose arrays have a leading axis for the images."""
    # In NumPy, which dispatches nothing for each of the many small arrays.
    return jax.tree.map(lambda *leaves: as_array(np.stack([np.asarray(leaf) for leaf in leaves])), *problems)
