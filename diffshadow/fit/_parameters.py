"""The parameters of a fit: numbers inside a module, named by dotted path, with bounds."""

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from .._arithmetic import as_float, concrete

# A fit starts at least this far inside its bounds, as a fraction of their distance. The change of variables has no
# slope on a bound.
_INSET = 0.01


class Parameter(eqx.Module):
    """A number to fit.

    - `name`: the name in results and messages.
    - `initial`, `lower`, `upper`: its start and its bounds.
    - `unit`: unit of all three, for reports.
    - `path`: dotted path to the number, such as `"filter.radius"`; by default the parameter's name. A path may stop at
        a module that holds one number: `"bias.constant"` means `"bias.constant.value"`.
    - `offset`: the origin's coordinate, for a coordinate in a scene that has an origin. The number at `path` is the
        parameter's value minus the offset. In this way, a value far from 0 keeps its digits.

    **Raises** `ValueError` unless `lower <= initial <= upper` and `lower < upper`, all finite.

    !!! Example

        ```python
        radius = fit.Parameter("filter.radius", 2.0, lower=0.0, upper=16.0)
        radius.upper, radius.unit  # (16.0, 'texels')
        ```
    """

    name: str = eqx.field(static=True)
    initial: float = eqx.field(static=True)
    lower: float = eqx.field(static=True)
    upper: float = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="texels")
    path: str | None = eqx.field(static=True, default=None)
    offset: float = eqx.field(static=True, default=0.0)

    @property
    def where(self) -> str:
        """The dotted path of the number."""
        return self.name if self.path is None else self.path

    def counted(self) -> "Parameter":
        """The parameter with all values relative to its offset, in double precision."""
        initial, lower, upper = (value - self.offset for value in (self.initial, self.lower, self.upper))
        return Parameter(self.name, initial, lower, upper, self.unit, self.path)

    def __check_init__(self):
        if not (np.isfinite([self.lower, self.upper]).all() and self.lower < self.upper):
            raise ValueError(
                f"the bounds of {self.name} are {self.lower} and {self.upper}; expected finite numbers, lower < upper"
            )
        if not self.lower <= self.initial <= self.upper:
            raise ValueError(
                f"{self.name} starts at {self.initial}; expected a value within its bounds, {self.lower} to "
                f"{self.upper}: change initial, or widen the bounds"
            )


class Parameters(eqx.Module):
    """The positions of the fitted numbers in a subject, their bounds, and the smooth map from all real numbers to the
    bounds.

    With `x = lower + (upper - lower) (1 + sin y) / 2` (James & Roos 1975), every `y` is valid and the bounds themselves
    can be reached. `x` are called values, and `y` free values.

    - `paths`: dotted paths in the subject.
    - `lower`, `upper`: (p,), the bounds.
    """

    paths: tuple[str, ...] = eqx.field(static=True)
    lower: Float[Array, " p"]
    upper: Float[Array, " p"]

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> "Parameters":
        """The paths and bounds of `parameters`."""
        counted = [p.counted() for p in parameters]
        lower, upper = (as_float([getattr(p, end) for p in counted]) for end in ("lower", "upper"))
        return cls(tuple(p.where for p in parameters), lower, upper)

    def __getitem__(self, indices: Sequence[int]) -> "Parameters":
        """The numbers at `indices`."""
        at = np.asarray(indices, int)
        lower, upper = (as_float(np.asarray(end)[at]) for end in (self.lower, self.upper))
        return Parameters(tuple(self.paths[i] for i in indices), lower, upper)

    def put(self, subject: PyTree, values: Float[Array, " p"]) -> PyTree:
        """`subject` with `values` (p,) instead of its own."""
        return with_values(subject, self.paths, values)

    def take(self, subject: PyTree) -> Float[Array, " p"]:
        """The values (p,) in `subject`."""
        return jnp.stack([resolve(subject, path) for path in self.paths])

    def fraction(self, y: Float[Array, " p"]) -> Float[Array, " p"]:
        """The positions of the free values `y` between the lower and the upper bounds, in [0, 1]."""
        return (1 + jnp.sin(y)) / 2

    def at(self, fraction: Float[Array, "*n p"]) -> Float[Array, "*n p"]:
        """The values at these positions between the bounds."""
        # Rounding may move the sum beyond the upper bound.
        return jnp.minimum(self.lower + (self.upper - self.lower) * fraction, self.upper)

    @eqx.filter_jit
    def to_bounded(self, y: Float[Array, " p"]) -> Float[Array, " p"]:
        """The values of free values `y`."""
        return self.at(self.fraction(y))

    @eqx.filter_jit
    def to_free(self, x: Float[Array, " p"], *, inset: float = _INSET) -> Float[Array, " p"]:
        """The inverse of `to_bounded`, for values moved off the bounds by at least `inset` of their distance."""
        fraction = jnp.clip((x - self.lower) / (self.upper - self.lower), inset, 1 - inset)
        return jnp.arcsin(2 * fraction - 1)


def with_parameters(module: PyTree, parameters: Sequence[Parameter], values: Sequence[float]) -> PyTree:
    """`module` with `values` (p,) of `parameters` instead of its own numbers."""
    counted = [value - p.offset for p, value in zip(parameters, values, strict=True)]
    return with_values(module, [p.where for p in parameters], as_float(counted))


def resolve(module: PyTree, name: str) -> Any:
    """The leaf of `module` at the dotted path `name`.

    **Raises** `ValueError` if there is no such leaf, if the path ends at a module with several numbers, or if the leaf
    is not a single number with a gradient.
    """
    try:
        found = _follow(module, name)
    except (AttributeError, LookupError, ValueError) as error:
        raise ValueError(
            f"there is no parameter {name!r} in a {type(module).__name__}; expected one of {_listed(module)}"
        ) from error
    leaves = jax.tree.leaves(found)
    if len(leaves) != 1:
        raise ValueError(f"the parameter {name!r} names {len(leaves)} numbers; expected one: {_listed(module)}")
    if not eqx.is_inexact_array(leaves[0]) or leaves[0].ndim > 0:
        raise ValueError(f"{name!r} names no single number that could be fitted; expected one of {_listed(module)}")
    return leaves[0]


def parameter_names(module: PyTree) -> list[str]:
    """The dotted paths of all single numbers in `module` that can be fitted."""
    paths = jax.tree_util.tree_leaves_with_path(eqx.filter(module, eqx.is_inexact_array))
    names = [".".join(map(_key, path)) for path, leaf in paths if leaf.ndim == 0]
    holders = [name.rpartition(".")[0] for name in names]
    # A module with one number goes by its own name.
    return [
        name.removesuffix(".value") if holders.count(holder) == 1 else name
        for name, holder in zip(names, holders, strict=True)
    ]


def _follow(module: PyTree, name: str) -> Any:
    """The object at the dotted path `name`: fields by name, entries of sequences and mappings by their keys."""
    return reduce(_step, name.split("."), module)


def _step(holder: Any, key: str) -> Any:
    if isinstance(holder, Mapping):
        return holder[key]
    return holder[int(key)] if isinstance(holder, tuple) else getattr(holder, key)


def _key(entry: Any) -> str:
    """One step of a path of `jax.tree_util`, as in a dotted path."""
    return str(next(getattr(entry, kind) for kind in ("name", "key", "idx") if hasattr(entry, kind)))


def _listed(module: PyTree) -> str:
    return ", ".join(parameter_names(module))


def with_values(module: PyTree, names: Sequence[str], values: Float[Array, " p"]) -> PyTree:
    """`module` with the numbers at `names` replaced by `values` (p,).

    !!! Example

        ```python
        moved = fit.with_values(technique, ["bias.constant"], jnp.array([2.0]))
        moved.bias.constant.value  # 2.0
        ```
    """
    for name in names:
        resolve(module, name)
    where = lambda module: [jax.tree.leaves(_follow(module, name))[0] for name in names]
    # Known values stay in NumPy, because JAX would compile an index.
    known = concrete(values)
    each = values if known is None else known
    return eqx.tree_at(where, module, [as_float(each[k]) for k in range(len(names))])
