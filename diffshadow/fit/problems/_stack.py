"""Combines problems of one structure, so that programs do not grow with their number."""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_array, as_int
from ..._device import chunk_size
from ...raster import Surface
from ...settings.fit import Search
from ...shadow import Atlas, ShadowMap, StoredMap, without_depths
from .._own_loss import Seen
from ._abstract import AbstractProblem
from ._devices import on_each_device, spread
from ._technique import TechniqueProblem

# The maximum number of pixels that are evaluated at once, on a CPU and on a GPU.
_AT_ONCE = 1 << 14, 1 << 19
# The maximum number of texels of an atlas, whose indices are 32-bit numbers, and the maximum number of stored atlases,
# because a fit of a layout often draws its maps again.
_MAX_TEXELS, _MAX_ATLASES = (1 << 31) - 1, 4
# In bytes, for arrays that JAX does not copy from the host's memory.
_ALIGNMENT = 64


Atlases = dict[tuple[int, ...], tuple[Atlas, Any]]
"""Atlases and their maps, by the maps' ids."""


class Stack(eqx.Module):
    """Fits of a technique to several images, which one program evaluates a few at a time.

    - `problems`: one problem whose arrays have a leading axis for the images.
    - `atlas`, `numbers`: an atlas of their maps, and each map's index in it, (n,), if the maps can be in an atlas. The
      problems then have no depths.
    - `surfaces`, `sights`: the distinct surfaces, and the index of each image's surface, (n,), if images share
      surfaces. The problems then have no surfaces.
    - `devices`: the number of devices that share the problems. The atlas then has a leading axis for the devices.
    """

    problems: TechniqueProblem
    atlas: Atlas | None = None
    numbers: Int[Array, " n"] | None = None
    surfaces: Surface | None = None
    sights: Int[Array, " n"] | None = None
    devices: int = eqx.field(static=True, default=Search.devices)

    @classmethod
    def of(cls, problems: Sequence[TechniqueProblem], atlas: Atlas | None, numbers: Sequence[int]) -> "Stack":
        """Stacks problems of one structure. Their maps have these `numbers` in the atlas."""
        surfaces, sights = _distinct([problem.surface for problem in problems])
        if atlas is not None:
            problems = _without_depths(problems)
        places = None if atlas is None else as_int(numbers)
        if len(surfaces) == len(problems):
            return cls(together(problems), atlas, places)
        bare = [eqx.tree_at(lambda p: p.surface, problem, None) for problem in problems]
        return cls(together(bare), atlas, places, together(surfaces), as_int(sights))

    @classmethod
    def on(cls, devices: int, problems: Sequence[TechniqueProblem]) -> "Stack":
        """Stacks problems of one structure, with equal numbers on each of the `devices`."""
        each = len(problems) // devices
        parts = [problems[start : start + each] for start in range(0, len(problems), each)]
        maps: Any = [_distinct([p.shadow_map for p in part]) for part in parts]
        most = max(len(own) for own, _ in maps)
        if not _has_atlas(problems[0].shadow_map, most):
            return cls(spread(together(problems), devices), devices=devices)
        # An equal number of maps on each device.
        atlas = together([Atlas.of([*own, *own[:1] * (most - len(own))]) for own, _ in maps])
        numbers = [number for _, numbers in maps for number in numbers]
        return cls(*spread((together(_without_depths(problems)), atlas, as_int(numbers)), devices), devices=devices)

    def difference_and_overflow(self, subject: Any) -> tuple[Float[Array, "n h w"], None]:
        """The differences of all problems. Nothing that could overflow is drawn."""
        return self._of_each(lambda subject, problem: problem.difference(subject), subject), None

    def seen(self, subject: Any) -> tuple[Seen, None]:
        """The images that a user's loss compares. Nothing that could overflow is drawn."""
        return self._of_each(lambda subject, problem: problem.seen(subject)[0], subject), None

    def _of_each(self, function: Callable[[Any, TechniqueProblem], Any], subject: Any) -> Any:
        """The result of `function` for the subject and each problem with its map, along a first axis."""
        if self.devices == 1:
            return self._of_own(function, subject)

        def of_part(subject: Any, part: tuple[TechniqueProblem, Atlas | None, Any]) -> Any:
            problems, atlas, numbers = part
            own = None if atlas is None else Atlas(atlas.texels[0], atlas.shape)
            return Stack(problems, own, numbers)._of_own(function, subject)

        return on_each_device(of_part, subject, (self.problems, self.atlas, self.numbers), self.devices)

    def _of_own(self, function: Callable[[Any, TechniqueProblem], Any], subject: Any) -> Any:
        images, *sides = self.problems.reference.shape
        # Several small groups keep all cores busy. No remainder is left, which would need a second program.
        most = max(chunk_size(*_AT_ONCE) // math.prod(sides), 1)
        at_once = max(k for k in range(1, min(most, images) + 1) if images % k == 0)

        def of_one(given: tuple[TechniqueProblem, Int[Array, ""] | None, Int[Array, ""] | None]) -> Any:
            problem, number, sight = given
            if self.surfaces is not None:
                problem = dataclasses.replace(problem, surface=jax.tree.map(lambda leaf: leaf[sight], self.surfaces))
            if self.atlas is not None and number is not None:
                shadow_map: Any = problem.shadow_map
                problem = dataclasses.replace(problem, shadow_map=self.atlas.reading(shadow_map, number))
            return function(subject, problem)

        return jax.lax.map(of_one, (self.problems, self.numbers, self.sights), batch_size=at_once)

    def compared(self, differences: Float[Array, "n h w"]) -> Float[Array, "n h w"]:
        """All of them."""
        return differences

    @property
    def moves(self) -> bool:
        """Always false, because maps and surfaces do not change."""
        return False

    @property
    def count(self) -> Float[Array, " n"]:
        """The number of pixels that count in each image."""
        return jax.vmap(lambda problem: problem.count)(self.problems)


def stacked(problems: Sequence[AbstractProblem], atlases: Atlases, devices: int) -> tuple[AbstractProblem | Stack, ...]:
    """Stacks fits of a technique that have the same structure. All other problems are returned unchanged.

    **Arguments:**

    - `atlases`: the atlases made so far, which are used again.
    - `devices`: the number of devices that evaluate a part of each stack. The remaining problems form a stack that all
      devices evaluate.
    """
    alone = tuple(problem for problem in problems if not isinstance(problem, TechniqueProblem))
    own = [problem for problem in problems if isinstance(problem, TechniqueProblem)]
    groups = of_one_structure(own)
    stacks = (stack for group in groups for stack in _stacks(group, own, atlases, devices))
    return (*stacks, *alone)


def stacked_order(problems: Sequence[AbstractProblem]) -> list[int]:
    """The indices of fits of a technique in the order of `stacked`."""
    return [number for group in _numbers_of_one_structure(problems) for number in group]


def copied_bytes(problems: Sequence[TechniqueProblem]) -> int:
    """The size of the arrays that stacks of the problems copy, in bytes: images, each surface once, and maps that
    cannot be in an atlas."""
    surfaces, _ = _distinct([problem.surface for problem in problems])
    images = [(problem.reference, problem.mask) for problem in problems]
    maps = [p.shadow_map for p in problems if not (_is_plain(p.shadow_map) or isinstance(p.shadow_map, StoredMap))]
    return sum(getattr(leaf, "nbytes", 0) for leaf in jax.tree.leaves((surfaces, images, maps)))


def _stacks(
    group: Sequence[TechniqueProblem], among: Sequence[TechniqueProblem], atlases: Atlases, devices: int
) -> Iterator[TechniqueProblem | Stack]:
    spread = len(group) - len(group) % devices if devices > 1 else 0
    if spread:
        yield Stack.on(devices, group[:spread])
    rest = group[spread:]
    if rest:
        yield rest[0] if len(rest) == 1 else _stack(rest, among, atlases)


def _has_atlas(shadow_map: Any, count: int) -> bool:
    """Whether this many maps like this one may be in an atlas."""
    return _is_plain(shadow_map) and Atlas.size(count, shadow_map.depth.shape) <= _MAX_TEXELS


def _stack(group: Sequence[TechniqueProblem], among: Sequence[TechniqueProblem], atlases: Atlases) -> Stack:
    """The stack of a group. It shares an atlas with all problems whose maps have the same size."""
    like = group[0].shadow_map
    stored = [problem.shadow_map for problem in group if isinstance(problem.shadow_map, StoredMap)]
    if stored:
        return Stack.of(group, stored[0].atlas, [int(each.number) for each in stored])
    maps: dict[int, Any] = {id(p.shadow_map): p.shadow_map for p in among if _fits(p.shadow_map, like)}
    if not _has_atlas(like, len(maps)):
        return Stack.of(group, None, [])
    numbers = {key: number for number, key in enumerate(maps)}
    if tuple(maps) not in atlases:
        # Stored with the maps, so that no other objects get their ids.
        atlases[tuple(maps)] = Atlas.of([*maps.values()]), maps
        while len(atlases) > _MAX_ATLASES:
            atlases.pop(next(iter(atlases)))
    atlas, _ = atlases[tuple(maps)]
    return Stack.of(group, atlas, [numbers[id(problem.shadow_map)] for problem in group])


def _distinct[T](things: Sequence[T]) -> tuple[list[T], list[int]]:
    """The distinct objects, and the index of each of `things` among them."""
    found = {id(each): each for each in things}
    places = {key: place for place, key in enumerate(found)}
    return list(found.values()), [places[id(each)] for each in things]


def _without_depths(problems: Sequence[TechniqueProblem]) -> list[TechniqueProblem]:
    bare = lambda own: own.rest if isinstance(own, StoredMap) else without_depths(own)
    return [dataclasses.replace(problem, shadow_map=bare(problem.shadow_map)) for problem in problems]


def _fits(shadow_map: Any, like: Any) -> bool:
    """Whether two maps may share an atlas."""
    return _is_plain(shadow_map) and shadow_map.depth.shape == like.depth.shape


def _is_plain(shadow_map: Any) -> bool:
    return isinstance(shadow_map, ShadowMap) and shadow_map.silhouettes is None


def of_one_structure[P](problems: Sequence[P]) -> list[list[P]]:
    """Groups of problems, or of other modules with a `reference`, whose arrays have equal shapes. Large images come
    first. Each group uses at most one atlas."""
    return [[problems[number] for number in group] for group in _numbers_of_one_structure(problems)]


def _numbers_of_one_structure(problems: Sequence[Any]) -> list[list[int]]:
    groups: dict[Any, list[int]] = {}
    for number, problem in enumerate(problems):
        leaves, structure = jax.tree.flatten(problem)
        own = getattr(problem, "shadow_map", None)
        atlas = id(own.atlas.texels) if isinstance(own, StoredMap) else None
        groups.setdefault((structure, atlas, *((leaf.shape, leaf.dtype) for leaf in leaves)), []).append(number)
    # The order does not depend on which problem comes first, because programs depend on it.
    return sorted(groups.values(), key=lambda group: -problems[group[0]].reference.size)


def together[P](problems: Sequence[P]) -> P:
    """One module whose arrays have a leading axis for the images. `Rows` in order are not copied."""
    return jax.tree.map(lambda *leaves: as_array(stack_of([np.asarray(leaf) for leaf in leaves])), *problems)


class Rows:
    """Host memory for modules of one structure. `together` does not copy modules that were added in order.

    - `count`: the maximum number of modules.
    """

    def __init__(self, count: int):
        self.count, self._whole = count, []
        self._taken = 0

    def put[P](self, module: P) -> P:
        """The module with its arrays in this memory, or the module itself if its arrays have other shapes than the
        first module's."""
        leaves, structure = jax.tree.flatten(module)
        if not self._taken:
            self._whole = [_aligned((self.count, *leaf.shape), leaf.dtype) for leaf in leaves]
        if [(leaf.shape, leaf.dtype) for leaf in leaves] != [(each.shape[1:], each.dtype) for each in self._whole]:
            return module
        for whole, leaf in zip(self._whole, leaves, strict=True):
            whole[self._taken] = leaf
        self._taken += 1
        return jax.tree.unflatten(structure, [whole[self._taken - 1] for whole in self._whole])


def _aligned(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Zeros at an address from which JAX reads them without a copy."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    memory = np.zeros(size + _ALIGNMENT, np.uint8)
    return np.ndarray(shape, dtype, memory, -memory.ctypes.data % _ALIGNMENT)


def stack_of(rows: Sequence[np.ndarray]) -> np.ndarray:
    """The arrays along a first axis, without a copy if they are `Rows` in order."""
    first = rows[0]
    base, start = first.base, first.ctypes.data
    follows = lambda i, row: row.base is base and row.ctypes.data == start + i * first.nbytes
    fits = lambda row: row.flags.c_contiguous and (row.shape, row.dtype) == (first.shape, first.dtype)
    if isinstance(base, np.ndarray) and all(fits(row) and follows(i, row) for i, row in enumerate(rows)):
        return np.ndarray((len(rows), *first.shape), first.dtype, base, start - base.ctypes.data)
    # NumPy dispatches nothing for each of the many small arrays.
    return np.stack(rows)
