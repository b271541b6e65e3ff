"""Several problems that share their subject."""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._arithmetic import as_array
from ..._checks import check_again, check_instance
from ..._types import Scalar
from ...settings.fit import Search
from ...shadow import AbstractCompare, FittableTechnique, HardCompare, Overflow
from .._loss import Errors, Loss
from .._own_loss import LossFunction, OwnLoss, Seen
from .._parameters import Parameters, parameter_names, resolve
from ._abstract import AbstractProblem, any_overflow
from ._devices import on_host
from ._stack import Atlases, stacked, stacked_order

Samples = dict[tuple[int, int], tuple[Any, Any]]
"""Problems and their samples, by the problem's id and the number of pixels."""

# The fraction of a sample that comes from the worst problems.
_OF_WORST = 0.75
# Bounds of the factor that corrects a sample's error.
_MIN_ERROR, _MAX_FACTOR = 1e-10, 4.0

Images = tuple[Float[Array, "..."], ...]
"""The images of each stack, (n, h, w), and of each other problem, (1, h, w)."""


class Losses(NamedTuple):
    """The losses of a subject.

    - `compared`: the error of the compared part of the differences, which a fit minimises; `whole`: the error of all
      differences.
    - `errors`: (v,), the error of each problem over all differences.
    - `overflow`: whether silhouettes are missing from a map, so that the images are wrong.
    """

    compared: Scalar
    whole: Scalar
    errors: Errors
    overflow: Overflow


class Together(NamedTuple):
    """The results of one program for many images: their losses, and the losses of pixels that are too dark and of
    pixels that are too light."""

    losses: Losses
    sides: tuple[Scalar, Scalar]


class Joint(eqx.Module):
    """Problems that share the fitted subject, such as one for each view and light.

    - `subject`: the fitted subject.
    - `problems`: each an `AbstractProblem`, whose own subject is ignored, or a `Stack` of several.
    - `loss`: the loss of their errors; `own`: a user's loss that replaces it, or `None`.
    - `devices`: the number of devices that evaluate its stacks.
    """

    subject: Any
    problems: tuple[Any, ...]
    loss: Loss
    own: OwnLoss | None = None
    devices: int = eqx.field(static=True, default=Search.devices)

    @classmethod
    def of(
        cls,
        problems: AbstractProblem | Sequence[AbstractProblem],
        loss: Loss | LossFunction | None = None,
    ) -> "Joint":
        """One problem or several, with the subject of the first.

        **Raises** `ValueError` if there is none, or if they are of several kinds; `TypeError` if `loss` is not a loss.
        """
        each = tuple(problems) if isinstance(problems, Sequence) else (problems,)
        if not each:
            raise ValueError("got no problem to fit; expected one, or one for each light")
        for problem in each:
            check_instance("what to fit", problem, AbstractProblem, "a problem, such as TechniqueProblem.of(...)")
        kinds = sorted({type(problem).__name__ for problem in each})
        if len(kinds) > 1:
            raise ValueError(f"got a {' and a '.join(kinds)} to fit jointly; expected all of one kind")
        if loss is None or isinstance(loss, Loss):
            return cls(each[0].subject, each, loss or Loss())
        return cls(each[0].subject, each, Loss(), OwnLoss.of(loss, (problem.shape for problem in each)))

    def differences(self, subject: Any) -> tuple[Images, Overflow]:
        """Difference images, each scaled so that its squares sum to its mean square error.

        If the loss has factors for the signs of differences, the squares are multiplied by these factors.

        **Returns:** (n, h, w) for each stack, (1, h, w) for each other problem; and whether silhouettes are missing
        from a map, so that an image is wrong.
        """
        found = [each.difference_and_overflow(subject) for each in self.problems]
        images = tuple(_scaled(self.loss, own, each.count) for (own, _), each in zip(found, self.problems, strict=True))
        return images, any_overflow([overflow for _, overflow in found])

    def compared(self, differences: Images) -> Images:
        """The part of all differences that the fit minimises."""
        return tuple(each.compared(images) for each, images in zip(self.problems, differences, strict=True))

    def rows(self, subject: Any, *, compared: bool = True) -> tuple[list[Float[Array, "n m"]], Overflow]:
        """The residuals of a user's loss, or its values (n, 1), for each stack and problem.

        **Arguments:** `compared`: whether to use only the compared part of the images.

        **Returns:** the residuals, and whether silhouettes are missing from a map, so that an image is wrong.
        """
        found = [each.seen(subject) for each in self.problems]
        images = [seen for seen, _ in found]
        if compared:
            images = [_compared(each, seen) for each, seen in zip(self.problems, images, strict=True)]
        assert self.own is not None
        return [_rows(self.own, seen) for seen in images], any_overflow([each for _, each in found])

    @property
    def shares(self) -> Errors:
        """The share of each problem in all pixels that count, (v,)."""
        return _shares([p.count for p in self.problems])

    def losses(self, subject: Any) -> Losses:
        """The loss, and the errors that it is computed from."""
        if self.own is not None:
            return self._losses_by(self.own, subject)
        differences, overflow = self.differences(subject)
        compared, errors = squares(self.compared(differences)), squares(differences)
        of_compared, whole = _weighed(self.loss, [compared, errors], self.shares)
        return Losses(of_compared, whole, errors, overflow)

    def _losses_by(self, own: OwnLoss, subject: Any) -> Losses:
        rows, overflow = self.rows(subject)
        errors = of_compared = _of_rows(own, rows)
        if self.moves:
            errors = _of_rows(own, self.rows(subject, compared=False)[0])
        mean = lambda each: as_array(np.mean(np.asarray(each)))
        return Losses(mean(of_compared), mean(errors), errors, overflow)

    def sides(self, subject: Any) -> tuple[Scalar, Scalar]:
        """The loss of pixels that are too dark, and the loss of pixels that are too light."""
        return _sides_of(self.loss, _by_sign(self.differences(subject)[0]), self.shares)

    def mean_square_error(self, subject: Any) -> Scalar:
        """The loss of all differences. Without `loss`, the mean square error over all pixels that count."""
        return self.losses(subject).whole

    def put(self, parameters: Parameters, values: Float[Array, " p"]) -> "Joint":
        """With `values` (p,) in the subject."""
        return dataclasses.replace(self, subject=parameters.put(self.subject, values))

    def with_loss(self, loss: Loss) -> "Joint":
        """With another loss."""
        return dataclasses.replace(self, loss=loss)

    @property
    def count(self) -> int:
        """The number of pixels that count in all problems."""
        return sum(int(np.sum(problem.count)) for problem in self.problems)

    def sampled(self, count: int, worst: Collection[int] = (), samples: Samples | None = None) -> "Joint":
        """The same problems with a sample of about `count` pixels in fits of a technique. Each problem contributes
        equally, or three quarters of the pixels come from the problems at the indices `worst`.

        **Arguments:** `samples`: the samples taken so far, which are used again.
        """
        total, samples = len(self.problems), {} if samples is None else samples
        shares = np.full(total, 1 / total)
        if 0 < len(worst) < total:
            shares[:] = (1 - _OF_WORST) / (total - len(worst))
            shares[list(worst)] = _OF_WORST / len(worst)
        taken = []
        for seed, (problem, share) in enumerate(zip(self.problems, shares, strict=True)):
            key = id(problem), max(int(count * share), 1)
            if key not in samples:
                # Stored with the problem, so that no other object gets its id.
                samples[key] = problem, problem.sampled(key[1], seed)
            taken.append(samples[key][1])
        return dataclasses.replace(self, problems=tuple(taken))

    def corrected(self, errors: Errors, atlases: Atlases | None = None) -> "Joint":
        """A sample scaled so that its errors at its subject, under the hard compare, equal the `errors` (v,) of whole
        images.

        This is a ratio estimate (Cochran, Sampling Techniques, chapter 6): near the subject, the errors of a sample and
        of the whole image have nearly the same ratio.

        **Arguments:** `atlases` as for `stacked`.
        """
        hard, own = self.hard().each(lambda p: p.padded()), np.empty(len(self.problems))
        own[stacked_order(hard.problems)] = _errors(hard.stacked(atlases))
        ratios = np.asarray(errors) / np.maximum(own, _MIN_ERROR)
        factors = np.clip(ratios, 1 / _MAX_FACTOR, _MAX_FACTOR)
        corrected = [dataclasses.replace(p, factor=c) for p, c in zip(self.problems, factors, strict=True)]
        return dataclasses.replace(self, problems=tuple(corrected))

    def stacked(self, atlases: Atlases | None = None) -> "Joint":
        """The same problems, with fits of a technique stacked if they have the same structure.

        **Arguments:** `atlases`: the atlases made so far, which are used again.
        """
        atlases = {} if atlases is None else atlases
        return dataclasses.replace(self, problems=stacked(self.problems, atlases, self.devices))

    def together(self, order: Sequence[int]) -> Together:
        """The `losses` and `sides` of stacked fits of a technique, by one program.

        **Arguments:** `order`: the order of the stacked problems, from `stacked_order`.
        """
        found = on_host(_together(self))
        errors = np.empty(len(order), np.float32)
        errors[np.asarray(order)] = found.losses.errors
        return found._replace(losses=found.losses._replace(errors=as_array(errors)))

    @property
    def technique(self) -> FittableTechnique:
        """The subject's technique."""
        return self.problems[0].technique_of(self.subject)

    @property
    def moves(self) -> bool:
        """Whether lights or meshes may move."""
        return self.problems[0].moves

    def with_compare(self, compare: AbstractCompare) -> "Joint":
        """The same problems with `compare` as the technique's compare."""
        # Only the subject changes, which is much smaller than the problems.
        where = lambda subject: self.problems[0].technique_of(subject).compare
        return dataclasses.replace(self, subject=eqx.tree_at(where, self.subject, compare))

    def hard(self) -> "Joint":
        """The same problems with the hard compare, and the exact loss."""
        compare = self.technique.compare
        hardened = self.with_compare(compare if isinstance(compare, HardCompare) else HardCompare())
        return hardened.with_loss(self.loss.exact())

    def searched(self, path: str) -> bool:
        """Whether the number at `path` lays out the map, so that it is found by a search instead of a gradient."""
        return self.technique.lays_out(path.removeprefix("technique."))

    @property
    def lays_out(self) -> bool:
        """Whether numbers of the technique lay out the maps."""
        return any(map(self.technique.lays_out, parameter_names(self.technique)))

    def laid_out(self, parameters: Parameters, values: Float[Array, " p"]) -> "Joint":
        """The same problems with maps laid out for `values` (p,)."""
        if not self.lays_out:
            return self
        subject = parameters.put(self.subject, values)
        found = self.each(lambda problem: problem.laid_out(subject))
        is_same = all(new is old for new, old in zip(found.problems, self.problems, strict=True))
        return self if is_same else found

    def each(self, function: Callable[[Any], AbstractProblem]) -> "Joint":
        """The same problems with `function` applied to each problem."""
        return dataclasses.replace(self, problems=tuple(map(function, self.problems)))


@eqx.filter_jit
def _scaled(loss: Loss, difference: Float[Array, "*n h w"], count: Float[Array, "*n"]) -> Float[Array, "m h w"]:
    """One image or several images, as several."""
    scaled = loss.signed(difference) / jnp.sqrt(jnp.maximum(count, 1))[..., None, None]
    return scaled.reshape(-1, *scaled.shape[-2:])


@eqx.filter_jit
def _shares(counts: list[Array]) -> Float[Array, " v"]:
    each = jnp.concatenate([jnp.atleast_1d(jnp.asarray(count, jnp.float32)) for count in counts])
    return each / jnp.maximum(jnp.sum(each), 1)


@eqx.filter_jit
def _weighed(loss: Loss, errors: list[Errors], shares: Errors) -> list[Scalar]:
    """The loss of each of several `errors` (v,)."""
    return [jnp.sum(loss.weights(each, shares) * each) for each in errors]


@eqx.filter_jit
def _by_sign(images: Images) -> tuple[Images, Images]:
    """The negative and the positive part of each image."""
    return tuple(jnp.minimum(each, 0) for each in images), tuple(jnp.maximum(each, 0) for each in images)


@eqx.filter_jit
def _errors(joint: Joint) -> Errors:
    differences, _ = joint.differences(joint.subject)
    return squares(differences)


def _sides_of(loss: Loss, parts: tuple[Images, Images], shares: Errors) -> tuple[Scalar, Scalar]:
    dark, light = _weighed(loss, [squares(each) for each in parts], shares)
    return dark, light


@eqx.filter_jit
def _together(joint: Joint) -> Together:
    differences, overflow = joint.differences(joint.subject)
    shares, errors = joint.shares, squares(differences)
    (whole,) = _weighed(joint.loss, [errors], shares)
    return Together(Losses(whole, whole, errors, overflow), _sides_of(joint.loss, _by_sign(differences), shares))


def _compared(problem: Any, seen: Seen) -> Seen:
    blurred = lambda image: problem.compared(image.reshape(-1, *image.shape[-2:])).reshape(image.shape)
    return seen._replace(predicted=blurred(seen.predicted), reference=blurred(seen.reference))


@eqx.filter_jit
def _rows(loss: OwnLoss, seen: Seen) -> Float[Array, "n m"]:
    return loss.rows(seen)


@eqx.filter_jit
def _of_rows(loss: OwnLoss, rows: list[Float[Array, "n m"]]) -> Errors:
    return jnp.concatenate([loss.of_rows(each) for each in rows])


def squares(images: Images) -> Errors:
    """The sum of the squares of each image, (v,)."""
    return products(images, images)


@eqx.filter_jit
def products(images: Images, others: Images) -> Errors:
    """The sum of the products of each two images, (v,)."""
    return jnp.concatenate([jnp.sum(a * b, axis=(1, 2)) for a, b in zip(images, others, strict=True)])


def multiplied(images: Images, factors: Errors) -> Images:
    """Each image times its factor."""
    ends = np.cumsum([len(each) for each in images])
    return tuple(each * factors[end - len(each) : end, None, None] for each, end in zip(images, ends, strict=True))


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
        raise ValueError(f"{annealed[0]} cannot be fitted, because the fit itself anneals the compare; leave it out")
    for end in (parameters.lower, parameters.upper):
        moved = joint.put(parameters, end)
        _check_allowed("technique", moved.technique)
        if (shading := getattr(moved.subject, "shading", None)) is not None:
            _check_allowed("shading", shading)
        _check_layout(joint, parameters, end)
    if not any(float(np.sum(each.count)) > 0 for each in joint.problems):
        raise ValueError(
            "no pixel sees a surface within the light's frustum, so there is nothing to fit; expected camera and "
            "light to see the same part of the scene: move one of them"
        )


def _check_allowed(name: str, module: Any) -> None:
    """Repeats the checks of a module and its parts at an end of the bounds."""
    try:
        check_again(module)
    except ValueError as error:
        raise ValueError(
            f"a parameter's bounds go further than the {name} allows: {error}; narrow the bounds"
        ) from error


def _check_layout(joint: Joint, parameters: Parameters, end: Float[Array, " p"]) -> None:
    """Lays out the maps at an end of the bounds."""
    try:
        joint.laid_out(parameters, end)
    except ValueError as error:
        raise ValueError(f"a parameter's bounds go further than the map's layout allows: {error}") from error
