"""Random configurations: values that the schema allows, and ways to spoil what is valid.

The schema is the JSON schema of `Config` itself, so a new key is drawn and spoilt like all others.
"""

import copy
import inspect
import json
import math
import string
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import words

from diffshadow.config import Config
from diffshadow.geometry import LIBRARY

SCHEMA = Config.model_json_schema()
Path = tuple[str | int, ...]


def plain(schema: dict[str, Any]) -> dict[str, Any]:
    """`schema` without references."""
    while "$ref" in schema:
        schema = SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]]
    return schema


def valid(rng: Random, schema: dict[str, Any], key: str = "", wild: float = 0.1) -> Any:
    """A value that `schema` allows at `key`; `wild` is the share of numbers at the ends of their range."""
    schema = plain(schema)
    if "const" in schema:
        return schema["const"]
    if "enum" in schema:
        return rng.choice(schema["enum"])
    if variants := schema.get("oneOf") or schema.get("anyOf"):
        return valid(rng, rng.choice(variants), key, wild)
    match schema.get("type"):
        case "null":
            return None
        case "boolean":
            return rng.random() < 0.5
        case "integer" | "number":
            return number(rng, schema, wild)
        case "string":
            return rng.choice(words.BY_KEY.get(key, ["word"]))
        case "array":
            entries = schema.get("prefixItems") or [schema["items"]] * rng.choice([1, 1, 2, 3])
            return [valid(rng, entry, key, wild) for entry in entries]
        case "object" if "properties" in schema:
            return section(rng, schema, wild)
        case "object":
            inner = schema.get("additionalProperties")
            names = words.BY_KEY.get(key, ["size", "segments", "radius"])
            inner = inner if isinstance(inner, dict) else {}
            return {rng.choice(names): valid(rng, inner, "", wild) for _ in range(rng.choice([0, 1, 1, 2]))}
    return rng.choice([0, 1, 2.5, "pcf", True])


def section(rng: Random, schema: dict[str, Any], wild: float = 0.1) -> dict[str, Any]:
    """A section with its required keys and a few others."""
    required, share = schema.get("required", ()), rng.choice([0.1, 0.3, 0.6])
    found = {
        key: valid(rng, inner, key, wild)
        for key, inner in schema["properties"].items()
        if key in required or key == "type" or rng.random() < share
    }
    if name := str(found.get("path", "")).removeprefix("builtin:"):
        found["options"] = options_of(rng, name) if name in LIBRARY else {}
    return found


def options_of(rng: Random, name: str) -> dict[str, Any]:
    """Options of the builtin mesh `name`, which the schema leaves open; few triangles."""
    options = {}
    for option, of in inspect.signature(LIBRARY[name]).parameters.items():
        if option in ("segments", "sides"):
            options[option] = 8
        elif option == "subdivisions":
            options[option] = 1
        elif rng.random() < 0.2:
            options[option] = of.default if rng.random() < 0.5 else rng.choice([1, 0.5, 0.1])
    return options


def limits(schema: dict[str, Any]) -> tuple[float, float]:
    low = schema.get("minimum", schema.get("exclusiveMinimum", -math.inf))
    return low, schema.get("maximum", schema.get("exclusiveMaximum", math.inf))


def number(rng: Random, schema: dict[str, Any], wild: float = 0.1) -> int | float:
    """A number within the limits of `schema`."""
    low, high = limits(schema)
    if rng.random() < wild:
        ends = [end for end in (low, high) if math.isfinite(end)] + [low + 1e-9, high - 1e-9, 1e-30, 1e30, 1e300]
        found = rng.choice([end for end in ends if low <= end <= high and math.isfinite(end)])
    elif math.isfinite(low) and math.isfinite(high) and high - low < 400:
        found = rng.uniform(low, high)
    else:
        found = min(max(low, 0) + rng.choice([0.0, 0.5, 1.0, 2.0, rng.uniform(0, 10), 10 ** rng.uniform(-6, 2)]), high)
    if schema["type"] == "integer":
        return int(math.ceil(found) if found < high else math.floor(found))
    strict = found in (schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum"))
    inside = 1 if found == low else -1
    return (math.nextafter(found, inside * math.inf) if wild else found + inside * 1e-3) if strict else found


def places(data: Any, schema: dict[str, Any], path: Path = ()) -> Iterator[tuple[Path, dict[str, Any]]]:
    """The path of every value in `data`, and what the schema says of it (nothing, where it says nothing)."""
    schema = plain(schema)
    schema = plain(schema if not isinstance(data, dict | list) else _variant(data, schema))
    yield path, schema
    if isinstance(data, dict):
        known, other = schema.get("properties", {}), schema.get("additionalProperties")
        for key, inner in data.items():
            yield from places(inner, known.get(key, other if isinstance(other, dict) else {}), (*path, key))
    elif isinstance(data, list):
        entries = schema.get("prefixItems") or [schema.get("items", {})] * len(data)
        for i, (inner, entry) in enumerate(zip(data, entries, strict=False)):
            yield from places(inner, entry, (*path, i))


def _variant(data: Any, schema: dict[str, Any]) -> dict[str, Any]:
    """The one of several schemas that suits `data` best."""
    variants = [plain(variant) for variant in schema.get("oneOf") or schema.get("anyOf") or [schema]]
    kind = "object" if isinstance(data, dict) else "array"
    suits = lambda one: sum(key in one.get("properties", {}) for key in data) if kind == "object" else 0
    typed = lambda one: kind == "object" and one.get("properties", {}).get("type", {}).get("const") == data.get("type")
    return max(variants, key=lambda one: (one.get("type") == kind or "oneOf" in one, typed(one), suits(one)))


def get(data: Any, path: Path) -> Any:
    for step in path:
        data = data[step]
    return data


def odd(rng: Random) -> Any:
    """A value that hardly any key takes."""
    return rng.choice(
        [
            lambda: rng.choice(words.TEXT),
            lambda: rng.choice(words.NUMBERS),
            lambda: rng.choice(words.NUMBERS),
            lambda: words.Verbatim(rng.choice(words.YAML)),
            lambda: rng.choice(words.OTHERS),
            lambda: [rng.choice(words.NUMBERS) for _ in range(rng.choice([1, 2, 3, 4]))],
        ]
    )()


def misspelt(rng: Random, word: str) -> str:
    """`word` with a slip of the finger, or another word."""
    i = rng.randrange(len(word) + 1)
    return rng.choice(
        [
            word[:i] + word[i + 1 :],
            word[:i] + rng.choice(string.ascii_letters + "._- ") + word[i:],
            word.upper(),
            word + "s",
            rng.choice(words.TEXT),
            rng.choice([key for one in SCHEMA["$defs"].values() for key in one.get("properties", {"type": {}})]),
        ]
    )


def spoil(rng: Random, data: dict[str, Any], of: dict[str, Any] = SCHEMA) -> None:
    """Changes one thing in `data`, which was written by the schema `of`, mostly for the worse."""
    path, schema = rng.choice(list(places(data, of))[1:] or [((next(iter(SCHEMA["properties"])),), {})])
    data.setdefault(path[0], None)
    holder, key = get(data, path[:-1]), path[-1]
    name = str(key if isinstance(key, str) else path[-2])

    def delete() -> None:
        del holder[key]

    def rename() -> None:
        value = holder.pop(key)
        if isinstance(holder, dict):
            holder[misspelt(rng, str(key))] = value
        else:
            holder.append(value)

    def double() -> None:
        twice = copy.deepcopy(holder[key])
        if isinstance(holder, list):
            holder.extend([twice] * rng.choice([1, 1, 2, 40]))
        else:
            # The same key to a reader of YAML, and another to a dict.
            holder[words.Verbatim(json.dumps(key))] = twice

    def replace_oddly() -> None:
        holder[key] = odd(rng)

    def step_outside() -> None:
        low, high = limits(schema)
        ends = [low - 1, low, low - 1e-9, high + 1, high + 1e-9, high, *words.NUMBERS]
        holder[key] = rng.choice([end for end in ends if not math.isinf(end)]) if schema else odd(rng)

    def replace_validly() -> None:
        holder[key] = valid(rng, schema, name) if schema else odd(rng)

    def contradict() -> None:
        inner = holder if isinstance(holder, dict) else data
        own = dict(places(data, of)).get(path[:-1] if inner is holder else (), {})
        anywhere = rng.choice([one for one in SCHEMA["$defs"].values() if "properties" in one])
        among = own.get("properties", {}) if rng.random() < 0.7 else anywhere["properties"]
        if among:
            new = rng.choice(list(among))
            inner[new] = valid(rng, among[new], new)

    def replace_section() -> None:
        new = rng.choice(list(SCHEMA["properties"]))
        data[new] = valid(rng, SCHEMA["properties"][new], new)

    changes: list[Callable[[], None]] = [delete, rename, double, replace_oddly, replace_oddly, step_outside]
    changes += [replace_validly, replace_validly, contradict, contradict, replace_section]
    rng.choice(changes)()


def garble(rng: Random, text: bytes) -> bytes:
    """Changes one thing in the text of a file, whatever it means."""
    lines = text.split(b"\n")
    i, at = rng.randrange(len(lines)), rng.randrange(len(text) + 1)
    same = lambda: [*lines[:i], lines[i], *lines[i:]]
    return rng.choice(
        [
            lambda: text[:at] + rng.choice(words.BYTES) + text[at:],
            lambda: text[:at] + rng.choice(words.BYTES) + text[at:],
            lambda: text[:at] + text[at + rng.choice([1, 1, 2, 30]) :],
            lambda: text[:at],
            lambda: text[:at] + bytes([rng.randrange(256)]) + text[at + 1 :],
            lambda: b"\n".join(same()),
            lambda: b"\n".join([*lines[:i], *lines[i + 1 :]]),
            lambda: b"\n".join([*lines[:i], rng.choice([b" ", b"\t", b"   "]) + lines[i], *lines[i + 1 :]]),
            lambda: b"\n".join([*lines[:i], lines[i].lstrip(), *lines[i + 1 :]]),
            lambda: text + rng.choice([text, *words.ENDS]),
            lambda: text.decode("utf-8", "replace").encode(rng.choice(["utf-16", "utf-16-le", "utf-8-sig", "utf-32"])),
            lambda: rng.choice(words.WHOLE),
        ]
    )()


def write(value: Any, indent: int = 0) -> str:
    """`value` as YAML: sections and lists of sections a line for each key, all else on one line."""
    pad = "  " * indent
    if isinstance(value, dict) and value:
        lines = [f"{pad}{_key(key)}:{_below(inner, indent)}" for key, inner in value.items()]
        return "\n".join(lines)
    if isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
        return "\n".join(f"{pad}-{_below(inner, indent)}" for inner in value)
    return pad + inline(value)


def _below(value: Any, indent: int) -> str:
    text = write(value, indent + 1)
    whole = isinstance(value, dict | list) and ("\n" in text or isinstance(value, dict)) and value
    return f"\n{text}" if whole else f" {text.strip(' ')}"


def _key(key: Any) -> str:
    simple = isinstance(key, str) and key and all(c in string.ascii_letters + string.digits + "_." for c in key)
    return key if simple or isinstance(key, words.Verbatim) else json.dumps(key)


def inline(value: Any) -> str:
    """`value` on one line."""
    match value:
        case words.Verbatim():
            return value
        case dict():
            return f"{{{', '.join(f'{_key(key)}: {inline(inner)}' for key, inner in value.items())}}}"
        case list() | tuple():
            return f"[{', '.join(map(inline, value))}]"
        case float() if not math.isfinite(value):
            return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return json.dumps(value)
