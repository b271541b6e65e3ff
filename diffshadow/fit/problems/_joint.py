"""Several problems that share their subject."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import Scalar
from ...shadow import AbstractCompare, FittableTechnique, HardCompare, Overflow
from .._parameters import Parameters, resolve
from ._abstract import AbstractProblem

Images = tuple[Float[Array, "..."], ...]


class Joint(eqx.Module):
    """Problems that share what is fitted, such as one for each light; every pixel that counts has the same weight.

    - `subject`: what is fitted.
    - `problems`: their own subjects are ignored.
    """

    subject: Any
    problems: tuple[AbstractProblem, ...]

    @classmethod
    def of(cls, problems: AbstractProblem | Sequence[AbstractProblem]) -> "Joint":
        """One problem or several, with the subject of the first.

        **Raises** `ValueError` if there is none, or they are of several kinds.
        """
        each = (problems,) if isinstance(problems, AbstractProblem) else tuple(problems)
        if not each:
            raise ValueError("got no problem to fit; expected one, or one for each light")
        kinds = sorted({type(problem).__name__ for problem in each})
        if len(kinds) > 1:
            raise ValueError(f"got a {' and a '.join(kinds)} to fit jointly; expected all of one kind")
        return cls(each[0].subject, each)

    def differences(self, subject: Any, overflows: list[Overflow] | None = None) -> Images:
        """Those of all problems, scaled so that the sum of all their squares is the mean square error.

        **Arguments:** `overflows` as for `draw_shadow_map`.
        """
        count = jnp.maximum(sum(problem.count for problem in self.problems), 1)
        return tuple(problem.difference(subject, overflows) / jnp.sqrt(count) for problem in self.problems)

    def compared(self, differences: Images) -> Images:
        """The part of all differences that the fit makes small."""
        return tuple(problem.compared(each) for problem, each in zip(self.problems, differences, strict=True))

    def mean_square_error(self, subject: Any) -> Scalar:
        """The mean square error over all pixels that count."""
        return _sum_of_squares(self.differences(subject))

    def losses(self, subject: Any) -> tuple[Scalar, Scalar, Overflow]:
        """The mean square of the compared part of the differences, which a fit minimises, and of all of them.

        **Returns** also whether silhouettes are missing from a map, and the images wrong.
        """
        overflows: list[Overflow] = []
        differences = self.differences(subject, overflows)
        return _sum_of_squares(self.compared(differences)), _sum_of_squares(differences), any_of(overflows)

    def put(self, parameters: Parameters, values: Float[Array, " p"]) -> "Joint":
        """With `values` (p,) in the subject."""
        return Joint(parameters.put(self.subject, values), self.problems)

    @property
    def technique(self) -> FittableTechnique:
        """The subject's technique."""
        return self.problems[0].technique_of(self.subject)

    @property
    def moves(self) -> bool:
        """Whether lights or meshes may move."""
        return self.problems[0].moves

    def with_compare(self, compare: AbstractCompare) -> "Joint":
        """With `compare` as the technique's."""
        return eqx.tree_at(lambda joint: joint.technique.compare, self, compare)

    def hard(self) -> "Joint":
        """With the hard compare."""
        compare = self.technique.compare
        return self.with_compare(compare if isinstance(compare, HardCompare) else HardCompare())

    def searched(self, path: str) -> bool:
        """Whether the number at `path` lays out the map, so that it is found by a search rather than by gradient."""
        return self.technique.lays_out(path.removeprefix("technique."))

    def laid_out(self, parameters: Parameters, values: Float[Array, " p"]) -> "Joint":
        """With maps laid out as `values` (p,) say."""
        subject = parameters.put(self.subject, values)
        return self.each(lambda problem: problem.laid_out(subject))

    def each(self, function: Callable[[Any], AbstractProblem]) -> "Joint":
        """With `function` of each problem."""
        return Joint(self.subject, tuple(map(function, self.problems)))


def any_of(overflows: Sequence[Overflow]) -> Overflow:
    """Whether silhouettes are missing from any map."""
    return jnp.any(jnp.asarray(overflows, bool))


def _sum_of_squares(images: Images) -> Scalar:
    return sum((jnp.sum(image**2) for image in images), start=jnp.zeros(()))


def check_problem(joint: Joint, parameters: Parameters) -> None:
    """**Raises** `ValueError` unless each of the parameters can be fitted, and some pixel counts."""
    names = parameters.paths
    if not names:
        raise ValueError("got no parameters to fit; expected at least one, such as bias.constant")
    numbers = [resolve(joint.subject, name) for name in names]
    if len({id(number) for number in numbers}) < len(names):
        raise ValueError(f"a parameter is named twice in {', '.join(names)}; expected each once")
    annealed = [name for name in names if name.removeprefix("technique.").split(".")[0] == "compare"]
    if annealed:
        raise ValueError(f"{annealed[0]} cannot be fitted, since the fit itself makes the compare harden; leave it out")
    for end in (parameters.lower, parameters.upper):
        _check_allowed(joint.put(parameters, end).technique)
        _check_layout(joint, parameters, end)
    if not any(bool(each.count > 0) for each in joint.problems):
        raise ValueError(
            "no pixel sees a surface within the light's frustum, so there is nothing to fit; expected camera and "
            "light to see the same part of the scene: move one of them"
        )


def _check_allowed(technique: FittableTechnique) -> None:
    """Repeats the own checks of the technique and its filter at an end of the bounds."""
    for part, what in ((technique, "the technique"), (getattr(technique, "filter", None), "its filter")):
        try:
            getattr(part, "__check_init__", lambda: None)()
        except ValueError as error:
            raise ValueError(
                f"a parameter's bounds go further than {what} allows: {error}, or narrow the bounds"
            ) from error


def _check_layout(joint: Joint, parameters: Parameters, end: Float[Array, " p"]) -> None:
    """Lays out the maps at an end of the bounds."""
    try:
        joint.laid_out(parameters, end)
    except ValueError as error:
        raise ValueError(f"a parameter's bounds go further than the map's layout allows: {error}") from error
