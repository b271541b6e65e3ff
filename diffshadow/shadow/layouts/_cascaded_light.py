"""A directional light whose shadow map has cascades: their views, the choice of a cascade for each point, and the
blending of cascades."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..._types import Mat4, Scalar
from ...geometry import AbstractLight, Tile, View
from ...settings.techniques import Cascades as Settings
from ...settings.techniques import CascadeSelection
from ._abstract import Choice
from ._fitted_light import AbstractFittedLight

MIN_BLEND = 1e-6
"""The minimum share of a slice over which cascades are blended, because 1 / blend has to be finite."""


class CascadedLight(AbstractFittedLight):
    """A directional light whose shadow map has a layer, called a cascade, for each of several ranges of a camera's
    depth. Each cascade is a part of the light's own map, drawn in all of its layer or in a part of it.

    `Cascades` makes one for a light and a camera.

    - `light`: the directional light.
    - `camera`: the view of the camera.
    - `begins`, `ends`: (l,), the range of depth along the camera's axis that each cascade covers, in world units. A
        range may begin before the previous range ends.
    - `scale`, `offset`: (l, 2), each cascade's window in the light's own clip space: the clip coordinates x and y of a
      point in the cascade are `scale · xy + offset`.
    - `margin`: (l, 2), the minimum distance of a point in a cascade from the cascade's border, in its clip space, if
      cascades are selected by map.
    - `select`: the method for the choice of a point's cascade.
    - `steps`: (l, 2), see `View.steps`.
    - `sides`: (l,), the side of each cascade in texels. A cascade is the lower left square of its layer, and the other
      texels stay empty. `None` if cascades fill their layers.
    """

    light: AbstractLight
    camera: View
    begins: Float[Array, " l"]
    ends: Float[Array, " l"]
    scale: Float[Array, "l 2"]
    offset: Float[Array, "l 2"]
    margin: Float[Array, "l 2"]
    select: CascadeSelection = eqx.field(static=True, default=Settings.select)
    steps: Float[Array, "l 2"] | None = None
    sides: Int[Array, " l"] | None = None

    @property
    def count(self) -> int:
        """The number of cascades."""
        return self.ends.shape[0]

    @property
    def names(self) -> tuple[str, ...]:
        """The content of each cascade, and its side in texels if cascades have different sides. Only for concrete
        lights."""
        names = [f"up to {float(end):.3g} deep" for end in self.ends]
        if self.sides is not None:
            names = [f"{name}, {int(side)}²" for name, side in zip(names, self.sides, strict=True)]
        return tuple(names)

    def view(self) -> View:
        own = self.light.view()
        eye_to_clip = _cropped(own.eye_to_clip, self.scale, self.offset)
        tile = None if self.sides is None else Tile(jnp.zeros((self.count, 2), jnp.int32), self.sides)
        return View(own.world_to_eye, eye_to_clip, own.near, own.far, own.is_perspective, self.steps, tile=tile)

    def layer(self, points: Float[Array, "*n 3"]) -> Int[Array, "*n"]:
        points = lax.stop_gradient(points)
        if self.select == "interval":
            # Written out, because a few comparisons in one pass are faster than a reduction.
            depth = self.depth(points)
            beyond = [depth > self.ends[k] for k in range(self.count - 1)]
            return sum((past.astype(jnp.int32) for past in beyond), start=jnp.zeros(depth.shape, jnp.int32))
        result = jnp.full(points.shape[:-1], self.count - 1, jnp.int32)
        for k in range(self.count - 2, -1, -1):
            result = jnp.where(self.to_border(points, k) >= 0, k, result)
        return result

    def to_border(self, points: Float[Array, "*n 3"], layer: Int[Array, "*n"] | int) -> Float[Array, "*n"]:
        """The distance of `points` inside the margin of cascade `layer`, in half widths of the cascade; negative
        outside of it."""
        own = self.light.view().clip(points)
        at = self.scale[layer] * own[..., :2] + self.offset[layer]
        inside = 1 - self.margin[layer] - jnp.abs(at)
        return jnp.minimum(inside[..., 0], inside[..., 1])

    def choose(self, points: Float[Array, "h w 3"], blend: Scalar | None, fade: float | None) -> Choice:
        """The cascades that `points` (h, w, 3), in world units, are looked up in, and their weights.

        **Arguments:**

        - `blend`: the fraction of a slice, or of the map's half width, over which a cascade fades into the next; `None`
          if cascades are not blended.
        - `fade`: the fraction of the last slice, at its end, over which shadows fade out; `None` if there are shadows
          beyond the slice.
        """
        layer, depth = self.layer(points), self.depth(points)
        strength = None if fade is None else self._strength(depth, fade)
        if blend is None or self.count == 1:
            return Choice(layer, strength=strength)
        other, last = jnp.minimum(layer + 1, self.count - 1), layer == self.count - 1
        if self.select == "interval":
            begins = jnp.concatenate([self.begins[:1], self.ends[:-1]])
            from_end = (self.ends[layer] - depth) / (self.ends - begins)[layer]
        else:
            last = last | (self.to_border(points, other) < 0)
            from_end = self.to_border(points, layer)
        weight = jnp.clip(from_end / jnp.maximum(blend, MIN_BLEND), 0, 1)
        return Choice(layer, other, jnp.where(last, 1, weight), strength)

    def _strength(self, depth: Float[Array, "h w"], fade: float) -> Float[Array, "h w"]:
        """The strength of shadows at a `depth`, from 1 to 0 beyond the last slice."""
        begin = self.begins[0] if self.count == 1 else self.ends[-2]
        from_end = (self.ends[-1] - depth) / (self.ends[-1] - begin)
        return jnp.where(from_end < 0, 0.0, 1.0) if fade == 0 else jnp.clip(from_end / fade, 0, 1)


@jax.jit
def _cropped(eye_to_clip: Mat4, scale: Float[Array, "l 2"], offset: Float[Array, "l 2"]) -> Float[Array, "l 4 4"]:
    """The projection of each cascade: rows x and y are scaled, and shifted by multiples of row w."""
    cropped = scale[..., None] * eye_to_clip[:2] + offset[..., None] * eye_to_clip[3]
    others = jnp.broadcast_to(eye_to_clip[2:], (len(scale), 2, 4))
    return jnp.concatenate([cropped, others], axis=-2)
