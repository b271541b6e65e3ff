"""The console of the command and the experiments, and the commands that they suggest."""

import re
import shlex
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import rich.console
from rich.cells import cell_len
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from .config import BUILTIN, printable

WIDTH_OF_FILES = 200
"""In characters."""
# The spaces and the line around each cell of a table.
_BESIDE_CELL = 3
# Longer words without a digit may be broken.
_BROKEN = 16
# A cell that begins with a number.
_NUMBER = re.compile(r"[-+]?\.?\d")


class Console(rich.console.Console):
    """A console that writes unprintable characters as Python's escapes.

    A file or a pipe is wide, whatever `COLUMNS` says, so that no cell of a table is cut off.

    **Arguments:**

    - `names_stages`: whether a run prints a line for each of its stages. In a terminal, a bar replaces these lines.
    """

    def __init__(self, *, width: int | None = None, names_stages: bool = False, **options: Any):
        super().__init__(highlight=False, width=width, **options)
        self.names_stages = names_stages and not self.is_terminal
        if width is None and not (self.file.isatty() or self.is_jupyter):
            self.width = WIDTH_OF_FILES

    def render(self, *args: Any, **kwargs: Any) -> Iterator[Segment]:
        """Like `rich.console.Console.render`, with unprintable characters of every segment escaped."""
        for segment in super().render(*args, **kwargs):
            plain = "\n".join(map(printable, segment.text.split("\n")))
            yield segment if segment.control else segment._replace(text=plain)


def print_table(console: rich.console.Console, table: Table) -> None:
    """Prints a table without cutting numbers or words, even on a narrow console.

    If the table is too wide, cells wrap and spaces between them are left out. If it is still too wide, each row becomes
    a block with a line for each cell.
    """
    columns, between = table.columns, _BESIDE_CELL * len(table.columns) + 1
    whole = [max(map(cell_len, _cells(column))) for column in columns]
    least = [max(map(_least_width, _cells(column))) for column in columns]
    if sum(least) + between > console.width:
        # Without the spaces around its cells.
        table.padding, between = 0, len(columns) + 1
    if sum(least) + between > console.width:
        _print_stacked(console, table)
        return
    left = max(console.width - between - sum(least), 0)
    for column, width, most in sorted(zip(columns, least, whole, strict=True), key=lambda each: each[2] - each[1]):
        # The narrowest columns get their full width.
        given = min(most - width, left)
        column.width, column.no_wrap, column.overflow, left = width + given, False, "fold", left - given
    console.print(table)


def _print_stacked(console: rich.console.Console, table: Table) -> None:
    """Prints each row of a table as a block under its first cell."""
    if table.title:
        console.print(Text(_plain(table.title), "italic"), soft_wrap=True)
    heads = [_plain(column.header) for column in table.columns]
    for row in zip(*(_cells(column)[1:] for column in table.columns), strict=True):
        (_, name), *others = zip(heads, row, strict=True)
        print_folded(console, name, style="bold")
        for head, text in others:
            if text.strip():
                print_folded(console, f"{head}: {text}" if head else text, indent=2)


def print_folded(console: rich.console.Console, text: str, *, indent: int = 0, style: str = "") -> None:
    """Prints `text` in lines as wide as the console, broken between words and indented by `indent` spaces."""
    width = max(console.width - indent, 1)
    for line in textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False):
        console.print(Text(" " * indent + line, style), soft_wrap=True)


def _cells(column: Column) -> list[str]:
    """The head and the cells of a column."""
    return [_plain(column.header), *map(_plain, column.cells)]


def _plain(cell: Any) -> str:
    return printable(cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell)).plain)


def _least_width(cell: str) -> int:
    """The width of the longest word. A number and the text next to it are one word. A long word without a digit, such
    as a path, may be broken."""
    if _NUMBER.match(cell):
        return cell_len(cell)
    has_digit = lambda word: any(map(str.isdigit, word))
    return max(
        (cell_len(word) if has_digit(word) else min(cell_len(word), _BROKEN) for word in cell.split()), default=0
    )


class Command(NamedTuple):
    """A command to copy.

    - `why`: a sentence about its effect.
    - `words`: the words after the program's name. A path is a `Path`, and any other word is text.
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
    """A configuration as a word of a command. `builtin:NAME` is not a path."""
    return str(given) if str(given).startswith(BUILTIN) else given


def to_view(given: Path | str, overrides: Sequence[str] = ()) -> Command:
    """The command that shows a configuration or a run in a browser."""
    return Command("See it in the browser, and change its settings by hand.", ["view", given, *overrides])


def print_next(console: rich.console.Console, commands: Sequence[Command]) -> None:
    """Prints the next commands. If one path is absolute, all are."""
    if not commands:
        return
    if any(each.is_absolute for each in commands):
        commands = [each.anywhere() for each in commands]
    console.print(Text("next steps:", "bold"))
    for each in commands:
        # One line each, so that they can be copied.
        console.print(Text(printable(f"  {each.text}")), soft_wrap=True)
        console.print(Text(printable(f"    {each.why}"), "dim"), soft_wrap=True)


def _word(word: Path | str) -> str:
    # A path that begins with a dash would be read as an option.
    return f"./{word}" if isinstance(word, Path) and str(word).startswith("-") else str(word)
