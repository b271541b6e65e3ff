"""Errors of a configuration, in words for its author."""

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

KeyPath = tuple[str | int, ...]
"""The path to a value from the root of a configuration: keys of sections and indices of lists."""

_LONGEST_SHOWN = 60


@dataclass(frozen=True)
class Location:
    """The place where something was written. `source` is a file or an override. Lines and columns are counted from
    1."""

    source: str
    line: int | None = None
    column: int | None = None

    def __str__(self) -> str:
        return self.source if self.line is None else f"{self.source}:{self.line}"


@dataclass(eq=False)
class Origin:
    """The places of the keys of a configuration, and `notes` on parts that the program chose.

    All origins compare equal, so that two configurations with the same content are equal.
    """

    source: str = "configuration"
    places: Mapping[KeyPath, Location] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def place(self, path: KeyPath) -> Location:
        """The place of `path`, or of its nearest enclosing section if it was not written."""
        for length in range(len(path), -1, -1):
            if path[:length] in self.places:
                return self.places[path[:length]]
        return Location(self.source)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origin)

    def __hash__(self) -> int:
        return hash(Origin)


@dataclass(frozen=True)
class Mistake:
    """One error of a configuration.

    - `place`: where it was written.
    - `key`: the dotted key; empty if the error concerns no key.
    - `message`: the given value, the expected value, and the remedy.
    """

    place: Location
    key: str
    message: str

    def __str__(self) -> str:
        # Escaped so that it stays on one line.
        return ": ".join(printable(part) for part in (str(self.place), self.key, self.message) if part)


class ConfigError(ValueError):
    """An invalid configuration. `mistakes` lists all errors in reading order."""

    mistakes: tuple[Mistake, ...]

    def __init__(self, mistakes: Iterable[Mistake]):
        # Overrides have no line and come after the file. Two checks may find the same mistake.
        order = lambda mistake: (mistake.place.line is None, mistake.place.line or 0)
        self.mistakes = tuple(sorted(dict.fromkeys(mistakes), key=order))
        super().__init__("\n".join(str(mistake) for mistake in self.mistakes))


def dotted(path: Sequence[str | int]) -> str:
    """`path` as in an override, such as `scene.meshes.0.path`. An empty key is shown as two quotes."""
    return ".".join(str(step) or "''" for step in path)


def printable(text: str) -> str:
    """`text` on one line. Characters that Unicode does not count as printable are written as Python's escapes.

    These are control characters, line breaks, direction marks and lone surrogates.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def show(value: Any) -> str:
    """`value` as its author wrote it, shortened and printable."""
    match value:
        case None:
            return "empty"
        case bool():
            return "true" if value else "false"
        case dict():
            text = f"a section with the keys {', '.join(map(str, value))}" if value else "an empty section {}"
        case list() | tuple():
            # The number of entries shown never exceeds the number of characters.
            text = f"[{', '.join(show(item) for item in value[:_LONGEST_SHOWN])}]"
        case str():
            text = repr(value)
        case _:
            text = str(value)
    text = printable(text)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}…"


def plain(number: float) -> str:
    """`number` in its usual notation: 5 rather than 5.0."""
    return str(number).removesuffix(".0")


def listing(choices: Iterable[Any]) -> str:
    """`choices` as a phrase: "a", "a or b", "a, b or c"."""
    words = [str(choice) for choice in choices]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def nearest(word: Any, choices: Iterable[str]) -> str | None:
    """The likely correct spelling of `word` among `choices`, or `None`."""
    by_lower_case = {choice.lower(): choice for choice in choices}
    found = difflib.get_close_matches(str(word).lower(), list(by_lower_case), n=1, cutoff=0.6)
    return by_lower_case[found[0]] if found else None


def did_you_mean(word: Any, choices: Iterable[str], otherwise: str) -> str:
    """A question that suggests the most similar of `choices`, or `otherwise` if none is similar."""
    suggestion = nearest(word, choices)
    return otherwise if suggestion is None else f"did you mean {suggestion!r}?"
