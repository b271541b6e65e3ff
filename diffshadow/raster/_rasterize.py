"""The rasterizer: which triangle each pixel sees."""

from functools import partial
from typing import Any

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
"""What a pixel that sees nothing holds in a face map."""


class Fragments(eqx.Module):
    """What each pixel sees; row 0 is the bottom row. Neither field carries a gradient: `interpolate` does.

    - `face`: (h, w), index of the nearest face, `NO_FACE` where there is none.
    - `depth`: (h, w), its window depth as the depth buffer stores it; 1 where there is none.

    Of several views, (b, h, w).
    """

    face: Int[Array, "*b h w"]
    depth: Float[Array, "*b h w"]


def padded(clip: Float[Array, "*b v 4"], faces: Faces) -> tuple[Any, Any]:
    """The triangles as `Mesh.padded` fills them up, so that meshes of like size share what is compiled.

    **Returns:** both arrays. On CPUs they are on the host where they had to be padded.
    """
    if isinstance(clip, Tracer) or isinstance(faces, Tracer):
        return clip, faces
    size, vertices = shared_mesh_size(faces.shape[0], clip.shape[-2])
    if (size, vertices) == (faces.shape[0], clip.shape[-2]):
        return clip, faces
    # In NumPy on CPUs, whose copies need no compiling, and which programs take as they are.
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
    viewports: Int[Array, "b 2"] | None = None,
    buffer: Resolution | None = None,
    alpha_test: Textures | None = None,
) -> Fragments:
    """The nearest face at every pixel centre, by OpenGL's rules.

    Triangles snap to 1/256 pixel, shared edges are covered exactly once, and what lies before the near plane or
    beyond the far plane is cut away.

    **Arguments:**

    - `clip`: (v, 4), vertices in OpenGL clip space; `w` may have either sign. With a leading axis, (b, v, 4), several
        views are drawn one after the other, and every result has that axis too.
    - `faces`: (f, 3), indices into `clip`; anticlockwise in the window is a front face.
    - `resolution`: (height, width) in pixels, each at most 8192.
    - `cull`: which faces are left out.
    - `depth_test`: format and comparison of the depth buffer; float32 and `"less"` if left out.
    - `polygon_offset`: (factor, units) of OpenGL's polygon offset, or none.
    - `behind`: (h, w), a face map: at each pixel its face is passed over. Given the result of a first call, the
        second-nearest layer is drawn.
    - `pages`: draws these pages of a virtual map instead of an image, each into a layer of its own: results are
        (l, h, w). `clip` is one view, of the virtual map, and `resolution` is a layer's.
    - `viewports`: (b, 2), for several views: (height, width) in pixels of the lower left part of its image that each is
        drawn into. Pixels beyond see nothing.
    - `buffer`: (height, width) in pixels, at least `resolution`: draws into a part of an image of this size. Outside of
        a trace, drawings with one buffer share what is compiled; under a trace, and with pages, it is ignored.
    - `alpha_test`: `Mesh.alpha_test`: textures of the faces, whose cutoffs cut out pixels, as by `discard`.

    **Raises** `ValueError` for a resolution, buffer or depth test out of range.
    """
    return _draw(
        clip, faces, resolution, cull, depth_test, polygon_offset, behind, True, pages, viewports, buffer, alpha_test
    )


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
    return _draw(clip, faces, resolution, cull, depth_test, polygon_offset, None, False, None, None, None, alpha_test)


def _draw(
    clip, faces, resolution, cull, test, polygon_offset, behind, with_face, pages, viewports, buffer, alpha_test
) -> Any:
    test = test or DepthTest()
    test.check()
    check_value("the resolution", resolution, Size, "pixels")
    check_value("cull", cull, Cull)
    if buffer is not None and not all(n <= size <= MAX_TEXELS for n, size in zip(resolution, buffer, strict=True)):
        raise ValueError(
            f"the buffer is {buffer}; expected (height, width), at least {resolution} and at most {MAX_TEXELS} pixels "
            "each"
        )
    if pages is not None and resolution != (pages.side, pages.side):
        raise ValueError(f"the resolution is {resolution}; expected the side of the pages' layers, {pages.side} pixels")
    if isinstance(clip, Tracer):
        # Outside of `jit`, this gives the values of what is traced for its derivative, as by `jax.jvp`.
        clip = lax.stop_gradient(clip)
    # The search is integer work and single precision whatever the precision of what is interpolated later.
    clip, faces = padded(clip if clip.dtype == jnp.float32 else clip.astype(jnp.float32), faces)
    if polygon_offset is not None:
        polygon_offset = lax.stop_gradient(as_float(polygon_offset)).astype(jnp.float32)
    if alpha_test is not None:
        if alpha_test.index.shape != faces.shape[:1]:
            alpha_test = alpha_test.padded(faces.shape[0])
        single = lambda leaf: lax.stop_gradient(leaf.astype(jnp.float32)) if eqx.is_inexact_array(leaf) else leaf
        alpha_test = jax.tree.map(single, alpha_test)
    given = clip, faces, polygon_offset, behind, viewports, alpha_test
    if pages is None and not is_traced(given):
        return _draw_shared(
            clip, faces, resolution, cull, test, polygon_offset, behind, with_face, viewports, buffer, alpha_test
        )

    def view(clip: Any, behind: Array | None, viewport: Array | None) -> Fragments | Array:
        viewport = resolution if viewport is None else viewport
        draws = FACING[cull]
        return _traced(
            clip, faces, viewport, resolution, draws, test, polygon_offset, behind, with_face, pages, alpha_test
        )

    # One view after the other, since each has its own number of triangles to draw.
    return lax.map(lambda each: view(*each), (clip, behind, viewports)) if clip.ndim > 2 else view(clip, behind, None)


# Smaller images are drawn into buffers of this side.
_SHARED_SIDE = 256


def _draw_shared(
    clip, faces, resolution, cull, test, polygon_offset, behind, with_face, viewports, buffer, alpha_test
) -> Any:
    """Draws outside of a trace, so that what is compiled is shared: by all small images, by one view and several, and
    whatever is culled."""
    height, width = resolution
    buffer = buffer or resolution
    if max(buffer) <= _SHARED_SIDE:
        buffer = _SHARED_SIDE, _SHARED_SIDE
    if behind is not None and buffer != resolution:
        rest = [(0, 0)] * (behind.ndim - 2) + [(0, buffer[0] - height), (0, buffer[1] - width)]
        behind = jnp.pad(behind, rest, constant_values=NO_FACE)

    # In one array and in NumPy, since to make one on the device takes longer than a small image.
    numbers = lambda viewport: np.array([*viewport, *FACING[cull]], np.int32)
    view = lambda clip, behind, viewport: _shared(
        clip, faces, numbers(viewport), buffer, test, polygon_offset, behind, with_face, alpha_test
    )
    # Nothing here depends on the default precision: programs are shared by both.
    with jax.enable_x64(False):
        if clip.ndim == 2:
            drawn = view(clip, behind, resolution)
            return drawn if buffer == resolution else _cut(drawn, height, width)
        each = [resolution] * len(clip) if viewports is None else np.asarray(viewports)
        layers = [None] * len(clip) if behind is None else _apart(behind)
        return _together([view(*one) for one in zip(_apart(clip), layers, each, strict=True)], height, width)


# Each is one program, where every index would be another.
@jax.jit
def _apart(values: Array) -> list[Array]:
    return list(values)


@partial(jax.jit, static_argnames=("height", "width"))
def _cut(drawn: Fragments | Array, height: int, width: int) -> Any:
    """The lower left part of images."""
    return jax.tree.map(lambda image: image[..., :height, :width], drawn)


@partial(jax.jit, static_argnames=("height", "width"))
def _together(views: list[Fragments | Array], height: int, width: int) -> Any:
    """That part of several views, with an axis for these."""
    return _cut(jax.tree.map(lambda *images: jnp.stack(images), *views), height, width)


def _rasterize(
    clip, faces, viewport, resolution, facing, test, polygon_offset, behind, with_face, pages, textures
) -> Fragments | Float[Array, "*l h w"]:
    """One view in the lower left part of an image of `resolution`, or in pages."""
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


# In a trace, a viewport and culling that are known shorten the program.
_traced = eqx.filter_jit(_rasterize)


# Equinox's takes a tenth of a millisecond longer to call.
@partial(jax.jit, static_argnames=("buffer", "test", "with_face"))
def _shared(clip, faces, numbers, buffer, test, polygon_offset, behind, with_face, textures) -> Any:
    height, width, front, back = numbers
    facing = front > 0, back > 0
    size = height, width
    return _rasterize(clip, faces, size, buffer, facing, test, polygon_offset, behind, with_face, None, textures)
