"""Writes a configuration as YAML and as a table."""

import functools
import pickle
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import yaml

from .._errors import KeyPath, dotted, printable, show
from ..sections._config import Config
from ..sections._fitted import fit_units
from ..sections._section import Section
from ._keys import ROOT, Slot, keys_of, slot_of
from ._yaml import plain_scalar


class Row(NamedTuple):
    """One setting: its dotted key, its value as text, and its unit."""

    key: str
    value: str
    unit: str


def dump_resolved(config: Config) -> str:
    """`config` as YAML with all defaults. Loading it gives an equal configuration."""
    # Most sections of many runs are equal, and YAML takes several milliseconds to write.
    return "".join(_dumped(pickle.dumps({key: value})) for key, value in data_of(config).items())


@functools.lru_cache(maxsize=1024)
def _dumped(section: bytes) -> str:
    return dump(pickle.loads(section))


def dump(data: Any) -> str:
    """Dicts, lists and scalars as YAML; reading it gives equal data."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)


def describe(config: Config) -> list[Row]:
    """Every setting of `config` that has a value, in the schema's order."""
    start, units = "fit.parameters.", fit_units(config)
    return [
        # A fitted number has the unit of its key. A render's configuration may list parameters that do not exist.
        row._replace(unit=units.get(row.key.removeprefix(start).rpartition(".")[0], ""))
        if row.key.startswith(start)
        else row
        for row in _rows(config, ROOT, ())
    ]


def data_of(value: Any) -> Any:
    """A configuration, or a `value` in one, as dicts, lists and scalars, without keys that have no value."""
    if isinstance(value, str | int | float):
        return value
    if isinstance(value, Section):
        keys = keys_of(type(value))
        return {key: data_of(inner) for key in keys if (inner := getattr(value, key)) is not None}
    if isinstance(value, Mapping):
        return {key: data_of(inner) for key, inner in value.items()}
    return [data_of(inner) for inner in value] if isinstance(value, list | tuple) else value


def _rows(value: Any, slot: Slot, path: KeyPath) -> Iterator[Row]:
    if isinstance(value, Section):
        units = value.units()
        for key in keys_of(type(value)):
            for row in _rows(getattr(value, key), slot_of(type(value).model_fields[key]), (*path, key)):
                yield row._replace(unit=units.get(key, row.unit))
        return
    entries = value.items() if isinstance(value, Mapping) else enumerate(value if isinstance(value, tuple) else ())
    sections = [(step, entry) for step, entry in entries if isinstance(entry, Section)]
    if sections:
        for step, entry in sections:
            yield from _rows(entry, Slot(type(entry)), (*path, step))
    elif value is not None and value != {}:
        yield Row(printable(dotted(path)), _text(value), slot.unit)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{printable(key)} = {_text(inner)}" for key, inner in value.items())
    return printable(value) if isinstance(value, str) else show(value)


class _Dumper(yaml.SafeDumper):
    """Writes YAML for `read_yaml`: YAML 1.2's scalars, with lists of numbers on one line."""

    def ignore_aliases(self, data: Any) -> bool:
        """Never writes aliases, even if a list occurs twice."""
        return True


# Line breaks that PyYAML considers printable.
_LINE_BREAKS = frozenset("\x85\u2028\u2029")


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    # PyYAML quotes text that YAML 1.1 would misread. YAML 1.2 reads more text as numbers, such as 1e-3.
    style = None if isinstance(plain_scalar(text), str) else "'"
    if _LINE_BREAKS.intersection(text):
        # Single quotes would fold a line break to a space.
        style = '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


def _represent_list(dumper: yaml.SafeDumper, items: list[Any] | tuple[Any, ...]) -> yaml.Node:
    flow = not any(isinstance(item, dict) for item in items)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=flow)


_Dumper.add_representer(str, _represent_text)
_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(tuple, _represent_list)
