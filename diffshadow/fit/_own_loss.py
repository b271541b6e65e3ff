"""Users' losses: any function of images instead of mean square errors."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._types import Mask, Visibility

LossFunction = Callable[[Visibility, Visibility, Mask], Array]
"""From the predicted image, the reference and the mask, each (h, w), to a number or to residuals."""

_EXPECTED = (
    "a function of three images (h, w), predicted, reference and mask, that returns a number or an array of residuals "
    "made with jax.numpy"
)


class Seen(NamedTuple):
    """The images that a loss compares: one image (h, w), or several images of one size (n, h, w).

    - `predicted`: equals the reference at pixels that do not count.
    - `mask`: the pixels that count.
    """

    predicted: Float[Array, "*n h w"]
    reference: Float[Array, "*n h w"]
    mask: Bool[Array, "*n h w"]

    @classmethod
    def of(
        cls, image: Float[Array, "*n h w"], reference: Float[Array, "*n h w"], mask: Bool[Array, "*n h w"]
    ) -> "Seen":
        """One image or several. Outside the mask, the reference replaces the predicted image, which may have any value
        there."""
        return cls(jnp.where(mask, image, reference), reference, mask)


class OwnLoss(eqx.Module):
    """A user's loss: the mean of `function` over all images.

    - `function`: any callable, such as a function or an `equinox.Module`. The arrays of a module are arguments of
      compiled programs.
    - `is_scalar`: whether it returns a number, 0 or more. Otherwise it returns an array of residuals, whose squares are
      summed.
    """

    function: LossFunction
    is_scalar: bool = eqx.field(static=True)

    @classmethod
    def of(cls, function: Any, shapes: Iterable[tuple[int, ...]]) -> "OwnLoss":
        """The loss of images of these `shapes`, (h, w). `function` is traced for them.

        **Raises** `TypeError` if it is not a function of three images, or does not return a valid loss.
        """
        if not callable(function) or isinstance(function, type):
            given = f"the class {function.__name__}" if isinstance(function, type) else f"of type {_name(function)}"
            raise TypeError(f'the loss is {given}; expected a fit.Loss, such as Loss("worst"), or {_EXPECTED}')
        function = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, np.ndarray) else leaf, function)
        for leaf in jax.tree.leaves(function):
            if not eqx.is_array(leaf) and getattr(leaf, "__hash__", None) is None:
                raise TypeError(
                    f"the loss holds a {_name(leaf)}, which has no hash; expected a plain function, or an "
                    "equinox.Module whose numbers are arrays or static fields"
                )
        kinds = {_is_scalar(function, shape) for shape in sorted(set(shapes))}
        if len(kinds) > 1:
            raise TypeError("the loss returns a number for some images and residuals for others; expected one kind")
        return cls(function, kinds.pop())

    def rows(self, images: Seen) -> Float[Array, "n m"]:
        """The residuals of each image, or its loss, (n, 1). The function gets one image at a time."""
        several = Seen(*(each.reshape(-1, *each.shape[-2:]) for each in images))
        one = lambda seen: jnp.ravel(self.function(*seen)).astype(jnp.float32)
        if len(several.mask) == 1:
            return one(Seen(*(each[0] for each in several)))[None]
        return jax.lax.map(one, several)

    def of_rows(self, rows: Float[Array, "n m"]) -> Float[Array, " n"]:
        """The loss of each image, from its row."""
        return rows[:, 0] if self.is_scalar else jnp.sum(rows**2, axis=1)


def _is_scalar(function: LossFunction, shape: tuple[int, ...]) -> bool:
    image = jax.ShapeDtypeStruct(shape, jnp.float32)
    found = eqx.filter_eval_shape(function, image, image, jax.ShapeDtypeStruct(shape, jnp.bool_))
    if not hasattr(found, "shape") or not jnp.issubdtype(found.dtype, jnp.floating):
        given = f"an array of {found.dtype}" if hasattr(found, "dtype") else f"an object of type {_name(found)}"
        raise TypeError(f"the loss returns {given}; expected {_EXPECTED}")
    return found.shape == ()


def _name(value: Any) -> str:
    return type(value).__name__
