"""Overrides: `key=value` pairs that replace values of a configuration."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ._errors import ConfigError, KeyPath, Place, Problem, dotted, show
from ._yaml import read_yaml

# Names of parameters hold a dot themselves.
_DOTTED_NAMES = ("fit", "parameters")
_DEEPER = ("bias", "plane")


def apply_overrides(data: dict[str, Any], places: dict[KeyPath, Place], overrides: Sequence[str]) -> list[Problem]:
    """Writes `overrides` into `data`, each `key=value` with a dotted key and a YAML value; later ones win.

    Sections that are not there yet are made; whether the schema has such a key is for validation to say.

    **Arguments:**

    - `data`, `places`: as `read_yaml` returns them; both are changed.

    **Returns:** the problems of overrides that cannot be written; the others are.
    """
    problems = []
    for override in overrides:
        place = Place(f"override {override!r}")
        try:
            problems += _apply(data, places, override, place)
        except ConfigError as error:
            problems += error.problems
    return problems


def _apply(data: dict[str, Any], places: dict[KeyPath, Place], override: str, place: Place) -> list[Problem]:
    key, equals, text = override.partition("=")
    words = key.strip().split(".")
    if not equals or not all(words):
        raise ConfigError([Problem(place, "", "is no KEY=VALUE; expected a dotted key; write it like filter.radius=2")])
    value, inner, problems = read_yaml(text, lambda line, column: place)
    if tuple(words[:2]) == _DOTTED_NAMES and len(words) > 3:
        # The longest name that such a key may begin with: `bias.plane` holds numbers as `bias` does.
        parts = 3 if tuple(words[2:4]) == _DEEPER and len(words) > 4 else 2
        words[2 : 2 + parts] = [".".join(words[2 : 2 + parts])]
    # Walk to what holds the value, and make the sections that are missing.
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
    places.update({(*path, *below): place for below in [(), *inner]})
    return [replace(problem, key=dotted((*path, problem.key) if problem.key else path)) for problem in problems]


def _step(holder: Any, path: KeyPath, word: str, place: Place) -> Any:
    """The key or index that `word` means in `holder`, which stands at `path`."""
    key = dotted((*path, word))
    if isinstance(holder, dict):
        return word
    if not isinstance(holder, list):
        message = (
            f"leads into {dotted(path)}, which is {show(holder)}; expected a section; set {dotted(path)} as a whole"
        )
        raise ConfigError([Problem(place, key, message)])
    if not (word.isascii() and word.isdigit()):
        message = f"{word!r} is no index of the list {dotted(path)}; expected a number from 0; write {dotted(path)}.0"
        raise ConfigError([Problem(place, key, message)])
    if int(word) >= len(holder):
        entries = f"only {dotted((*path, 0))}" if len(holder) == 1 else f"indices from 0 to {len(holder) - 1}"
        have = f"{len(holder)} {'entry' if len(holder) == 1 else 'entries'}"
        message = f"index {word} is out of range: the list {dotted(path)} has {have}; expected {entries}"
        raise ConfigError([Problem(place, key, f"{message}; set {dotted(path)} as a whole to make it longer")])
    return int(word)
