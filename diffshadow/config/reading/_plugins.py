"""Sections of users' classes. Their `type` is `module:name`, such as `mypackage.filters:Gaussian`.

Their keys are the fields of the class, or of its `settings` if it has them. This is the only reason to import users'
code.
"""

import dataclasses
import functools
import importlib
import importlib.machinery
import inspect
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, get_args, get_origin, get_type_hints

from ...settings import MISSING, Fitted, Setting, Settings, bare, is_union
from ...settings.filters import Filter
from ...settings.fit import AnyLoss
from ...settings.techniques import OwnTechnique
from .._errors import Mistake, Origin, dotted
from ..sections._fit import LOSSES
from ..sections._section import Variants, value_at
from ..sections._technique import FILTERS, TECHNIQUES

COLON = ":"
"""The separator between a module and a name in it."""


class _Kind(NamedTuple):
    """A kind of class that may be a user's: the variants of its section, the base of their settings, and its base class
    in `shadow`; `None` for any callable."""

    variants: Variants
    base: type[Settings]
    parent: str | None


_KINDS: dict[tuple[str, ...], _Kind] = {
    ("technique",): _Kind(TECHNIQUES, OwnTechnique, "AbstractTechnique"),
    ("filter",): _Kind(FILTERS, Filter, "AbstractFilter"),
    ("fit", "loss"): _Kind(LOSSES, AnyLoss, None),
}


class _NotFoundError(ValueError):
    """A user's module is not found."""


def add_plugins(data: Mapping[str, Any], origin: Origin, folder: Path, *, needed: bool = True) -> list[Mistake]:
    """Adds the sections of the users' classes that `data` names.

    **Arguments:**

    - `folder`: the folder of the configuration. Modules are imported from there, from the current folder and from
      Python's path.
    - `needed`: whether their modules must exist. The settings of a finished run can be read without the modules: the
      stored keys and values then replace the fields of a missing class.

    **Returns** a mistake for each class that cannot be used.
    """
    mistakes = []
    for path in _KINDS:
        word = value_at(data, *path, "type")
        if isinstance(word, str) and COLON in word:
            try:
                try:
                    _add(path, word, folder)
                except _NotFoundError:
                    if needed:
                        raise
                    _add_stand_in(path, word, folder, value_at(data, *path))
            except ValueError as error:
                at = (*path, "type")
                mistakes.append(Mistake(origin.place(at), dotted(at), str(error)))
    return mistakes


def _add(path: tuple[str, ...], word: str, folder: Path, *, is_checked: bool = False) -> None:
    kind = _KINDS[path]
    plugin = _imported(word, folder, is_checked)
    _check_kind(word, plugin, kind)
    known = kind.variants.plugins.get(word)
    if known is None or known.plugin is not plugin:
        kind.variants.add(_settings_of(path, word, plugin, folder))


def _add_stand_in(path: tuple[str, ...], word: str, folder: Path, section: Mapping[str, Any]) -> None:
    """Adds a section with the keys and the types of values of `section`."""
    plain = {str(key): tuple(value) if isinstance(value, list) else value for key, value in section.items()}
    fields: list[Any] = [(key, _type_of(value), value) for key, value in plain.items() if key != "type"]
    module, _, name = word.partition(COLON)
    plugin = dataclasses.make_dataclass(name, fields, frozen=True, namespace={"__module__": module, "__doc__": word})
    _KINDS[path].variants.add(_settings_of(path, word, plugin, folder))


def _type_of(value: Any) -> Any:
    if value is None:
        return float | None
    if isinstance(value, tuple):
        return tuple[str if any(isinstance(entry, str) for entry in value) else float, ...]
    return type(value)


def _restored(path: tuple[str, ...], word: str, folder: Path, values: Mapping[str, Any]) -> Any:
    """A section of a user's class, in another process."""
    # A worker may have a copy of the module, and also see the module itself.
    _add(path, word, folder, is_checked=True)
    return _KINDS[path].variants.plugins[word].model_validate({"type": word, **values})


def _imported(word: str, folder: Path, is_checked: bool) -> Any:
    """The object `module:name`. **Raises** `ValueError` if it does not exist.

    `is_checked`: whether the module in the folder of the configuration is known to be the same one.
    """
    module_name, _, name = word.partition(COLON)
    parts = module_name.split(".")
    if not all(part.isidentifier() for part in (*parts, name)):
        raise ValueError(f"is {word}; expected a module and a name in it; write it as mypackage.mymodule:Gaussian")
    for place in (str(folder.absolute()), str(Path.cwd())):
        # Last in the path, so that a user's file does not replace an installed module.
        if place not in sys.path:
            sys.path.append(place)
    if not is_checked:
        _check_not_another(parts[0], folder)
    try:
        importlib.invalidate_caches()
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise ValueError(_failed(module_name, error)) from error
        raise _NotFoundError(
            f"names the module {module_name}, which Python does not find; expected one in {folder.absolute()}, in the "
            "current folder or among installed packages; check its name, or set PYTHONPATH"
        ) from error
    except Exception as error:
        raise ValueError(_failed(module_name, error)) from error
    if not hasattr(module, name):
        names = [each for each, value in vars(module).items() if getattr(value, "__module__", None) == module_name]
        listed = f"one of {', '.join(names)}" if names else "a name in it"
        raise ValueError(f"names {name}, which {module_name} does not have; expected {listed}; check the name")
    return getattr(module, name)


def _failed(module: str, error: Exception) -> str:
    return (
        f"names the module {module}, which cannot be imported ({type(error).__name__}: {error}); expected a working "
        f"import; try python -c 'import {module}'"
    )


def _check_not_another(package: str, folder: Path) -> None:
    """**Raises** `ValueError` if the imported module of this name differs from the one in a configuration's
    `folder`."""
    own = importlib.machinery.PathFinder.find_spec(package, [str(folder.absolute())])
    loaded = getattr(sys.modules.get(package), "__file__", None)
    if own is not None and own.origin and loaded and Path(own.origin).resolve() != Path(loaded).resolve():
        raise ValueError(
            f"names the module {package} beside the configuration, and another {loaded} is imported by that name; "
            "expected a unique module name; rename the file"
        )


def _check_kind(word: str, plugin: Any, kind: _Kind) -> None:
    if kind.parent is None:
        if not callable(plugin):
            raise ValueError(f"is {word}, which is not a function; expected a function or class; name another")
        if inspect.isclass(plugin) and not hasattr(plugin, "__call__"):  # noqa: B004
            raise ValueError(f"is {word}, whose objects are not callable; expected __call__; add it to the class")
        return
    # Imported here, because JAX is slow to load and nothing else in this folder needs it.
    from ... import shadow

    parent = getattr(shadow, kind.parent)
    if not (inspect.isclass(plugin) and issubclass(plugin, parent)):
        raise ValueError(f"is {word}, which is not a shadow.{kind.parent}; expected a class that inherits from it")
    if inspect.isabstract(plugin):
        missing = ", ".join(sorted(getattr(plugin, "__abstractmethods__")))  # noqa: B009
        raise ValueError(f"is {word}, which lacks {missing}; expected a class with all methods; add them")


def _settings_of(path: tuple[str, ...], word: str, plugin: Any, folder: Path) -> type[Settings]:
    """A class of settings for a user's class: a subclass of its own settings, or a class made from its fields."""
    base, own = _KINDS[path].base, getattr(plugin, "settings", Settings)
    is_described = inspect.isclass(own) and issubclass(own, Settings) and own is not Settings
    settings = (own,) if is_described and issubclass(own, base) else (own, base) if is_described else (base,)
    keys = {} if is_described else dict(_keys(word, plugin))
    hints = {key: hint for key, (hint, _) in keys.items()}
    values = {key: default for key, (_, default) in keys.items() if default is not MISSING}

    def reduce(section: Any) -> Any:
        given = {key: getattr(section, key) for key in type(section).model_fields if key != "type"}
        return _restored, (path, word, folder, given)

    body: dict[str, Any] = {
        "__doc__": inspect.getdoc(plugin) or word,
        "__module__": plugin.__module__,
        "__annotations__": {"type": Literal[word], "plugin": ClassVar[Any], **hints},
        "__reduce__": reduce,
        "type": word,
        "plugin": plugin if inspect.isclass(plugin) else staticmethod(plugin),
        **values,
    }
    if not is_described and base is Filter:
        body["reach_of"] = classmethod(functools.partial(_reach_of, tuple(hints)))
    return type(getattr(plugin, "__name__", word), settings, body)


def _reach_of(keys: tuple[str, ...], settings: Any, values: Any) -> Any:
    """The reach of a user's filter with these `values`, in texels, as the filter reports it; 0 if it does not."""
    try:
        reach = settings.plugin(**{key: getattr(values, key) for key in keys}).reach
    except Exception:
        # If it cannot be made, the build reports this.
        return 0.0
    return 0.0 if reach is None else reach


def _keys(word: str, plugin: Any) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """The type with marks and the default of each field of a user's class that YAML can set."""
    if not dataclasses.is_dataclass(plugin):
        return
    hints = get_type_hints(plugin, include_extras=True)
    for field in dataclasses.fields(plugin):
        if not field.init:
            continue
        default = _default(field)
        hint = _in_yaml(hints[field.name], field.metadata.get("static", False))
        if hint is not None and (default is MISSING or _is_plain(default)):
            yield field.name, (hint, _plain(default))
        elif default is MISSING:
            raise ValueError(
                f"is {word}, whose field {field.name} is not a number, text or choice, and has no default; expected "
                "a field that YAML can set; give it a default"
            )


def _default(field: Any) -> Any:
    if field.default is not dataclasses.MISSING:
        return field.default
    return MISSING if field.default_factory is dataclasses.MISSING else field.default_factory()


def _is_plain(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str) or getattr(value, "shape", None) == ()


def _plain(value: Any) -> Any:
    """A scalar array as a number."""
    return value.item() if hasattr(value, "item") else value


def _in_yaml(annotation: Any, static: bool) -> Any:
    """The type of a field in a section; `None` if YAML has no such type. Numbers that may be traced can be fitted."""
    kind, marks = bare(annotation)
    if getattr(kind, "dim_str", None) == "" or kind is float:
        fitted = () if static or any(isinstance(mark, Fitted) for mark in marks) else (Fitted(needs_value=True),)
        found: Any = Annotated[(float, *marks, *fitted)] if marks or fitted else float
    elif kind in (int, bool, str) or get_origin(kind) is Literal:
        found = Annotated[(kind, *marks)] if marks else kind
    elif get_origin(kind) is tuple:
        entries = [entry if entry is Ellipsis else _in_yaml(entry, True) for entry in get_args(kind)]
        if None in entries:
            return None
        found = Annotated[(tuple[tuple(entries)], *marks)] if marks else tuple[tuple(entries)]
    elif is_union(kind):
        # A number that may be a Python number or an array.
        found = next((each for each in (_in_yaml(one, static) for one in get_args(kind)) if each is not None), None)
    else:
        return None
    return found | None if found is not None and Setting.of(annotation).optional else found
