"""Self-contained pages and their pictures."""

import base64
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
from markupsafe import Markup

from ... import io
from ..._types import HostArray
from ...config import printable
from .. import style

# Pictures with more pixels per side are downsampled, so that pages stay below a few megabytes.
_MAX_PIXELS = 768
# Pixels per inch in CSS.
_SCREEN_DPI = 96
_MEDIA = {".png": "image/png", ".svg": "image/svg+xml", ".webp": "image/webp"}


class Picture(NamedTuple):
    """A picture on a page.

    - `name`: its name in the slider; `title`, `note`: its caption.
    - `data`: the picture as a data URI; `width`, `height`: in pixels.
    - `slides`: whether the slider offers it.
    """

    name: str
    title: str
    note: str
    data: str
    width: int
    height: int
    slides: bool = True


def picture(
    name: str, image: HostArray, note: str = "", *, title: str = "", colours: str = "gray", limit: float | None = None
) -> Picture:
    """Visibility (h, w), a difference (h, w) from `-limit` to `limit`, or colours (h, w, 3); row 0 is the bottom
    row."""
    small = _smaller(image)
    low, high = (0.0, 1.0) if limit is None else (-limit, limit)
    height, width = small.shape[:2]
    data = data_uri(style.png(small, colours, low, high), ".png")
    return Picture(name, title or name, note, data, width, height)


def _smaller(image: HostArray) -> HostArray:
    """`image`, downsampled by averaging blocks of n × n pixels if it is large."""
    n = -(-max(image.shape[:2]) // _MAX_PIXELS)
    if n == 1:
        return image
    height, width = (side // n for side in image.shape[:2])
    blocks = image[: height * n, : width * n].reshape(height, n, width, n, *image.shape[2:])
    return blocks.mean(axis=(1, 3)).astype(image.dtype)


class Scale(NamedTuple):
    """The colour scale of differences. `beyond` says whether some differences exceed it."""

    low: str
    middle: str
    high: str
    colours: str
    beyond: bool


def difference_scale(limit: float, beyond: bool) -> Scale:
    """The scale from `-limit` to `limit`."""
    return Scale(f"−{limit:g}", "0", f"+{limit:g}", style.gradient(style.DIFFERENCE), beyond)


def file_pictures(paths: Sequence[Path]) -> list[Picture]:
    """Pictures from PNG and SVG files, named after the files. A PNG is shown at its printed size."""
    return [_from_file(path) for path in paths]


def _from_file(path: Path) -> Picture:
    content = path.read_bytes()
    # A PNG's width and height follow its signature and the header of its first chunk.
    size = struct.unpack(">II", content[16:24]) if path.suffix == ".png" and len(content) > 24 else (0, 0)
    width, height = (round(side * _SCREEN_DPI / style.DPI) for side in size)
    title = path.stem.removeprefix("debug_").replace("_", " ")
    return Picture(path.stem, title, "", data_uri(content, path.suffix), width, height, False)


def data_uri(content: bytes, suffix: str) -> str:
    """`content` as a data URI."""
    return f"data:{_MEDIA[suffix]};base64,{base64.b64encode(content).decode('ascii')}"


def lines_of(text: str) -> Markup:
    """`text` as HTML, with its line breaks. Other unprintable characters are escaped."""
    return Markup("\n").join(printable(line) for line in text.splitlines())


def _shown(value: Any) -> Any:
    """`value` with unprintable characters escaped, unless it is markup."""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value


def write_page(path: Path, template: str, **values: Any) -> None:
    """Renders `template` with `values`, and writes the page to `path` atomically. A page in Markdown is not escaped.

    **Raises** `FileError` if it cannot be written.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("diffshadow", "study/pages/templates"),
        autoescape=lambda name: not str(name).endswith(".md.j2"),
        finalize=_shown,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template(template).render(theme=style.THEME, nothing=style.NO_SURFACE, **values)
    with io.atomic_path(path) as temporary:
        try:
            temporary.write_text(page, encoding="utf-8", errors="backslashreplace")
        except OSError as error:
            raise io.FileError(f"cannot write {path}: {error.strerror or error}") from error
