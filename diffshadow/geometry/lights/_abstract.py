"""Lights: the view that a shadow map is drawn from, and the rays that a reference is traced with.

`view()` is the projection of the light's shadow map; `towards(points, sample)` is the direction to the light. A light
may have a size: `sample` picks a point on it. `(0, 0)` is its centre, from which the shadow map is drawn.
"""

import abc
from typing import Literal

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..._checks import CheckedModule, check_value
from ..._types import Vec3
from ...settings.quantities import Direction, Position
from .._view import View
from ._pose import LightPose

Domain = Literal["disk", "square"]
"""The domain of a light's samples: the disk of radius 1, or the square [-1, 1]²."""


class AbstractLight(CheckedModule):
    """A light that casts shadows."""

    @abc.abstractmethod
    def view(self) -> View:
        """The projection of the light's shadow map."""

    @abc.abstractmethod
    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        """Vectors from `points` to the light.

        **Arguments:**

        - `points`: (..., 3), world units.
        - `sample`: (..., 2), for each point, a sample of the light's `domain`, which selects a point on the light.
            Samples uniform over the domain are uniform over the light's area, or over its visible disk. By default the
            centre.

        **Returns:** (..., 3). For a light at a finite distance, the vector to it in world units; for a directional
        light, a vector of arbitrary length towards it.
        """

    def layer(self, points: Float[Array, "*n 3"]) -> Int[Array, "*n"] | None:
        """The index of the view that sees each of `points`; `None` for a light with one view."""
        return None

    def cone_fraction(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The fraction of its light, (...,) in [0, 1], that the light emits towards each of `points` (..., 3), in world
        units; 1 for a light without a cone. It affects shading, but not visibility."""
        return jnp.ones(points.shape[:-1])

    def pose(self) -> LightPose:
        """The light's pose. All fields are `None` for a light whose pose cannot be fitted."""
        return LightPose()

    def at(self, pose: LightPose) -> "AbstractLight":
        """The same light in another `pose`. The frustum of its shadow map does not move; see `refitted`."""
        return self

    def refitted(self, points: Float[Array, "n 3"]) -> "AbstractLight":
        """The same light with the frustum of its shadow map refitted to `points` (n, 3), also under `jit`.

        The frustum carries no gradient; the light's position and direction do. A light that cannot be refitted is
        returned unchanged.
        """
        return self

    @property
    def domain(self) -> Domain:
        """The domain of the samples that `towards` takes."""
        return "disk"

    @property
    def is_directional(self) -> bool:
        """Whether the light is infinitely far away."""
        return False

    @property
    @abc.abstractmethod
    def has_size(self) -> bool:
        """Whether the light has an area, so that its shadows have penumbrae. Only for concrete lights."""


def check_direction(name: str, direction: Vec3, what: str = "direction") -> None:
    """**Raises** `ValueError` if `direction` is known, and zero or not finite."""
    check_value(f"{name}'s {what}", direction, Direction)


def check_position(name: str, position: Vec3) -> None:
    """**Raises** `ValueError` if `position` is known, and not finite or too far away."""
    check_value(f"{name}'s position", position, Position)
