"""The console that the command and the experiments print to, and the commands that it prints."""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import rich.console
from rich.segment import Segment
from rich.text import Text

from .config import BUILTIN, printable

WIDTH_OF_FILES = 200
"""In characters."""


class Console(rich.console.Console):
    """A console that writes unprintable characters as Python's escapes.

    A file or a pipe is wide, whatever `COLUMNS` says, so that no cell of a table is cut off.

    **Arguments:**

    - `names_stages`: whether a run that prints here prints a line for each of its stages, if this is no terminal, which
      shows a bar.
    """

    def __init__(self, *, width: int | None = None, names_stages: bool = False, **options: Any):
        super().__init__(highlight=False, width=width, **options)
        self.names_stages = names_stages and not self.is_terminal
        if width is None and not (self.file.isatty() or self.is_jupyter):
            self.width = WIDTH_OF_FILES

    def render(self, *args: Any, **kwargs: Any) -> Iterator[Segment]:
        """Like `rich.console.Console.render`, with the text of every segment made printable."""
        for segment in super().render(*args, **kwargs):
            plain = "\n".join(map(printable, segment.text.split("\n")))
            yield segment if segment.control else segment._replace(text=plain)


class Command(NamedTuple):
    """A command to copy.

    - `why`: what it does, in a sentence.
    - `words`: what follows the program's name. A path is a `Path`, and any other word a text.
    """

    why: str
    words: Sequence[Path | str]

    @property
    def text(self) -> str:
        """The command, quoted for a shell."""
        return shlex.join(["diffshadow", *map(_word, self.words)])

    @property
    def is_absolute(self) -> bool:
        """Whether it has an absolute path."""
        return any(isinstance(word, Path) and word.is_absolute() for word in self.words)

    def anywhere(self) -> "Command":
        """The command with absolute paths, which runs in any folder."""
        return self._replace(words=[word.absolute() if isinstance(word, Path) else word for word in self.words])


def source(given: Path) -> Path | str:
    """A configuration as a word of a command: `builtin:NAME` is no path."""
    return str(given) if str(given).startswith(BUILTIN) else given


def print_next(console: rich.console.Console, commands: Sequence[Command]) -> None:
    """Prints what to do next. If one path is absolute, all are."""
    if not commands:
        return
    if any(each.is_absolute for each in commands):
        commands = [each.anywhere() for each in commands]
    console.print(Text("what to do next:", "bold"))
    for each in commands:
        # In one line each, so that they can be copied.
        console.print(Text(printable(f"  {each.text}")), soft_wrap=True)
        console.print(Text(printable(f"    {each.why}"), "dim"), soft_wrap=True)


def _word(word: Path | str) -> str:
    # A path with a dash in front would be read as an option.
    return f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word)
