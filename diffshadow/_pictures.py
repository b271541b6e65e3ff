"""Small pictures of objects for notebooks, as HTML that needs no file. They are made on the host when one is shown."""

import base64
import html
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from ._arithmetic import concrete
from ._types import HostArray

SIDE = 160
"""The longer side of a drawn thumbnail, in pixels."""

# The longest side of a picture; larger images are shown with fewer pixels.
_MAX_SIDE = 256
# Pairs of a face and a pixel, beyond which a picture would take long.
_MAX_PAIRS = 1 << 20
_AMBIENT = 0.25


def is_known(tree: Any) -> bool:
    """Whether all arrays in `tree` have values, so that it can be drawn."""
    return all(concrete(leaf) is not None for leaf in jax.tree.leaves(tree))


def as_html(title: str, image: Any = None, rows: Sequence[Sequence[str]] = ()) -> str:
    """A title, an image, and a table whose first row is its head.

    **Arguments:**

    - `image`: (h, w) or (h, w, 3), in [0, 1]. Row 0 is the bottom row. None for no image.
    """
    cells = ["".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) for tag, row in _tagged(rows)]
    table = f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>" if rows else ""
    picture = "" if image is None else f'<img alt="" src="data:image/png;base64,{_png(np.asarray(image))}">'
    return f"<div><div>{html.escape(title)}</div>{picture}{table}</div>"


def _tagged(rows: Sequence[Sequence[str]]) -> list[tuple[str, Sequence[str]]]:
    return [("td" if i else "th", row) for i, row in enumerate(rows)]


def _png(image: HostArray) -> str:
    """The image as an 8-bit PNG in base64."""
    step = -(-max(image.shape[:2]) // _MAX_SIDE)
    image = np.nan_to_num(np.asarray(image[::step, ::step], np.float64))
    rows = np.rint(np.clip(image[::-1], 0, 1) * 255).astype(np.uint8)
    height, width = rows.shape[:2]
    header = struct.pack(">IIBBBBB", width, height, 8, 2 if rows.ndim == 3 else 0, 0, 0, 0)
    # Each row begins with its filter: none.
    lines = np.concatenate([np.zeros((height, 1), np.uint8), rows.reshape(height, -1)], axis=1)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 9)), (b"IEND", b""))
    packed = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return base64.b64encode(b"\x89PNG\r\n\x1a\n" + b"".join(packed)).decode("ascii")


def lit(normals: HostArray, towards: HostArray, albedo: HostArray) -> HostArray:
    """Colours (n, 3) of surfaces with these unit normals (n, 3), lit from either side by a lamp in a direction (3,)."""
    towards = np.asarray(towards, np.float64) / np.linalg.norm(towards)
    return np.asarray(albedo) * (_AMBIENT + (1 - _AMBIENT) * np.abs(normals @ towards)[..., None])


def grey_of(depth: Float[HostArray, "h w"]) -> Float[HostArray, "h w"]:
    """Window depths as greys: dark where depth is least, and white where there is nothing."""
    filled = depth < 1
    low, high = (depth[filled].min(), depth[filled].max()) if filled.any() else (0.0, 1.0)
    return np.where(filled, 0.1 + 0.7 * (depth - low) / max(high - low, np.finfo(np.float32).eps), 1.0)


def draw_faces(
    clip: Float[HostArray, "v 4"],
    faces: Int[HostArray, "f 3"],
    colours: Float[HostArray, "f 3"],
    resolution: tuple[int, int],
) -> Float[HostArray, "h w 3"] | None:
    """An image of flat faces on white. `None` if drawing would take long.

    A pixel p = (x, y, 1) is in a face if the weights c = M⁻¹ p of its corners are all positive, with the corners'
    (x, y, w) as the columns of M. This needs no clipping (Olano & Greer 1997, "Triangle scan conversion using 2D
    homogeneous coordinates").
    """
    size = np.array(resolution[::-1])
    corners = np.asarray(clip, np.float64)[faces]
    matrices = corners[..., [0, 1, 3]].swapaxes(1, 2)
    with np.errstate(all="ignore"):
        places = corners[..., :2] / corners[..., 3:]
        is_whole = (corners[..., 3] > 0).all(axis=-1)[:, None]
        low, high = (np.where(is_whole, ends, end) for ends, end in ((places.min(1), -1), (places.max(1), 1)))
    first, last = (np.clip(np.ceil((ends + 1) / 2 * size - 0.5), 0, size).astype(int) for ends in (low, high))
    spans = np.maximum(last - first, 0)
    counts = spans.prod(axis=-1) * (np.abs(np.linalg.det(matrices)) > 0)
    if counts.sum() > _MAX_PAIRS:
        return None
    face = np.repeat(np.arange(len(faces)), counts)
    k = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    x, y = first[face, 0] + k % spans[face, 0], first[face, 1] + k // spans[face, 0]
    pixels = np.stack([(2 * x + 1) / size[0] - 1, (2 * y + 1) / size[1] - 1, np.ones(len(face))], axis=-1)
    inverse = np.zeros_like(matrices)
    inverse[counts > 0] = np.linalg.inv(matrices[counts > 0])
    weights = np.einsum("nij,nj->ni", inverse[face], pixels)
    depth = (weights * corners[face, :, 2]).sum(axis=-1)
    seen = (weights >= 0).all(axis=-1) & (np.abs(depth) <= 1)
    # Each pixel's nearest face is its first.
    order = np.lexsort((depth[seen], (y * size[0] + x)[seen]))
    pixel, at = np.unique((y * size[0] + x)[seen][order], return_index=True)
    image = np.ones((size[0] * size[1], 3))
    image[pixel] = np.asarray(colours)[face[seen][order][at]]
    return image.reshape(*resolution, 3)
