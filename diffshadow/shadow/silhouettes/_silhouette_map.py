"""Silhouette maps: shadow maps that store the caster's outline within each texel.

Sen, Cammarano & Hanrahan ("Shadow Silhouette Maps", SIGGRAPH 2003) store a point of the silhouette in each texel that
it passes through. Here the outline is traced by marching squares (Lorensen & Cline 1987), but its crossings with the
sides of texels come from the silhouette edges and are not interpolated from samples. The outline is therefore closed,
hidden folds of a mesh drop out, and hard shadows have sub-texel accuracy. The crossings move with the light and the
vertices, which gives visibility its derivatives.

Two edges that meet within a texel keep their corner. In a longer chain, only the first and the last edge are kept, or
the chain is cut short. Parts of a caster narrower than a texel are lost if they cross fewer than two of its sides.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..._arithmetic import take
from ._contour import find_contours
from ._crossings import Grid, find_crossings
from ._half_planes import WHOLE_TEXEL, HalfPlanes, Rectangle, cut_area
from ._outline import Outline

NO_SILHOUETTE = -1
"""Value of `SilhouetteMap.slot` for texels without a silhouette."""


class SilhouetteMap(eqx.Module):
    """The silhouettes in a shadow map.

    - `slot`: (h, w), or (l, h, w), the index of each texel's silhouette in the other arrays; `NO_SILHOUETTE` for none.
    - `planes`: two half-planes each, (2, s), in texels from the texel's centre. They carry the outline's derivative.
    - `inner`, `outer`: (s,), window depths inside both half-planes, and elsewhere in the texel; 1 if empty.
    - `follows`: (s,), whether the outline comes from silhouette edges and moves with them. Otherwise it was found from
        samples only, for example where meshes intersect.
    """

    slot: Int[Array, "*l h w"]
    planes: HalfPlanes
    inner: Float[Array, " s"]
    outer: Float[Array, " s"]
    follows: Bool[Array, " s"]

    def mean_of(self, function: Callable[[Array], Any], depth: Float[Array, "*l h w"]) -> Any:
        """The mean of a `function` of depth over each texel. The function must keep the shape of its argument. `depth`
        is the map's."""
        fraction = self.area_within(jnp.arange(self.inner.shape[0], dtype=jnp.int32), WHOLE_TEXEL)
        blend = lambda inner, outer: outer + fraction * (inner - outer)
        means = jax.tree.map(blend, function(self.inner), function(self.outer))
        pick = lambda plain, mean: jnp.where(self.slot == NO_SILHOUETTE, plain, take(mean, jnp.maximum(self.slot, 0)))
        return jax.tree.map(pick, function(depth), means)

    def by_texel(
        self, depth: Float[Array, "*l h w"]
    ) -> tuple[Float[Array, "*l h w"], Float[Array, "*l h w"], Float[Array, "*l h w"]]:
        """The fraction of each texel inside its half-planes, and the depths inside and outside.

        A texel without a silhouette is entirely inside. `depth` is the map's.
        """
        area = self.area_within(jnp.arange(self.inner.shape[0], dtype=jnp.int32), WHOLE_TEXEL)
        pick = lambda plain, of_slot: jnp.where(
            self.slot == NO_SILHOUETTE, plain, take(of_slot, jnp.maximum(self.slot, 0))
        )
        return pick(1, area), pick(depth, self.inner), pick(depth, self.outer)

    def area_within(
        self,
        slot: Int[Array, "*n"],
        part: Rectangle,
        motion: tuple[Float[Array, "*n"], Float[Array, "*n"]] | None = None,
    ) -> Float[Array, "*n"]:
        """Area, in square texels, of the `part` of a texel inside both half-planes.

        `part` is relative to the texel's centre. Half-planes that follow edges are moved by `motion` (texels) if given.
        """
        # Two separate arrays, because XLA would write a stacked array to memory.
        of_slot = lambda values: [take(one, slot) for one in values]
        x, y, offset = map(of_slot, self.planes)
        if motion is not None:
            follows = take(self.follows, slot)
            along = lambda a, b: jnp.where(follows, a * motion[0] + b * motion[1], 0)
            offset = [o + along(a, b) for a, b, o in zip(x, y, offset, strict=True)]
        return cut_area(part, HalfPlanes(x, y, offset))


def find_silhouettes(
    depth: Float[Array, "*l h w"],
    corners: Float[Array, "*l H W"],
    outline: Outline,
    capacity: int,
) -> SilhouetteMap:
    """The silhouettes in a map.

    **Arguments:**

    - `depth`: (h, w), the map's depths; `corners`: (h + 1, w + 1), depth at the corners of its texels.
    - `capacity`: the number of crossings that are processed; compare it with `outline.counts`.
    """
    height, width = depth.shape[-2:]
    grid = Grid(depth.size // (height * width), height, width)
    # At least 1, because an empty array cannot be indexed.
    capacity = max(capacity, 1)
    crossings = find_crossings(outline, corners.reshape(-1), grid, capacity)
    found = find_contours(depth.reshape(-1), corners.reshape(-1), crossings, grid)
    number = jnp.arange(2 * capacity, dtype=jnp.int32)
    place = jnp.where(found.exists, crossings.texel, grid.texels)
    slot = jnp.full(grid.texels + 1, NO_SILHOUETTE, jnp.int32).at[place].max(number)[:-1]
    return SilhouetteMap(slot.reshape(depth.shape), found.planes, found.inner, found.outer, found.follows)
