"""The console that the command and the experiments print to."""

import os
from collections.abc import Iterator
from typing import Any

import rich.console
from rich.segment import Segment

from .config import printable

WIDTH_OF_FILES = 200
"""In characters."""


class Console(rich.console.Console):
    """A console that writes unprintable characters as Python's escapes.

    A file or a pipe counts as wide, unless the environment has `COLUMNS`, so that no cell of a table is cut off.
    """

    def __init__(self, **options: Any):
        super().__init__(highlight=False, **options)
        if not (self.is_terminal or self.is_jupyter or "COLUMNS" in os.environ):
            self.width = WIDTH_OF_FILES

    def render(self, *args: Any, **kwargs: Any) -> Iterator[Segment]:
        """Like `rich.console.Console.render`, with the text of every segment made printable."""
        for segment in super().render(*args, **kwargs):
            plain = "\n".join(map(printable, segment.text.split("\n")))
            yield segment if segment.control else segment._replace(text=plain)
