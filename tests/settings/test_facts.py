"""Each default, limit and list of choices is stated once, in `settings`."""

import ast
import contextlib
import inspect
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ranges import described, fields_of

from diffshadow import fit, geometry, shading, shadow
from diffshadow.config.sections._section import Section
from diffshadow.settings import MISSING, Settings

PACKAGE = Path(shadow.__file__).parents[1]
SOURCES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))}


def below(base: type) -> Iterator[Any]:
    for inner in base.__subclasses__():
        yield inner
        yield from below(inner)


def defaults_of(module: Any) -> dict[str, Any]:
    """The defaults of the arguments that make a module."""
    parameters = inspect.signature(module).parameters.values()
    return {each.name: each.default for each in parameters if each.default is not inspect.Parameter.empty}


def test_settings_describe_what_is_public():
    assert len(described()) > 35
    assert {shadow.PercentageCloser, shadow.BabylonJs, shadow.MapSettings, geometry.SpotLight} <= set(described())
    assert {shading.Phong, fit.Solver, fit.Anneal, fit.Loss, shadow.Cascades} <= set(described())


# What a module is by default where its settings have none: they leave it to other parts of a configuration.
LEFT_OPEN = {("Phong", "intensity"), ("Cascades", "max_share")}


@pytest.mark.parametrize("module", described(), ids=lambda module: module.__name__)
def test_defaults_of_modules_are_those_of_their_settings(module):
    for name, default in defaults_of(module).items():
        setting = fields_of(module).get(name)
        if setting is not None and (module.__name__, name) not in LEFT_OPEN:
            assert np.all(default == setting.default), name


def literals(tree: ast.AST) -> Iterator[frozenset[Any]]:
    """The words of each list of choices in a source file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == "Literal":
            words = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            yield frozenset(word.value for word in words if isinstance(word, ast.Constant))


def test_no_list_of_choices_stands_twice():
    places = defaultdict(list)
    for path, tree in SOURCES.items():
        for words in literals(tree):
            if len(words) > 1:
                places[words].append(path.relative_to(PACKAGE).as_posix())
    assert len(places) > 25
    assert {words: at for words, at in places.items() if len(at) > 1} == {}


def constants(tree: ast.AST) -> Iterator[tuple[str, Any, int]]:
    """Each name with a default that is written out: of arguments, and of fields."""
    for node in ast.walk(tree):
        pairs: list[tuple[str, ast.expr | None]] = []
        if isinstance(node, ast.FunctionDef | ast.Lambda):
            plain, named = [*node.args.posonlyargs, *node.args.args], node.args.kwonlyargs
            pairs += zip([arg.arg for arg in plain[::-1]], node.args.defaults[::-1], strict=False)
            pairs += zip([arg.arg for arg in named], node.args.kw_defaults, strict=True)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            call = node.value.keywords if isinstance(node.value, ast.Call) else []
            pairs += [(node.target.id, word.value) for word in call if word.arg == "default"]
            pairs += [] if isinstance(node.value, ast.Call) else [(node.target.id, node.value)]
        for name, value in pairs:
            with contextlib.suppress(ValueError):
                yield name, None if value is None else ast.literal_eval(value), node.lineno


# Other things of the same names.
OTHERS = {
    ("fit/_parameters.py", "unit"),
    ("fit/_run.py", "blur"),
    ("geometry/_transforms.py", "aspect"),
    ("geometry/lights/_frustum.py", "aspect"),
    ("io/scenes/_parts.py", "side"),
    ("io/scenes/_three_geometries.py", "radius"),
    ("io/scenes/_three_schema.py", "aspect"),
    ("shadow/kernels/_taps.py", "radius"),
    ("study/record/_runs.py", "blur"),
}


def test_no_default_of_a_setting_is_written_again():
    # Of modules, and of functions with the same arguments.
    known = defaultdict(list)
    for settings in below(Settings):
        if not issubclass(settings, Section):
            for key, setting in settings.each().items():
                for path in setting.paths(key):
                    known[path.rpartition(".")[2]].append(setting.default)
    again = []
    for path, tree in SOURCES.items():
        where = path.relative_to(PACKAGE).as_posix()
        if where.startswith("settings/"):
            continue
        for name, value, line in constants(tree):
            is_known = any(type(value) is type(each) and value == each for each in known[name])
            if value is not None and is_known and (where, name) not in OTHERS:
                again.append(f"{where}:{line}: {name} = {value!r}")
    assert again == [], "\n".join(again)


def test_sections_declare_no_key_of_their_settings():
    for section in below(Section):
        own = set(vars(section).get("__annotations__", {}))
        inherited = [each for each in section.__mro__ if issubclass(each, Settings) and not issubclass(each, Section)]
        assert not own & {key for each in inherited for key in each.each()}, section


def test_every_section_s_default_is_that_of_its_settings():
    checked = 0
    for section in below(Section):
        for settings in section.__mro__[1:]:
            if issubclass(settings, Settings) and not issubclass(settings, Section):
                for key, setting in settings.each().items():
                    if setting.default is not MISSING:
                        assert section.model_fields[key].default == setting.default or key in OTHERWISE, (section, key)
                        checked += 1
    assert checked > 100


# The light of a configuration has a size by default.
OTHERWISE = {"angular_radius"}
