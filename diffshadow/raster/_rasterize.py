"""The rasterizer: the visible triangle of each pixel."""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from .._arithmetic import as_float, is_traced
from .._checks import check_value
from .._padding import padded_to, shared_mesh_size
from .._types import Faces, Resolution
from ..geometry import Pages, Textures
from ..settings import maps
from ..settings.maps import Cull
from ..settings.quantities import MAX_TEXELS, Size
from ._alpha_test import AlphaTest
from ._band_pass import BandDrawing, bands_of
from ._bins import FACING, bin_triangles
from ._depth_test import DepthTest
from ._page_pass import PagedDrawing
from ._windows import Drawing, DrawPass, least_depth, least_depth_and_face

NO_FACE = -1
"""The value in a face map for a pixel that sees nothing."""


class Fragments(eqx.Module):
    """The visible surface of each pixel. Row 0 is the bottom row. Neither field carries a gradient; `interpolate` does.

    - `face`: (h, w), index of the nearest face, or `NO_FACE` if there is no face.
    - `depth`: (h, w), the window depth as the depth buffer stores it; 1 if there is no face.

    For several views, the shapes are (b, h, w).
    """

    face: Int[Array, "*b h w"]
    depth: Float[Array, "*b h w"]


def padded(clip: Float[Array, "*b v 4"], faces: Faces) -> tuple[Any, Any]:
    """The triangles, padded as by `Mesh.padded`, so that meshes of similar size share compiled programs.

    **Returns:** both arrays. On CPUs, padded arrays are NumPy arrays.
    """
    if isinstance(clip, Tracer) or isinstance(faces, Tracer):
        return clip, faces
    size, vertices = shared_mesh_size(faces.shape[0], clip.shape[-2])
    if (size, vertices) == (faces.shape[0], clip.shape[-2]):
        return clip, faces
    # NumPy copies on CPUs need no compilation, and compiled programs accept them directly.
    return padded_to(clip, vertices, axis=-2), padded_to(faces, size)


def rasterize(
    clip: Float[Array, "*b v 4"],
    faces: Faces,
    resolution: Resolution,
    *,
    cull: Cull = maps.ShadowMap.cull,
    depth_test: DepthTest | None = None,
    polygon_offset: Any = None,
    behind: Int[Array, "*l h w"] | None = None,
    pages: Pages | None = None,
    viewports: Int[Array, "*b 2"] | None = None,
    buffer: Resolution | None = None,
    alpha_test: Textures | None = None,
) -> Fragments:
    """The nearest face at every pixel centre, by OpenGL's rules.

    Triangles snap to 1/256 pixel, and each shared edge is covered exactly once. Geometry in front of the near plane or
    beyond the far plane is clipped.

    **Arguments:**

    - `clip`: (v, 4), vertices in OpenGL clip space; `w` may have either sign. With a leading axis, (b, v, 4), the views
      are drawn one after another, and every result also has that axis.
    - `faces`: (f, 3), indices into `clip`. Front faces are anticlockwise in the window.
    - `resolution`: (height, width) in pixels, each at most 8192.
    - `cull`: the faces that are not drawn.
    - `depth_test`: format and comparison of the depth buffer; by default float32 and `"less"`.
    - `polygon_offset`: (factor, units) of OpenGL's polygon offset, or `None`.
    - `behind`: (h, w), a face map with the face to skip at each pixel. With the result of a first call, this draws the
      second-nearest layer.
    - `pages`: draws these pages of a virtual map instead of an image. Each page has its own layer, and results have
      shape (l, h, w). `clip` is the single view of the virtual map, and `resolution` is the size of a layer.
    - `viewports`: (2,), or (b, 2) for several views: (height, width) in pixels of the lower left part of the image into
      which each view is drawn. Pixels outside that part see nothing.
    - `buffer`: (height, width) in pixels, at least `resolution`: draws into a part of an image of this size. Outside of
      `jit`, drawings with the same buffer share compiled programs. Under `jit`, and with pages, `buffer` is ignored.
    - `alpha_test`: `Mesh.alpha_test`: textures of the faces. Their cutoffs cut out pixels, like `discard` in a fragment
      shader.

    **Raises** `ValueError` for a resolution, buffer or depth test out of range.
    """
    return _Request(
        clip, faces, resolution, cull, depth_test, polygon_offset, alpha_test, True, behind, pages, viewports, buffer
    ).drawn()


def rasterize_depth(
    clip: Float[Array, "*b v 4"],
    faces: Faces,
    resolution: Resolution,
    *,
    cull: Cull = maps.ShadowMap.cull,
    depth_test: DepthTest | None = None,
    polygon_offset: Any = None,
    alpha_test: Textures | None = None,
) -> Float[Array, "*b h w"]:
    """The depth buffer alone, (h, w): `rasterize(...).depth`, in less time. It carries no gradient."""
    return _Request(clip, faces, resolution, cull, depth_test, polygon_offset, alpha_test, with_face=False).drawn()


class _Scene(NamedTuple):
    """The input of one view: `clip` (v, 4), the fields of `_Request`, and textures of all faces."""

    clip: Any
    faces: Any
    polygon_offset: Any
    behind: Array | None
    textures: Textures | None


# Smaller images are drawn into buffers with this side.
_SHARED_SIDE = 256
# In pixels of several views. Larger results are combined when they are ready, because XLA then copies them in this
# thread. In XLA's threads, the C library takes fresh pages for arrays of more than 64 MiB each time.
_MAX_WAITING = 1 << 23


@dataclasses.dataclass(frozen=True)
class _Request:
    """The arguments of `rasterize`, and whether faces are needed."""

    clip: Float[Array, "*b v 4"]
    faces: Faces
    resolution: Resolution
    cull: Cull
    depth_test: DepthTest | None
    polygon_offset: Any
    alpha_test: Textures | None
    with_face: bool
    behind: Int[Array, "*l h w"] | None = None
    pages: Pages | None = None
    viewports: Int[Array, "*b 2"] | None = None
    buffer: Resolution | None = None

    def drawn(self) -> Any:
        """**Raises** `ValueError` as `rasterize` does."""
        test = self.depth_test or DepthTest()
        self._check(test)
        scene = self._scene
        is_shared = self.pages is None and not is_traced((*scene, self.viewports))
        return self._apart(scene, test) if is_shared else self._in_trace(scene, test)

    def _check(self, test: DepthTest) -> None:
        test.check()
        check_value("the resolution", self.resolution, Size, "pixels")
        check_value("cull", self.cull, Cull)
        buffer = self.buffer or self.resolution
        if not all(n <= size <= MAX_TEXELS for n, size in zip(self.resolution, buffer, strict=True)):
            raise ValueError(
                f"the buffer is {buffer}; expected (height, width), at least {self.resolution} and at most "
                f"{MAX_TEXELS} pixels each"
            )
        if self.pages is not None and self.resolution != (self.pages.side, self.pages.side):
            raise ValueError(
                f"the resolution is {self.resolution}; expected the side of the pages' layers, {self.pages.side} pixels"
            )

    @property
    def _scene(self) -> _Scene:
        """The inputs of all views, without derivatives. The search uses integers and single precision, whatever the
        precision of the later interpolation."""
        single = lambda leaf: lax.stop_gradient(leaf.astype(jnp.float32)) if eqx.is_inexact_array(leaf) else leaf
        clip, offset, textures = self.clip, self.polygon_offset, self.alpha_test
        if isinstance(clip, Tracer):
            # Outside of `jit`, this gives the primal values of arrays that are traced for derivatives, for example by
            # `jax.jvp`.
            clip = lax.stop_gradient(clip)
        clip, faces = padded(clip if clip.dtype == jnp.float32 else clip.astype(jnp.float32), self.faces)
        if textures is not None and textures.index.shape != faces.shape[:1]:
            textures = textures.padded(faces.shape[0])
        offset = None if offset is None else single(as_float(offset))
        return _Scene(clip, faces, offset, self.behind, jax.tree.map(single, textures))

    def _in_trace(self, scene: _Scene, test: DepthTest) -> Any:
        """Draws in a trace. A known viewport and known culling shorten the program."""

        def draw(scene: _Scene, viewport: Any) -> Any:
            viewport = self.resolution if viewport is None else viewport
            return _traced(scene, viewport, FACING[self.cull], self.resolution, test, self.with_face, self.pages)

        if scene.clip.ndim == 2:
            return draw(scene, self.viewports)

        def view(each: Any) -> Any:
            clip, behind, viewport = each
            return draw(scene._replace(clip=clip, behind=behind), viewport)

        # One view after another, because each has a different number of triangles to draw.
        return lax.map(view, (scene.clip, scene.behind, self.viewports))

    def _apart(self, scene: _Scene, test: DepthTest) -> Any:
        """Draws outside of a trace. All small images share a program, whether there is one view or several, and
        whatever is culled."""
        height, width = self.resolution
        buffer = self.buffer or self.resolution
        if max(buffer) <= _SHARED_SIDE:
            buffer = _SHARED_SIDE, _SHARED_SIDE
        behind = scene.behind
        if behind is not None and buffer != self.resolution:
            rest = [(0, 0)] * (behind.ndim - 2) + [(0, buffer[0] - height), (0, buffer[1] - width)]
            behind = jnp.pad(behind, rest, constant_values=NO_FACE)

        def view(clip: Any, behind: Array | None, viewport: Any) -> Any:
            # One NumPy array, because creating one on the device takes longer than drawing a small image.
            numbers = np.array([*viewport, *FACING[self.cull]], np.int32)
            return _shared(scene._replace(clip=clip, behind=behind), numbers, buffer, test, self.with_face)

        # Nothing here depends on the default precision, so both precisions share programs.
        with jax.enable_x64(False):
            viewports = self.resolution if self.viewports is None else np.asarray(self.viewports)
            if scene.clip.ndim == 2:
                drawn = view(scene.clip, behind, viewports)
                return drawn if buffer == self.resolution else _cut(drawn, height, width)
            count = len(scene.clip)
            each = [viewports] * count if self.viewports is None else viewports
            layers = [None] * count if behind is None else _apart(behind)
            views = [view(*one) for one in zip(_apart(scene.clip), layers, each, strict=True)]
            if count * height * width > _MAX_WAITING:
                jax.block_until_ready(views)
            return _together(views, height, width)


# Each of these is one program. Plain indexing would compile a program for every index.
@jax.jit
def _apart(values: Array) -> list[Array]:
    return list(values)


@partial(jax.jit, static_argnames=("height", "width"))
def _cut(drawn: Fragments | Array, height: int, width: int) -> Any:
    """The lower left part of images."""
    return jax.tree.map(lambda image: image[..., :height, :width], drawn)


@partial(jax.jit, static_argnames=("height", "width"))
def _together(views: list[Fragments | Array], height: int, width: int) -> Any:
    """The lower left part of several views, with an axis for the views."""
    return _cut(jax.tree.map(lambda *images: jnp.stack(images), *views), height, width)


def _rasterize(
    scene: _Scene,
    viewport: Any,
    facing: Any,
    resolution: Resolution,
    test: DepthTest,
    with_face: bool,
    pages: Pages | None = None,
) -> Fragments | Float[Array, "*l h w"]:
    """One view in the lower left part of an image of `resolution`, or in pages."""
    clip, faces, polygon_offset, behind, textures = scene
    height, width = viewport

    def finish(depth: Array, face: Array | None, first: Array | int) -> Fragments | Array:
        if pages is None and not isinstance(height, int):
            # Windows of pixels may reach beyond the viewport.
            row, column = (jnp.arange(size, dtype=jnp.int32) for size in depth.shape)
            depth = jnp.where((row[:, None] + first < height) & (column < width), depth, jnp.inf)
        seen = depth < jnp.inf
        depth = jnp.where(seen, test.decode(depth), jnp.float32(1))
        return depth if face is None else Fragments(jnp.where(seen, face, NO_FACE), depth)

    alpha_test = None if textures is None or pages is not None else AlphaTest(textures, clip, faces, viewport)
    bands = bands_of(resolution, 8 if with_face else 4)
    drawing: Drawing
    if pages is None and behind is None and bands > 1:
        drawing = BandDrawing(clip, faces, (height, width), facing, test, polygon_offset, resolution, bands, alpha_test)
    else:
        if pages is None:
            triangles = bin_triangles(clip, faces, (height, width), facing)
            in_one = DrawPass(triangles, (height, width), facing, test, polygon_offset, resolution, alpha_test)
        else:
            in_one = PagedDrawing(clip, faces, pages, facing, test, polygon_offset, textures)
        behind = None if behind is None else in_one.padded(behind, NO_FACE)
        drawing = in_one
    return least_depth_and_face(drawing, behind, finish) if with_face else least_depth(drawing, finish)


_traced = eqx.filter_jit(_rasterize)


# Equinox's takes a tenth of a millisecond longer to call.
@partial(jax.jit, static_argnames=("buffer", "test", "with_face"))
def _shared(scene: _Scene, numbers: Array, buffer: Resolution, test: DepthTest, with_face: bool) -> Any:
    height, width, front, back = numbers
    return _rasterize(scene, (height, width), (front > 0, back > 0), buffer, test, with_face)
