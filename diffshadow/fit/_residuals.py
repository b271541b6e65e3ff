"""Residuals: how far shadow mapping is from its reference, pixel by pixel."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._types import Mask, Scalar, Visibility
from ..raster import Overflow, Surface
from ..shadow import AbstractCompare, ShadowMap, ShadowMapping
from ._arrangement import Arrangement
from ._parameters import Bounds, resolve, with_values
from ._poses import PoseProblem

Subject = ShadowMapping | Arrangement
"""What is fitted: a technique alone, or with lights and meshes."""


class Problem(eqx.Module):
    """A technique, what it is fitted to, and what stays as it is.

    - `technique`: the shadow mapping whose numbers are fitted.
    - `shadow_map`, `surface`: what it looks at. Neither depends on bias or filter, so neither is drawn again.
    - `reference`: (h, w), visibility in [0, 1].
    - `mask`: (h, w), the pixels that count.
    """

    technique: ShadowMapping
    shadow_map: ShadowMap
    surface: Surface
    reference: Visibility
    mask: Mask

    def residual(self, technique: ShadowMapping) -> Float[Array, "h w"]:
        """Visibility less reference at the pixels that count, 0 elsewhere.

        Scaled so that the sum of its squares is the mean square error.
        """
        return self.difference(technique) / jnp.sqrt(jnp.maximum(self.count, 1))

    def mean_square_error(self, technique: ShadowMapping) -> Scalar:
        """The mean square error over the pixels that count."""
        return jnp.sum(self.residual(technique) ** 2)

    def difference(self, technique: ShadowMapping, overflows: list[Overflow] | None = None) -> Float[Array, "h w"]:
        """Visibility less reference at the pixels that count, 0 elsewhere. It draws nothing that could overflow."""
        visibility = technique.visibility(self.shadow_map, self.surface)
        return jnp.where(self.mask, visibility - self.reference, 0)

    def compared(self, difference: Float[Array, "h w"]) -> Float[Array, "h w"]:
        """What counts of a difference: all of it."""
        return difference

    @property
    def subject(self) -> ShadowMapping:
        """What is fitted."""
        return self.technique

    @property
    def count(self) -> Int[Array, ""]:
        """How many pixels count."""
        return jnp.sum(self.mask)


class Joint(eqx.Module):
    """Several problems that share what is fitted, such as one for each light; every pixel that counts weighs the same.

    - `subject`: a technique, or an arrangement.
    - `problems`: whose own subjects are not asked.
    """

    subject: Subject
    problems: tuple[Problem | PoseProblem, ...]

    @classmethod
    def of(cls, problems: "AnyProblem | Sequence[AnyProblem]") -> "Joint":
        """One problem or several, with the technique, or the arrangement, of the first.

        **Raises** `ValueError` if there is none, or some move and others do not.
        """
        each = (problems,) if isinstance(problems, Problem | PoseProblem) else tuple(problems)
        if not each:
            raise ValueError("got no problem to fit; expected one, or one for each light")
        if len({type(problem) for problem in each}) > 1:
            raise ValueError("got both a Problem and a PoseProblem to fit jointly; expected all of one kind")
        return cls(each[0].subject, each)

    def differences(self, subject: Any, overflows: list[Overflow] | None = None) -> tuple[Float[Array, "h w"], ...]:
        """Those of all problems, scaled so that the sum of all their squares is the mean square error.

        **Arguments:** `overflows` as for `draw_shadow_map`.
        """
        count = jnp.maximum(sum(problem.count for problem in self.problems), 1)
        return tuple(problem.difference(subject, overflows) / jnp.sqrt(count) for problem in self.problems)

    def compared(self, differences: Sequence[Float[Array, "h w"]]) -> tuple[Float[Array, "h w"], ...]:
        """What counts of all differences: of poses, their blur."""
        return tuple(problem.compared(each) for problem, each in zip(self.problems, differences, strict=True))

    def mean_square_error(self, subject: Subject) -> Scalar:
        """The mean square error over all pixels that count."""
        return _sum_of_squares(self.differences(subject))

    def losses(self, subject: Subject) -> tuple[Scalar, Scalar, Overflow]:
        """The mean square of what counts of the differences, which a fit makes least, and that of all of them.

        **Returns** also whether a capacity was too small to draw them: they are wrong then.
        """
        overflows: list[Overflow] = []
        differences = self.differences(subject, overflows)
        return _sum_of_squares(self.compared(differences)), _sum_of_squares(differences), any_of(overflows)

    @property
    def technique(self) -> ShadowMapping:
        """The subject's technique."""
        return self.subject.technique if isinstance(self.subject, Arrangement) else self.subject

    @property
    def moves(self) -> bool:
        """Whether lights or meshes may move."""
        return isinstance(self.subject, Arrangement)

    def compared_by(self, compare: AbstractCompare) -> "Joint":
        """With `compare` as the technique's."""
        where = lambda joint: joint.technique.compare
        return eqx.tree_at(where, self, compare)

    def each(self, function: Callable[[PoseProblem], PoseProblem]) -> "Joint":
        """With `function` of each problem in which poses move."""
        return Joint(self.subject, tuple(function(p) if isinstance(p, PoseProblem) else p for p in self.problems))


AnyProblem = Problem | PoseProblem


def any_of(overflows: Sequence[Overflow]) -> Overflow:
    """Whether any capacity was too small."""
    return jnp.any(jnp.asarray(overflows, bool))


def _sum_of_squares(images: Sequence[Float[Array, "h w"]]) -> Scalar:
    return sum((jnp.sum(image**2) for image in images), start=jnp.zeros(()))


def check_problem(problem: Joint, names: tuple[str, ...], bounds: Bounds) -> None:
    """**Raises** `ValueError` unless each of `names` can be fitted, and some pixel counts."""
    if not names:
        raise ValueError("got no parameters to fit; expected at least one, such as bias.constant")
    numbers = [resolve(problem.subject, name) for name in names]
    if len({id(number) for number in numbers}) < len(names):
        raise ValueError(f"a parameter is named twice in {', '.join(names)}; expected each once")
    annealed = [name for name in names if name.removeprefix("technique.").split(".")[0] == "compare"]
    if annealed:
        raise ValueError(f"{annealed[0]} cannot be fitted, since the fit itself makes the compare harden; leave it out")
    for end in (bounds.lower, bounds.upper):
        _check_allowed(Joint(with_values(problem.subject, names, end), problem.problems).technique)
    if not any(bool(jnp.any(each.mask)) for each in problem.problems):
        raise ValueError(
            "no pixel sees a surface within the light's frustum, so there is nothing to fit; expected camera and "
            "light to see the same part of the scene: move one of them"
        )


def _check_allowed(technique: ShadowMapping) -> None:
    """Asks the filter of a technique, at the ends of its bounds, whether it can be made so."""
    check = getattr(technique.filter, "__check_init__", None)
    if check is None:
        return
    try:
        check()
    except ValueError as error:
        raise ValueError(
            f"a parameter's bounds go further than its filter allows: {error}, or narrow the bounds"
        ) from error
