"""Look-ups: the positions where biased receivers sample the map, and the depths that they compare with.

A look-up is a receiver after its bias: a position x and y in texels and a window depth, each (h, w). A kernel reads
texels around the position, its taps, and compares their stored depths with this depth. With a receiver plane, the depth
changes from tap to tap by a slope, in window depth per texel, along x and along y, (h, w) each. All operations are
elementwise, so any shape (*n,) works instead of (h, w), such as a chunk of pixels or a list of gathered ones.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._arithmetic import components
from .._types import Mask
from ._map import ShadowMap
from ._receiver import Receiver, project
from .biases import BiasTerms


class Lookup(eqx.Module):
    """The places where receivers sample the map, and the depths that they compare. Shapes are given for an image; any
    other shape works too.

    - `x`, `y`: (h, w), in texels; the centre of the first texel is at (0.5, 0.5). `Lookup(...)` takes both as one array
        `texel` (h, w, 2).
    - `depth`: (h, w), the receiver's window depth minus its bias.
    - `depth_per_texel`: (h, w), window depth per texel width, the unit of a soft compare.
    - `inside`: (h, w), whether the receiver is in front of the light and closer than the far plane.
    - `slope`: the receiver plane's window depth per texel along x and y, (h, w) each. Each tap compares with the plane
        at the centre of its texel. `None` if all taps compare with the same depth. `Lookup(...)` takes one array (h, w,
        2).
    - `layer`: (h, w), the number of the light's map that is read; `None` if there is only one.
    - `deepest`: (h, w), upper bound on the window depth of the receiver plane; `None` for no bound.
    - `position`: the points in the world whose projections are x and y: their x, y and z, (h, w) each; `None` if not
        known. If it is known, derivatives with respect to x and y under a hard compare are computed only where there
        are silhouettes. `Lookup(...)` takes one array (h, w, 3).
    """

    # Separate arrays for x and y: XLA does not vectorize them when they are interleaved in memory.
    x: Float[Array, "*n"]
    y: Float[Array, "*n"]
    depth: Float[Array, "*n"]
    depth_per_texel: Float[Array, "*n"]
    inside: Bool[Array, "*n"]
    slope: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None
    layer: Int[Array, "*n"] | None
    deepest: Float[Array, "*n"] | None
    position: tuple[Float[Array, "*n"], ...] | None

    def __init__(
        self,
        texel: Float[Array, "*n 2"],
        depth: Float[Array, "*n"],
        depth_per_texel: Float[Array, "*n"],
        inside: Bool[Array, "*n"],
        slope: Float[Array, "*n 2"] | None = None,
        layer: Int[Array, "*n"] | None = None,
        deepest: Float[Array, "*n"] | None = None,
        position: Float[Array, "*n 3"] | None = None,
    ):
        self.x, self.y = components(texel)
        self.depth, self.depth_per_texel, self.inside = depth, depth_per_texel, inside
        self.slope = None if slope is None else components(slope)
        self.layer, self.deepest = layer, deepest
        self.position = None if position is None else components(position)

    @property
    def texel(self) -> Float[Array, "*n 2"]:
        """x and y in one array."""
        return jnp.stack([self.x, self.y], axis=-1)

    def at(self, x: Float[Array, "*n"], y: Float[Array, "*n"]) -> "Lookup":
        """The same look-up elsewhere."""
        moved = lambda lookup: (lookup.x, lookup.y, lookup.position)
        return eqx.tree_at(moved, self, (x, y, None), is_leaf=lambda leaf: leaf is None)

    def of(self, position: tuple[Float[Array, "*n"], ...]) -> "Lookup":
        """The same look-up with points whose projections are x and y."""
        return eqx.tree_at(lambda lookup: lookup.position, self, position, is_leaf=lambda leaf: leaf is None)

    def depths_within(self, reach: Float[Array, "..."]) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
        """The minimum and maximum depth that texels are compared with, within `reach` texels along x and y."""
        if self.slope is None:
            return self.depth, self.depth
        # Texel centres may be half a texel farther away. The rest is for rounding.
        change = (jnp.abs(self.slope[0]) + jnp.abs(self.slope[1])) * (reach + 1)
        low, high = self.depth - change, self.depth + change
        if self.deepest is not None:
            low, high = jnp.minimum(low, self.deepest), jnp.minimum(high, self.deepest)
        return low, high

    def detached(self) -> "Lookup":
        """The same look-up without derivatives with respect to its position."""
        return self.at(*lax.stop_gradient((self.x, self.y)))

    def with_depths_detached(self) -> "Lookup":
        """The same look-up without derivatives with respect to the compared depths."""
        depths = lambda lookup: (lookup.depth, lookup.depth_per_texel, lookup.slope, lookup.deepest)
        return eqx.tree_at(depths, self, lax.stop_gradient(depths(self)), is_leaf=lambda leaf: leaf is None)


def rearranged(tree: Any, function: Callable[[Array], Array]) -> Any:
    """Applies `function` to all arrays of a look-up or a kernel that have one value per pixel."""
    return jax.tree.map(lambda leaf: function(leaf) if eqx.is_array(leaf) and leaf.ndim else leaf, tree)


def look_up(shadow_map: ShadowMap, at: Receiver, terms: BiasTerms) -> Lookup:
    """The look-ups of receivers under a bias."""
    position, texel, depth, in_front = at.position, at.texel, at.depth, at.in_front
    if terms.displacement is not None:
        position = position + terms.displacement
        texel, depth, in_front = project(shadow_map.view.facing(at.layer), shadow_map.resolution, position)
    inside = in_front & (depth <= 1)
    depth = depth - terms.depth
    slope = deepest = None
    if terms.follows_plane:
        slope = at.slope * at.depth_per_texel[..., None]
        deepest = None if terms.deepening is None else depth + terms.deepening
    if shadow_map.depth_format != "float32":
        # For fixed-point maps, the compared depth is clamped to [0, 1] (OpenGL 4.6, section 8.23.1).
        if slope is None:
            depth = jnp.clip(depth, 0, 1)
        else:
            deepest = jnp.ones_like(depth) if deepest is None else jnp.minimum(deepest, 1)
    return Lookup(texel, depth, at.depth_per_texel, inside, slope, at.layer, deepest, position)


def within_frustum(lookup: Lookup, shadow_map: ShadowMap) -> Mask:
    """Whether each receiver is inside the map and not on its border, (h, w)."""
    height, width = shadow_map.view.facing(lookup.layer).shown(shadow_map.resolution)
    return lookup.inside & (lookup.x >= 0) & (lookup.y >= 0) & (lookup.x <= width) & (lookup.y <= height)
