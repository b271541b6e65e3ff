"""Reads YAML 1.2's core schema, and records the place of every key.

PyYAML's loaders follow YAML 1.1, which reads `1e-3` as text and `on` as true. They silently use the last of two equal
keys. This reader makes plain data from PyYAML's nodes instead.
"""

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import yaml

from .._errors import ConfigError, KeyPath, Location, Mistake, dotted, show

_NULL = re.compile(r"~|null|Null|NULL|")
_TRUE = re.compile(r"true|True|TRUE")
_FALSE = re.compile(r"false|False|FALSE")
_INTEGER = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = re.compile(r"\.(nan|NaN|NAN)")

_KNOWN_TAGS = {f"tag:yaml.org,2002:{name}" for name in ("str", "seq", "map")}
# Aliases of aliases can grow exponentially. Real configurations stay far below this limit.
_MAX_VALUES = 10_000
_LONGEST_INTEGER = 40

_HINTS = {
    "mapping values are not allowed": "check the indentation, and quote text that holds ': '",
    "cannot start any token": "indent with spaces, not tabs, and quote text that begins with a special character",
    "expected <block end>": "check that the keys of one section begin in the same column",
    "could not find expected ':'": "write 'key: value', with a space after the colon",
    "expected ',' or ']'": "close the list with ']'",
    "expected ',' or '}'": "close the section with '}'",
    "expected a single document": "keep one document per file: remove the line '---'",
    "found undefined alias": "quote text that begins with '*'",
    "while scanning a quoted scalar": "close the quotes",
}
_WORDS = {
    "'<stream end>'": "the end",
    "'<document start>'": "a new document",
    "'<block end>'": "the end of the section",
    "<block end>": "the end of the section",
    "'<block mapping start>'": "a section",
    "'<block sequence start>'": "a list",
    "'<scalar>'": "text",
}


class Document(NamedTuple):
    """Plain data (dicts, lists, str, int, float, bool, `None`), the places of keys and list entries, and mistakes.

    An invalid value is `None` in `data`. If a key is given twice, the first value counts.
    """

    data: Any
    places: dict[KeyPath, Location]
    mistakes: list[Mistake]


def read_yaml(text: str, locate: Callable[[int, int], Location]) -> Document:
    """Reads YAML `text`.

    **Arguments:**

    - `locate`: makes a place from a line and a column, each counted from 1.

    **Returns:** the document. Mistakes include keys that are given twice, are not text or have a tag.

    **Raises** `ConfigError` on a syntax error.
    """
    try:
        root = yaml.compose(text, Loader=yaml.BaseLoader)
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error, locate) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"holds the character U+{int(error.character):04X}; expected printable text; remove it"
        raise ConfigError([Mistake(locate(line, 1), "", message)]) from None
    except RecursionError:
        message = "sections or lists are nested hundreds deep; expected a handful of levels; check the brackets"
        raise ConfigError([Mistake(locate(1, 1), "", message)]) from None
    reader = _Reader(locate)
    data = None if root is None else reader.value(root, (), ())
    return Document(data, reader.places, reader.mistakes)


class _Reader:
    """Converts nodes to data, and collects `places` and `mistakes`."""

    def __init__(self, locate: Callable[[int, int], Location]):
        self.locate = locate
        self.places: dict[KeyPath, Location] = {}
        self.mistakes: list[Mistake] = []
        self.count = 0

    def value(self, node: yaml.Node, path: KeyPath, within: tuple[int, ...]) -> Any:
        """The data of `node`, at `path`. `within` has the ids of the enclosing nodes."""
        self.places.setdefault(path, self.place(node))
        self.count += 1
        if id(node) in within:
            self.report(node, path, "contains itself; expected plain data; write the value out instead of the alias")
            return None
        if self.count > _MAX_VALUES:
            if self.count == _MAX_VALUES + 1:
                message = f"is the {self.count:,}th value; expected fewer in a configuration; check its aliases ('*')"
                self.report(node, path, message)
            return None
        if node.tag not in _KNOWN_TAGS:
            self.report(node, path, f"has the tag {node.tag!r}; expected plain data; remove the tag")
            return None
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, path, (*within, id(node)))
        if isinstance(node, yaml.SequenceNode):
            inside = (*within, id(node))
            return [self.value(item, (*path, i), inside) for i, item in enumerate(node.value)]
        return self.scalar(node, path)

    def mapping(self, node: yaml.MappingNode, path: KeyPath, within: tuple[int, ...]) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = self.value(key_node, (*path, "?"), within)
            self.places.pop((*path, "?"), None)
            if not isinstance(key, str):
                self.report(key_node, path, f"has the key {show(key)}; expected text; put the key in quotes")
                continue
            below = (*path, key)
            if key in data:
                first = self.places[below].line
                where = "" if first is None else f", first on line {first}"
                self.report(key_node, below, f"is given twice{where}; expected one value; remove one of them")
                continue
            self.places[below] = self.place(key_node)
            data[key] = self.value(value_node, below, within)
        return data

    def scalar(self, node: yaml.Node, path: KeyPath) -> str | int | float | bool | None:
        text = node.value
        if has_surrogate(text):
            self.report(node, path, f"is {show(text)}, with an invalid character; expected UTF-8 text; remove it")
            return None
        if not isinstance(node, yaml.ScalarNode) or node.style is not None:
            return text
        if len(text) > _LONGEST_INTEGER and any(form.fullmatch(text) for form in (_INTEGER, _OCTAL, _HEXADECIMAL)):
            self.report(node, path, f"is an integer of {len(text)} digits; expected fewer digits; check the number")
            return None
        return plain_scalar(text)

    def place(self, node: yaml.Node) -> Location:
        return self.locate(node.start_mark.line + 1, node.start_mark.column + 1)

    def report(self, node: yaml.Node, path: KeyPath, message: str) -> None:
        self.mistakes.append(Mistake(self.place(node), dotted(path), message))


def has_surrogate(text: str) -> bool:
    """Whether `text` has a lone surrogate, such as a byte of the command line that is not UTF-8."""
    return any("\ud800" <= c <= "\udfff" for c in text)


def plain_scalar(text: str) -> str | int | float | bool | None:
    """The value of an unquoted scalar by YAML 1.2's core schema: `1e-3` is a number, `on` is text."""
    if _NULL.fullmatch(text):
        return None
    if _TRUE.fullmatch(text):
        return True
    if _FALSE.fullmatch(text):
        return False
    if _INTEGER.fullmatch(text):
        return int(text)
    if _OCTAL.fullmatch(text):
        return int(text[2:], 8)
    if _HEXADECIMAL.fullmatch(text):
        return int(text[2:], 16)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _INFINITY.fullmatch(text) or _NAN.fullmatch(text):
        return float(text.replace(".", ""))
    return text


def _syntax_error(error: yaml.MarkedYAMLError, locate: Callable[[int, int], Location]) -> ConfigError:
    mark = error.problem_mark or error.context_mark
    place = locate(1, 1) if mark is None else locate(mark.line + 1, mark.column + 1)
    message = error.problem or error.context or "cannot be read"
    for jargon, words in _WORDS.items():
        message = message.replace(jargon, words)
    everything = f"{error.context} {error.problem}"
    mend = next((hint for words, hint in _HINTS.items() if words in everything), "check the brackets and quotes")
    column = "" if place.column is None else f" (column {place.column})"
    return ConfigError([Mistake(place, "", f"is not YAML: {message}{column}; {mend}")])
