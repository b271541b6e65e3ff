"""The interface between a fit and its problems."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from ..._arithmetic import array_module, as_array
from ..._types import Resolution
from ...shadow import FittableTechnique, Overflow
from .._own_loss import Seen


class AbstractProblem(eqx.Module):
    """A subject, which draws an image, and the difference of this image from a reference.

    The subject is the tree of modules whose numbers are fitted: a technique, or an `Arrangement` of a technique, lights
    and meshes. Methods take the subject as an argument, so that a solver may change its numbers.
    """

    @property
    @abc.abstractmethod
    def moves(self) -> bool:
        """Whether lights or meshes may move, so that images are drawn again at every step."""

    @property
    @abc.abstractmethod
    def subject(self) -> Any:
        """The fitted object with its current values."""

    @property
    @abc.abstractmethod
    def count(self) -> Float[Array, "*n"]:
        """The number of pixels that count in its image, or in each of its images, such as the channels of a picture."""

    @property
    @abc.abstractmethod
    def blur_in_pixels(self) -> float:
        """Standard deviation of the Gaussian under which images are compared, in pixels; 0 for none."""

    @property
    @abc.abstractmethod
    def shape(self) -> Resolution:
        """Height and width of its images, in pixels."""

    @abc.abstractmethod
    def technique_of(self, subject: Any) -> FittableTechnique:
        """The technique of a subject."""

    @abc.abstractmethod
    def difference(self, subject: Any) -> Float[Array, "*n h w"]:
        """The image, or each of its images, minus the reference at the pixels that count, and 0 elsewhere."""

    def difference_and_overflow(self, subject: Any) -> tuple[Float[Array, "*n h w"], Overflow | None]:
        """The difference, and a flag that replaces an error: whether silhouettes are missing, so that the difference is
        wrong. The flag is `None` if nothing that could overflow is drawn."""
        return self.difference(subject), None

    @abc.abstractmethod
    def seen(self, subject: Any) -> tuple[Seen, Overflow | None]:
        """The image that a user's loss compares, and whether silhouettes are missing, as for
        `difference_and_overflow`."""

    @abc.abstractmethod
    def compared(self, differences: Float[Array, "n h w"]) -> Float[Array, "n h w"]:
        """The part of each difference that the fit minimises, such as the blurred difference. Linear."""

    @abc.abstractmethod
    def laid_out(self, subject: Any) -> "AbstractProblem":
        """The same problem with maps in the layout of `subject`, unless `difference` draws them."""

    @abc.abstractmethod
    def planned(self) -> "AbstractProblem":
        """The same problem with the memory that traced drawings need."""

    @abc.abstractmethod
    def padded(self) -> "AbstractProblem":
        """The same problem with its meshes padded to a few sizes, so that problems of similar size share compiled
        programs."""


def any_overflow(found: Sequence[Overflow | None]) -> Overflow:
    """Whether any of several drawings ran out of memory. Drawings that cannot overflow are `None`."""
    known = [each for each in found if each is not None]
    xp = array_module(*known)
    return as_array(xp.any(xp.asarray(known, bool)))
