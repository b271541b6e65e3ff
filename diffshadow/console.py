"""The console that the command and the experiments print to."""

from collections.abc import Iterator
from typing import Any

import rich.console
from rich.segment import Segment

from .config import printable

WIDTH_OF_FILES = 200
"""In characters."""


class Console(rich.console.Console):
    """A console that writes unprintable characters as Python's escapes.

    A file or a pipe is wide, whatever `COLUMNS` says, so that no cell of a table is cut off.
    """

    def __init__(self, *, width: int | None = None, **options: Any):
        super().__init__(highlight=False, width=width, **options)
        if width is None and not (self.file.isatty() or self.is_jupyter):
            self.width = WIDTH_OF_FILES

    def render(self, *args: Any, **kwargs: Any) -> Iterator[Segment]:
        """Like `rich.console.Console.render`, with the text of every segment made printable."""
        for segment in super().render(*args, **kwargs):
            plain = "\n".join(map(printable, segment.text.split("\n")))
            yield segment if segment.control else segment._replace(text=plain)
