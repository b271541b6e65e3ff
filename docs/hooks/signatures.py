"""What only the imported package knows of its classes: parameters, and docstrings with the ranges of settings.

Also warns of public names without a docstring, which fails a strict build.
"""

import inspect
import logging
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from griffe import (
    AliasResolutionError,
    Attribute,
    Class,
    Docstring,
    Extension,
    Function,
    Module,
    Object,
    Parameter,
    ParameterKind,
    Parameters,
)

_LOG = logging.getLogger("mkdocs.plugins.signatures")
_KINDS = dict(zip(inspect._ParameterKind, ParameterKind, strict=True))
_MAX_DEFAULT = 60


class Signatures(Extension):
    """Completes the classes of a package, and checks its docstrings."""

    def on_package(self, *, pkg: Module, **_: Any) -> None:
        complete(pkg, import_module(pkg.path))
        for path in undocumented(pkg):
            _LOG.warning("%s is public and has no docstring", path)


def complete(holder: Module | Class, made: Any = None) -> None:
    """Gives classes their docstrings and parameters at run time, and all parameters the values of their defaults."""
    for member in list(holder.members.values()):
        if member.is_alias:
            continue
        if isinstance(member, Module):
            complete(member, import_module(member.path))
        elif isinstance(member, Class) and (own := getattr(made, member.name, None)) is not None:
            if own.__doc__:
                member.docstring = Docstring(inspect.cleandoc(own.__doc__), parent=member)
            if "__init__" not in member.members:
                add_init(member, own)
            complete(member, own)
        elif isinstance(member, Function):
            known = signature(getattr(made, member.name, None))
            for parameter in member.parameters:
                if parameter.default is not None and parameter.name in known:
                    parameter.default = default(known[parameter.name])


def signature(made: Any) -> Mapping[str, inspect.Parameter]:
    """The parameters of a class or a function, as far as Python knows them."""
    try:
        return inspect.signature(made).parameters
    except (TypeError, ValueError):
        return {}


def add_init(cls: Class, made: type) -> None:
    """Adds the `__init__` of a class that is made by its fields."""
    parameters = [Parameter("self", kind=ParameterKind.positional_or_keyword)]
    for each in signature(made).values():
        kind = _KINDS[each.kind]
        parameters.append(Parameter(each.name, annotation=annotation(cls, each), kind=kind, default=default(each)))
    # With the lines of the class, which are then shown as its source.
    lines = {"lineno": cls.lineno, "endlineno": cls.endlineno}
    cls.set_member("__init__", Function("__init__", parameters=Parameters(*parameters), parent=cls, **lines))


def annotation(cls: Class, parameter: inspect.Parameter) -> Any:
    """The annotation of a field, as its class or a base states it."""
    for holder in (cls, *cls.mro()):
        field = holder.members.get(parameter.name)
        if isinstance(field, Attribute) and field.annotation is not None:
            return field.annotation
    return None


def default(parameter: inspect.Parameter) -> str | None:
    """The default's text, where it is short."""
    if parameter.default is parameter.empty:
        return None
    text = " ".join(repr(parameter.default).split())
    return text if len(text) <= _MAX_DEFAULT and "<" not in text else "..."


def undocumented(pkg: Module) -> list[str]:
    """Public names, and public methods of public classes, that no docstring describes."""
    found = []
    for subpackage in (pkg, *pkg.modules.values()):
        if subpackage.name.startswith("_") or not subpackage.is_init_module:
            continue
        public = subpackage.exports or subpackage.members
        for name, alias in subpackage.members.items():
            if name not in public:
                continue
            if not alias.is_alias or name.startswith("_") or not alias.target_path.startswith(f"{pkg.name}."):
                continue
            try:
                target = alias.final_target
            except AliasResolutionError:
                # Such as one of several names in one assignment, which no docstring can follow.
                found.append(f"{subpackage.path}.{name}")
                continue
            if target.is_module:
                continue
            found += [f"{subpackage.path}.{name}{each}" for each in lacking(target)]
    return sorted(set(found))


def lacking(target: Object) -> list[str]:
    """Of a name and its public methods, which have no docstring: "" for itself."""
    found = [] if target.has_docstring else [""]
    if isinstance(target, Class):
        bases = target.mro()
        for name, member in target.members.items():
            method = isinstance(member, Function) or (isinstance(member, Attribute) and "property" in member.labels)
            if name.startswith("_") or not method or member.has_docstring:
                continue
            # A class may describe its properties in its own docstring.
            if any(f"`{name}`" in holder.docstring.value for holder in (target, *bases) if holder.docstring):
                continue
            if not any(name in base.members and base.members[name].has_docstring for base in bases):
                found.append(f".{name}")
    return found
