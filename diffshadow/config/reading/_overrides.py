"""Applies overrides: `key=value` pairs that replace values of a configuration."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from .._errors import ConfigError, KeyPath, Location, Mistake, dotted, show
from ..sections._axes import QuasiRandomAxisConfig
from ..sections._fit import FitParameterConfig
from ..sections._fitted import could_be_fitted
from ..sections._section import is_index, value_at
from ._yaml import has_surrogate, read_yaml


def apply_overrides(data: dict[str, Any], places: dict[KeyPath, Location], overrides: Sequence[str]) -> list[Mistake]:
    """Writes `overrides` into `data`. Each is `key=value` with a dotted key and a YAML value. Later overrides win.

    Missing sections are created. A later step checks whether the keys exist in the schema.

    **Arguments:**

    - `data`, `places`: as returned by `read_yaml`; both are modified.

    **Returns:** the mistakes of overrides that cannot be applied. All others are applied.
    """
    mistakes = []
    for override in overrides:
        place = Location(f"override {override!r}")
        try:
            mistakes += _apply(data, places, override, place)
        except ConfigError as error:
            mistakes += error.mistakes
    return mistakes


def _apply(data: dict[str, Any], places: dict[KeyPath, Location], override: str, place: Location) -> list[Mistake]:
    key, equals, text = override.partition("=")
    words = words_of(key if equals else "", place)
    value, _, mistakes = read_yaml(text, lambda line, column: place)
    path = write_value(data, places, words, value, place)
    return [replace(mistake, key=dotted((*path, mistake.key) if mistake.key else path)) for mistake in mistakes]


def words_of(key: str, place: Location) -> list[str]:
    """The words of a dotted `key` that was written at `place`.

    **Raises** `ConfigError` if it is no dotted key.
    """
    words = key.strip().split(".")
    if not all(words):
        raise ConfigError([Mistake(place, "", "is not KEY=VALUE; expected a dotted key; write filter.radius=2")])
    if has_surrogate(key):
        raise ConfigError([Mistake(place, key, "has an invalid character in its key; expected UTF-8 text; remove it")])
    return words


def write_value(
    data: dict[str, Any], places: dict[KeyPath, Location], words: list[str], value: Any, place: Location
) -> KeyPath:
    """Writes `value` into `data` at a key, given as its `words`. Missing sections are created.

    **Arguments:**

    - `data`, `places`: as returned by `read_yaml`; both are modified.
    - `place`: where the value was written.

    **Returns** the path of the value.

    **Raises** `ConfigError` if a word does not fit the section or list that it is in.
    """
    words = _with_whole_names(data, words, value)
    # Finds the section that contains the value, and creates missing sections.
    holder: Any = data
    path: KeyPath = ()
    for word in words[:-1]:
        step = _step(holder, path, word, place)
        path = (*path, step)
        inside = holder.get(step) if isinstance(holder, dict) else holder[step]
        if inside is None:
            holder[step] = inside = {}
            places[path] = place
        holder = inside
    step = _step(holder, path, words[-1], place)
    path = (*path, step)
    holder[step] = value
    for stale in [other for other in places if other[: len(path)] == path]:
        del places[stale]
    places[path] = place
    return path


def _with_whole_names(data: Any, words: list[str], value: Any) -> list[str]:
    """`words`, with names of parameters and swept keys joined into one word, because they contain dots."""
    match words:
        case ["fit", "parameters", _, *_]:
            start, keys = 2, FitParameterConfig.model_fields
            known = lambda name, rest: could_be_fitted(name) or name in existing
        case ["sweep", *axes] | ["fit", "views" | "validation", *axes]:
            inner = {"grid": 1, "zip": 1, "files": 1, "qmc": 2, "path": 2}.get(axes[0] if axes else "", len(words))
            if axes[:1] == ["list"] and len(axes) > 2:
                end = len(words) - len(axes) + 2
                return [*words[:end], ".".join(words[end:])]
            if len(axes) <= inner:
                return words
            start, keys = len(words) - len(axes) + inner, ()
            if axes[0] == "qmc":
                keys = QuasiRandomAxisConfig.model_fields
            known = lambda name, rest: name in existing and (bool(keys) or not rest or is_index(rest[0]))
        case _:
            return words
    existing = value_at(data, *words[:start])
    existing = existing if isinstance(existing, Mapping) else {}
    end = start + _length_of_name(words[start:], known, () if isinstance(value, dict) else keys)
    return [*words[:start], ".".join(words[start:end]), *words[end:]]


def _length_of_name(words: Sequence[str], known: Callable[[str, Sequence[str]], bool], keys: Collection[str]) -> int:
    """The number of `words` that form a name: the longest known name, or otherwise all words except a last one among
    `keys`."""
    for length in range(len(words), 0, -1):
        if known(".".join(words[:length]), words[length:]):
            return length
    return len(words) - (len(words) > 1 and words[-1] in keys)


def _step(holder: Any, path: KeyPath, word: str, place: Location) -> Any:
    """The key or index of `word` in `holder`, the value at `path`."""
    key = dotted((*path, word))
    if isinstance(holder, dict):
        return word
    if not isinstance(holder, list):
        message = (
            f"is inside {dotted(path)}, which is {show(holder)}; expected a section; set {dotted(path)} as a whole"
        )
        raise ConfigError([Mistake(place, key, message)])
    if not is_index(word):
        message = (
            f"{word!r} is not an index of the list {dotted(path)}; expected a number from 0; write {dotted(path)}.0"
        )
        raise ConfigError([Mistake(place, key, message)])
    if int(word) >= len(holder):
        entries = f"only {dotted((*path, 0))}" if len(holder) == 1 else f"indices from 0 to {len(holder) - 1}"
        have = f"{len(holder)} {'entry' if len(holder) == 1 else 'entries'}"
        message = f"index {word} is out of range: the list {dotted(path)} has {have}; expected {entries}"
        raise ConfigError([Mistake(place, key, f"{message}; set {dotted(path)} as a whole to make it longer")])
    return int(word)
