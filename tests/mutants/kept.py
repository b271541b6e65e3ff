"""Mistakes that the tests must see and that no operator makes, each a change of one place in the package's source."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import yaml


class Kept(NamedTuple):
    """A mistake.

    - `file`: below `diffshadow/`; `name`: in a few words; `function`: the function or class that it lies in.
    - `old`: text that stands there exactly once; `new`: what takes its place.
    """

    file: str
    name: str
    function: str
    old: str
    new: str

    def changed(self, before: str) -> str | None:
        """The file with the mistake, given the file without; none if it does not apply."""
        lines, place = before.splitlines(keepends=True), _lines_of(before, self.function)
        if place is None:
            return None
        body = "".join(lines[place])
        if body.count(self.old) != 1:
            return None
        return "".join([*lines[: place.start], body.replace(self.old, self.new), *lines[place.stop :]])


def _lines_of(source: str, function: str) -> slice | None:
    """The lines of a function or class, by its dotted name."""
    body, found = ast.parse(source).body, None
    for name in function.split("."):
        inner = [each for node in body for each in ast.walk(node) if getattr(each, "name", None) == name]
        definitions = [each for each in inner if isinstance(each, ast.FunctionDef | ast.ClassDef)]
        if not definitions:
            return None
        found = definitions[0]
        body = found.body
    return None if found is None else slice(found.lineno - 1, found.end_lineno)


def _read() -> Iterator[Kept]:
    listed = Path(__file__).with_name("kept.yaml")
    for file, mistakes in yaml.safe_load(listed.read_text(encoding="utf-8")).items():
        for each in mistakes:
            yield Kept(file, each["name"], each["function"], each["old"], each["new"])


KEPT = tuple(_read())
