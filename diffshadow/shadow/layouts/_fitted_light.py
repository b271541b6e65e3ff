"""Directional lights whose shadow maps are fitted to a camera's view."""

import equinox as eqx
from jaxtyping import Array, Float

from ..._types import Scalar
from ...geometry import AbstractLight, Domain, View


class AbstractFittedLight(AbstractLight):
    """A directional light whose shadow map is fitted to a camera's view. Its light comes from another light.

    - `light`: the directional light.
    - `camera`: the view of the camera.
    """

    light: eqx.AbstractVar[AbstractLight]
    camera: eqx.AbstractVar[View]

    def depth(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The depth of `points` (..., 3) along the camera's axis, in world units."""
        return self.camera.distance(points)

    def cone_fraction(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        return self.light.cone_fraction(points)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        return self.light.towards(points, sample)

    @property
    def angular_radius(self) -> Scalar | None:
        """Half the light's angular diameter, in degrees. `None` for a light without a size."""
        return getattr(self.light, "angular_radius", None)

    @property
    def domain(self) -> Domain:
        return self.light.domain

    @property
    def is_directional(self) -> bool:
        return self.light.is_directional

    @property
    def has_size(self) -> bool:
        return self.light.has_size
