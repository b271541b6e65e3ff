"""Lights: the view that a shadow map is drawn from, and the rays that a reference is traced with.

Every light answers two questions. `view()` says how its shadow map projects; `towards(points, sample)` says which way
the light lies. A light may have a size: `sample` picks a point of it, `(0, 0)` its centre, which is where the shadow
map is drawn from.
"""

import abc
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..._misc import concrete
from ..._types import Scalar, Vec2, Vec3
from .._view import View
from ._pose import LightPose

Domain = Literal["disk", "square"]
"""Where samples of a light lie: in the disk of radius 1, or in the square [-1, 1]²."""

UP = (0.0, 1.0, 0.0)
"""The upright direction of shadow maps, unless a light says otherwise."""


class AbstractLight(eqx.Module):
    """A light that casts shadows."""

    @abc.abstractmethod
    def view(self) -> View:
        """The projection of the light's shadow map."""

    @abc.abstractmethod
    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        """Vectors from `points` to the light.

        **Arguments:**

        - `points`: (..., 3), world units.
        - `sample`: (..., 2), a point of the light's `domain` for each of them; which point of the light is meant.
            Samples even over the domain are even over the light's area, or over what of it shows its outline. The
            centre if left out.

        **Returns:** (..., 3). To a light at a finite distance, the whole way in world units; to a directional light,
        a vector along the way whose length means nothing.
        """

    @abc.abstractmethod
    def layer(self, points: Float[Array, "*n 3"]) -> Int[Array, "*n"] | None:
        """Which of its views sees each of `points`; `None` for a light that looks one way only."""

    def cone_fraction(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The fraction of its light, (...,) in [0, 1], that the light sends towards each of `points` (..., 3), in world
        units; 1 for a light without a cone. Shading obeys it, visibility does not."""
        return jnp.ones(points.shape[:-1])

    def pose(self) -> LightPose:
        """The numbers by which the light can be placed, as it stands; all none for a kind that cannot be."""
        return LightPose()

    def at(self, pose: LightPose) -> "AbstractLight":
        """The same light in a `pose` of its kind. The frustum of its shadow map does not follow: see `refitted`."""
        return self

    def refitted(self, points: Float[Array, "n 3"]) -> "AbstractLight":
        """The same light with the frustum of its shadow map refitted to `points` (n, 3), also under a trace.

        The frustum carries no gradient; where the light stands and which way it shines do. A light that cannot be
        refitted stays as it is.
        """
        return self

    @property
    @abc.abstractmethod
    def domain(self) -> Domain:
        """Where the samples that `towards` takes lie."""

    @property
    @abc.abstractmethod
    def is_directional(self) -> bool:
        """Whether the light is infinitely far away."""

    @property
    @abc.abstractmethod
    def has_size(self) -> bool:
        """Whether the light has an area, so that its shadows have penumbrae. Only for concrete lights."""


def check_direction(name: str, direction: Vec3, what: str = "direction") -> None:
    """**Raises** `ValueError` if `direction` is known and points nowhere."""
    d = concrete(direction)
    if d is not None and not (np.isfinite(d).all() and (d != 0).any()):
        raise ValueError(f"{name}'s {what} is {d.tolist()}; expected a finite vector that is not zero")


def check_position(name: str, position: Vec3) -> None:
    """**Raises** `ValueError` if `position` is known and not finite."""
    p = concrete(position)
    if p is not None and not np.isfinite(p).all():
        raise ValueError(f"{name}'s position is {p.tolist()}; expected finite world coordinates")


def check_size(name: str, what: str, size: Scalar | Vec2) -> None:
    """**Raises** `ValueError` if `size` is known and not finite, or less than 0."""
    s = concrete(size)
    if s is not None and not ((s >= 0) & np.isfinite(s)).all():
        raise ValueError(f"{name}'s {what} is {s.tolist()}; expected world units, 0 or more")
