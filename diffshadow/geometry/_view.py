"""Views: the pose and projection of a camera or a light."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._arithmetic import with_gradient_of
from ._pages import Pages, Tile
from ._transforms import transform_points, transform_vectors
from ._warp import Warp


class View(eqx.Module):
    """A pose and a projection.

    If a light has several views, `world_to_eye` or `eye_to_clip` or both have shape (l, 4, 4).

    - `world_to_eye`: (4, 4), rigid; the eye looks along `-z`.
    - `eye_to_clip`: (4, 4), OpenGL clip space.
    - `near`, `far`: distances along the view axis of window depth 0 and 1, in world units. For several views, one value
        for all, or (l,).
    - `is_perspective`: whether sizes shrink with distance.
    - `steps`: (2,), for a parallel view: the number of steps along x and y for each unit of clip space. Vertices are
      drawn at whole steps from the eye's axis, not from the window's border. A window that moves by whole steps then
      sees the same triangles to the bit. `None` if vertices are not snapped to steps. For several views, (l, 2).
    - `warp`: for a parallel view without steps: a perspective of its window. It moves points in the window, and keeps
      the depths of the parallel view. `None` for no warp.
    - `tile`: for a parallel view: the part of a virtual map that each layer shows. The projection covers the whole
        virtual map. `None` if a map shows the whole window. A virtual map that is smaller than its layer ends within
        the layer.
    - `pages`: the pages of a virtual map that the layers show; `tile` then belongs to the pages. `None` for a map
        without pages.
    """

    world_to_eye: Float[Array, "*l 4 4"]
    eye_to_clip: Float[Array, "*m 4 4"]
    near: Float[Array, "*n"]
    far: Float[Array, "*n"]
    is_perspective: bool = eqx.field(static=True)
    steps: Float[Array, "*k 2"] | None = None
    warp: Warp | None = None
    tile: Tile | None = None
    pages: Pages | None = None

    @eqx.filter_jit
    def facing(self, layer: Int[Array, "*n"] | None) -> "View":
        """For a light with several views, the view of `layer` for each point; this view if there are no layers."""
        if layer is None:
            return self
        each = lambda matrix: matrix[layer] if matrix.ndim > 2 else matrix
        view = self._with(each(self.world_to_eye), each(self.eye_to_clip))
        if jnp.ndim(self.near):
            view = dataclasses.replace(view, near=self.near[layer], far=self.far[layer])
        return view if self.tile is None else dataclasses.replace(view, tile=self.tile.facing(layer), pages=None)

    def whole(self, resolution: tuple[int, int]) -> tuple[int | Int[Array, "*n"], int | Int[Array, "*n"]]:
        """(height, width), in texels, of the map that the projection shows, for layers of `resolution`. If the layer is
        a part of a virtual map, this is the size of the virtual map."""
        return resolution if self.tile is None else (self.tile.size, self.tile.size)

    def shown(self, resolution: tuple[int, int]) -> tuple[int | Int[Array, "*n"], int | Int[Array, "*n"]]:
        """(height, width), in texels, of the used part of a layer of `resolution`. It is smaller than the layer if the
        virtual map ends within it."""
        if self.tile is None:
            return resolution
        end = self.tile.size[..., None] - self.tile.origin
        return jnp.minimum(end[..., 1], resolution[0]), jnp.minimum(end[..., 0], resolution[1])

    @property
    def matrix(self) -> Float[Array, "*l 4 4"]:
        """World space to clip space, (4, 4), without the warp."""
        return jnp.matmul(self.eye_to_clip, self.world_to_eye, precision="highest")

    @property
    def has_even_texels(self) -> bool:
        """Whether a map's texels divide the window evenly: there is no warp, and no layer shows a part of a virtual
        map."""
        return self.warp is None and self.tile is None

    @property
    def unwarped(self) -> "View":
        """The same view without its warp."""
        return dataclasses.replace(self, warp=None)

    @eqx.filter_jit
    def clip(self, points: Float[Array, "*n 3"]) -> Float[Array, "*k 4"]:
        """Clip coordinates of world `points`. For a light with several views, one view for each point."""
        # Two steps keep precision for small scenes far from the world's origin.
        eye = transform_points(self.world_to_eye, points)[..., :3]
        clip = transform_points(self.eye_to_clip, eye)
        return clip if self.warp is None else self.warp(clip)

    @eqx.filter_jit
    def clip_vertices(self, vertices: Float[Array, "v 3"]) -> Float[Array, "*l v 4"]:
        """Clip coordinates of a mesh's `vertices` in each view, at whole steps if the view has any."""
        # Broadcasts each view's matrix over all vertices.
        spread = lambda matrix: matrix[..., None, :, :] if matrix.ndim > 2 else matrix
        view = self._with(spread(self.world_to_eye), spread(self.eye_to_clip))
        clip = view.clip(vertices)
        if self.steps is None:
            return clip
        eye = transform_points(view.world_to_eye, vertices)[..., :3]
        from_axis, offset = transform_vectors(view.eye_to_clip, eye)[..., :2], view.eye_to_clip[..., :2, 3]
        steps = self.steps[..., None, :]
        whole = jnp.round(from_axis * steps) + jnp.round(offset * steps)
        return jnp.concatenate([with_gradient_of(clip[..., :2], whole / steps), clip[..., 2:]], axis=-1)

    @eqx.filter_jit
    def shifted(self, texels: Float[Array, "2"], resolution: tuple[int, int]) -> "View":
        """The view with a shifted window: points move by `texels` along x and y of a map of `resolution`.

        **Raises** `ValueError` unless texels are even.
        """
        if not self.has_even_texels:
            raise ValueError(
                "a shift by texels was given for a view with a warp, with pages or with layers of several sizes; "
                "expected one whose texels are even: leave the shift out, or use another layout"
            )
        in_clip = jnp.append(2 * texels / jnp.array(resolution[::-1], texels.dtype), jnp.zeros(2, texels.dtype))
        moved = self.eye_to_clip + in_clip[:, None] * self.eye_to_clip[..., 3:, :]
        return self._with(self.world_to_eye, moved)

    def _with(self, world_to_eye: Float[Array, "*l 4 4"], eye_to_clip: Float[Array, "*m 4 4"]) -> "View":
        matrices = lambda view: (view.world_to_eye, view.eye_to_clip)
        return eqx.tree_at(matrices, self, (world_to_eye, eye_to_clip))

    @eqx.filter_jit
    def distance(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Distance of `points` (..., 3) along the view axis, in world units; negative behind the eye."""
        return -transform_points(self.world_to_eye, points)[..., 2]

    def eye_depth(self, depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Distance along the view axis, in world units, of window `depth`."""
        if self.is_perspective:
            # z = n f / (f − d (f − n))
            return self.near * self.far / (self.far - depth * (self.far - self.near))
        return self.near + depth * (self.far - self.near)

    def depth_slope(self, distance: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """Window depth per world unit along the view axis, at `distance` in world units."""
        span = self.far - self.near
        if self.is_perspective:
            # d = f (z − n) / (z (f − n)), so dd/dz = f n / ((f − n) z²)
            return self.far * self.near / (span * distance * distance)
        return jnp.broadcast_to(1 / span, jnp.shape(distance))

    def texel_extent(
        self,
        distance: Float[Array, "*n"],
        resolution: tuple[int, int],
        texel: Float[Array, "*n 2"] | None = None,
    ) -> Float[Array, "*n 2"]:
        """Width and height of one texel (or pixel) of a map of `resolution`, in world units, at `distance` along the
        view axis.

        **Arguments:**

        - `texel`: the position in the map, x and y in texels. Only texels of a warped view depend on it. Without it,
          the result is for the view without the warp.
        """
        height, width = self.whole(resolution)
        # Clip space spans 2 units over the map; the projection's diagonal is clip units per eye unit (at distance 1).
        across, up = self.eye_to_clip[..., 0, 0], self.eye_to_clip[..., 1, 1]
        at_unit = 2 / jnp.stack([across * width, up * height], axis=-1)
        extent = at_unit * (distance if self.is_perspective else jnp.ones_like(distance))[..., None]
        if self.warp is None or texel is None:
            return extent
        return self.warp.texel_extent(extent, texel[..., 1] / resolution[0])

    def texel_size(
        self,
        distance: Float[Array, "*n"],
        resolution: tuple[int, int],
        texel: Float[Array, "*n 2"] | None = None,
    ) -> Float[Array, "*n"]:
        """The geometric mean of a texel's width and height, in world units; arguments as for `texel_extent`."""
        extent = self.texel_extent(distance, resolution, texel)
        # Not `prod`, because XLA does not fuse reductions.
        return jnp.sqrt(extent[..., 0] * extent[..., 1])

    def along_axes(
        self, gradient: Float[Array, "*n 2"], texel: Float[Array, "*n 2"], resolution: tuple[int, int]
    ) -> Float[Array, "*n 2"]:
        """The change of a quantity along the rows and columns of a map of `resolution` at `texel`, per unit of x and y,
        from the `gradient` of the quantity along x and y in eye space. Both are the same, unless a warp tilts the
        columns."""
        if self.warp is None:
            return gradient
        in_clip = self.warp.lean(texel[..., 0] * (2 / resolution[1]) - 1)
        lean = in_clip * self.eye_to_clip[..., 1, 1] / self.eye_to_clip[..., 0, 0]
        return jnp.stack([gradient[..., 0], gradient[..., 1] + lean * gradient[..., 0]], axis=-1)
