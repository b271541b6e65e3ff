"""Which room of the package may know which other.

A room imports only rooms to its left, and only through their public `__init__`; up to `fit`, rooms are pure.
"""

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

PACKAGE = "diffshadow"
ROOT = Path(__file__).parent.parent / PACKAGE

ORDER = ("geometry", "raster", "shadow", "shading", "fit", "config", "study", "cli")
EVERYBODY = {"_types", "_misc"}
# Beside the order: what each may know, and who may know it.
ASIDE_KNOWS = {"reference": {"geometry"}, "metrics": set(), "io": {"geometry"}, "_xla": set()}
KNOWN_BY = {
    "reference": {"fit", "config", "study", "cli"},
    "metrics": {"fit", "config", "study", "cli"},
    "io": {"config", "study", "cli"},
    "_xla": {"study", "cli"},
}
PURE = {*EVERYBODY, *ORDER[: ORDER.index("fit") + 1], "reference", "metrics"}
IMPURE_MODULES = {
    *("pathlib", "os", "shutil", "tempfile", "logging", "yaml", "pydantic", "matplotlib", "rich"),
    *("cyclopts", "imageio", "OpenEXR", "jinja2"),
}
# The reference shares its rays among the machine's cores, which it has to ask the system for.
EXCUSED = {("reference", "os")}
IMPURE_CALLS = {"open", "print", "input"}


def may_know(room: str) -> set[str]:
    """The rooms that `room` may import, itself apart."""
    if room in EVERYBODY:
        return EVERYBODY
    if room in ASIDE_KNOWS:
        return EVERYBODY | ASIDE_KNOWS[room]
    if room == "":  # the package's own face
        return EVERYBODY | set(ORDER) | set(ASIDE_KNOWS)
    left = set(ORDER[: ORDER.index(room)])
    return EVERYBODY | left | {aside for aside, known_by in KNOWN_BY.items() if room in known_by}


def imports(tree: ast.AST, module: str, is_package: bool, modules: set[str]) -> Iterator[tuple[int, str, str | None]]:
    """Each import of `tree`: its line, the absolute name of the module, and what is taken from it, if anything."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name, None
        elif isinstance(node, ast.ImportFrom):
            # One dot is the package that holds the file, which for an `__init__` is the module itself.
            parts = module.split(".")
            parent = parts[: len(parts) - node.level + is_package] if node.level else []
            source = ".".join([*parent, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = f"{source}.{alias.name}"
                yield (node.lineno, inner, None) if inner in modules else (node.lineno, source, alias.name)


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def import_breach(module: str, target: str, name: str | None) -> str | None:
    """What is wrong with `module` importing `target`, or `name` from it."""
    room, top = room_of(module), target.split(".")[0]
    if top != PACKAGE:
        impure = room in PURE and top in IMPURE_MODULES and (room, top) not in EXCUSED
        return f"imports {top}, but {room} is pure" if impure else None
    known = room_of(target)
    if known == room:
        return None
    if known == "":
        return f"imports {PACKAGE} itself; import the room that is meant"
    if known not in may_know(room):
        return f"imports {known}, which {room or PACKAGE} must not know"
    if target.count(".") > 1 or (name is not None and name.startswith("_")):
        return f"imports {'.'.join(filter(None, [target, name]))}; import from the public {PACKAGE}.{known} instead"
    return None


def impure_calls(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and node.func.id in IMPURE_CALLS:
                yield node.lineno, node.func.id
            elif isinstance(node.func, ast.Attribute) and node.func.attr == "print":
                yield node.lineno, "print"


def cycles(graph: Mapping[str, set[str]]) -> Iterator[list[str]]:
    """One closed path for each edge of a depth-first search that leads back into the path."""
    done: set[str] = set()

    def visit(module: str, path: list[str]) -> Iterator[list[str]]:
        if module in path:
            yield [*path[path.index(module) :], module]
        elif module not in done:
            for following in sorted(graph.get(module, set())):
                yield from visit(following, [*path, module])
            done.add(module)

    for module in sorted(graph):
        yield from visit(module, [])


def breaches(sources: Mapping[str, str]) -> list[str]:
    """Every broken rule in `sources`, which maps a path within the package to its text."""
    names = {path: module_name(path) for path in sources}
    modules = set(names.values())
    found, graph = [], {}
    for path, text in sources.items():
        module, is_package, tree = names[path], path.endswith("__init__.py"), ast.parse(text, path)
        room = room_of(module)
        if room not in {"", "__main__", *EVERYBODY, *ORDER, *ASIDE_KNOWS}:
            found.append(f"{path}: {room} is no room of the design")
            continue
        if room == "__main__":
            continue
        graph[module] = set()
        for line, target, name in imports(tree, module, is_package, modules):
            what = import_breach(module, target, name)
            if what:
                found.append(f"{path}:{line}: {what}")
            if target in modules:
                graph[module].add(target)
        if room in PURE:
            found += [f"{path}:{line}: calls {call}(), but {room} is pure" for line, call in impure_calls(tree)]
    return found + ["imports go in a circle: " + " -> ".join(cycle) for cycle in cycles(graph)]


def module_name(path: str) -> str:
    parts = [PACKAGE, *path.removesuffix(".py").split("/")]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_package_keeps_to_the_order_of_its_rooms():
    sources = {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in sorted(ROOT.rglob("*.py"))}
    assert {"_types.py", "_misc.py", "geometry/__init__.py"} <= sources.keys()
    assert breaches(sources) == []


SOUND = {
    "__init__.py": "",
    "_types.py": "from numpy import ndarray\n",
    "_misc.py": "from ._types import Array\n",
    "geometry/__init__.py": "from ._mesh import Mesh as Mesh\n",
    "geometry/_mesh.py": "from .._misc import dot\n",
    "raster/__init__.py": "",
    "shadow/__init__.py": "from . import filters\n",
    "shadow/_bias.py": "from ..raster import draw\n",
    "shadow/filters/__init__.py": "from ._pcf import Pcf\n",
    "shadow/filters/_pcf.py": "from ...geometry import Mesh\nfrom .._bias import Bias\n",
    "fit/__init__.py": "",
    "metrics/__init__.py": "",
    "reference/__init__.py": "import numpy as np\nfrom ..geometry import Mesh\n",
    "io/__init__.py": "from pathlib import Path\nfrom .._types import Array\nopen('x')\n",
    "study/__init__.py": "from .. import io\nfrom ..reference import trace\nfrom ..fit import fit\n",
    "cli.py": "import diffshadow.study\nimport os\nprint(os.sep)\n",
}


@pytest.mark.parametrize(
    ("path", "text", "message"),
    [
        ("geometry/_mesh.py", "from ..raster import draw", "imports raster, which geometry must not know"),
        ("geometry/_mesh.py", "from .. import raster", "imports raster, which geometry must not know"),
        ("geometry/_mesh.py", "import diffshadow.raster", "imports raster, which geometry must not know"),
        ("geometry/_mesh.py", "def f():\n    from diffshadow.raster import draw", "which geometry must not know"),
        ("shadow/filters/_pcf.py", "from ...fit import fit", "imports fit, which shadow must not know"),
        ("raster/__init__.py", "from ..shadow import Bias", "imports shadow, which raster must not know"),
        ("raster/__init__.py", "from .. import draw", "imports diffshadow itself"),
        ("reference/__init__.py", "from ..raster import draw", "imports raster, which reference must not know"),
        ("reference/__init__.py", "from ..shadow import Bias", "imports shadow, which reference must not know"),
        ("metrics/__init__.py", "from ..geometry import Mesh", "imports geometry, which metrics must not know"),
        ("io/__init__.py", "from ..fit import fit", "imports fit, which io must not know"),
        ("fit/__init__.py", "from ..io import read", "imports io, which fit must not know"),
        ("_types.py", "from .geometry import Mesh", "imports geometry, which _types must not know"),
        ("raster/__init__.py", "from ..geometry._mesh import Mesh", "import from the public diffshadow.geometry"),
        ("raster/__init__.py", "from ..geometry import _mesh", "import from the public diffshadow.geometry"),
        ("study/__init__.py", "from ..shadow.filters import Pcf", "import from the public diffshadow.shadow"),
        ("fit/__init__.py", "import os.path", "imports os, but fit is pure"),
        ("shadow/_bias.py", "from matplotlib import pyplot", "imports matplotlib, but shadow is pure"),
        ("raster/__init__.py", "open('x')", "calls open(), but raster is pure"),
        ("raster/__init__.py", "import jax\njax.debug.print('x')", "calls print(), but raster is pure"),
        ("shadow/_bias.py", "from .filters import Pcf", "_pcf -> diffshadow.shadow._bias -> diffshadow.shadow.filters"),
        ("geometry/_mesh.py", "from . import Mesh", "circle: diffshadow.geometry -> diffshadow.geometry._mesh"),
        ("_types.py", "from ._misc import dot", "circle: diffshadow._misc -> diffshadow._types"),
        ("helpers/__init__.py", "", "helpers is no room of the design"),
    ],
)
def test_a_planted_breach_is_found(path, text, message):
    assert breaches(SOUND) == []
    found = breaches({**SOUND, path: text})
    assert any(message in breach for breach in found), found
