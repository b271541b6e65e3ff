"""Which subpackage may import which other.

A subpackage imports only subpackages to its left in `ORDER`, and only through their public `__init__`. The subpackages
up to `fit` are pure. Within a subpackage, imports for annotations alone are free.
"""

import ast
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

PACKAGE = "diffshadow"
ROOT = Path(__file__).parent.parent / PACKAGE

ORDER = ("geometry", "raster", "shadow", "shading", "fit", "config", "console", "study", "viewer", "cli")
COMMON = {
    "_types",
    "_srgb",
    "_device",
    "_padding",
    "_arithmetic",
    "_checks",
    "_pictures",
    "_progress",
    "_self_intersections",
    "_words",
    "settings",
}
# Their modules are public, and they need neither JAX nor pydantic.
SETTINGS = "settings"
OF_SETTINGS = {*sys.stdlib_module_names, "annotated_types"}
# Folders and files within a subpackage, each of which imports only those to its left. Files that are not listed come
# before all of them.
FOLDERS = {
    "fit": (
        *(
            "solvers",
            "problems",
            "_precision",
            "_phases",
            "_judge",
            "_solve",
            "_run",
            "_profile",
            "_how",
            "_front",
            "_bounds",
        ),
        *("_fit", "_train", "_moving_lights", "_hull", "_shape_steps", "_shape_program", "_shape"),
    ),
    "config": ("sections", "framing", "reading", "building"),
    "study": ("record", "pages", "imports", "exports", "_drawn", "remarks", "runs", "sweeps", "advice", "_report"),
}
# Outside the order: what each may import, and which may import it.
ASIDE_IMPORTS = {"reference": {"geometry"}, "metrics": set(), "io": {"geometry"}, "_xla": set(), "_memory": set()}
ASIDE_IMPORTS |= {"_interrupts": set(), "_display": set(), "_setup": {"_display", "_xla", "_memory", "io"}}
IMPORTED_BY = {
    "reference": {"fit", "study", "viewer"},
    "metrics": {"study", "viewer"},
    "io": {"config", "study", "viewer", "cli"},
    "_xla": {"study"},
    "_memory": {"fit", "study", "viewer"},
    "_interrupts": {"cli"},
    "_display": set(),
    "_setup": {"cli"},
}
PURE = {*COMMON, *ORDER[: ORDER.index("fit") + 1], "reference", "metrics"}
IMPURE_MODULES = {
    *("pathlib", "os", "shutil", "tempfile", "logging", "yaml", "pydantic", "matplotlib", "rich"),
    *("cyclopts", "PIL", "OpenEXR", "jinja2"),
}
# The reference traces on all cores, and asks the system for their number. JAX logs what a callback raises, which a fit
# raises itself.
EXCEPTIONS = {("reference", "os"), ("fit", "logging")}
IMPURE_CALLS = {"open", "print", "input"}


def may_import(subpackage: str) -> set[str]:
    """The other subpackages that `subpackage` may import."""
    if subpackage in COMMON:
        return set() if subpackage == SETTINGS else COMMON
    if subpackage in ASIDE_IMPORTS:
        return COMMON | ASIDE_IMPORTS[subpackage]
    if subpackage == "":  # the package itself
        return COMMON | set(ORDER) | set(ASIDE_IMPORTS)
    left = set(ORDER[: ORDER.index(subpackage)])
    return COMMON | left | {aside for aside, imported_by in IMPORTED_BY.items() if subpackage in imported_by}


def for_annotations(tree: ast.AST) -> set[int]:
    """The lines of imports that only a type checker sees."""
    blocks = (node for node in ast.walk(tree) if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    return {node.lineno for block in blocks for node in block.body}


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


def subpackage_of(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def folder_breach(module: str, target: str, subpackage: str) -> str | None:
    """What is wrong with `module` importing `target`, of the same subpackage."""
    if module.count(".") == 1:
        return None
    order = FOLDERS.get(subpackage, ())
    importing, imported = (name.split(".")[2] if name.count(".") > 1 else "" for name in (module, target))
    place = lambda folder: order.index(folder) if folder in order else -1
    if place(importing) < place(imported):
        return f"imports {imported}, which comes after {importing} in {subpackage}"
    return None


def import_breach(module: str, target: str, name: str | None) -> str | None:
    """What is wrong with `module` importing `target`, or `name` from it."""
    subpackage, top = subpackage_of(module), target.split(".")[0]
    if top != PACKAGE:
        if subpackage == SETTINGS and top not in OF_SETTINGS:
            return f"imports {top}, but settings need nothing but the standard library"
        impure = subpackage in PURE and top in IMPURE_MODULES and (subpackage, top) not in EXCEPTIONS
        return f"imports {top}, but {subpackage} is pure" if impure else None
    imported = subpackage_of(target)
    if imported == subpackage:
        return folder_breach(module, target, subpackage)
    if imported == "":
        return f"imports {PACKAGE} itself; import the subpackage that is meant"
    if imported not in may_import(subpackage):
        return f"imports {imported}, which {subpackage or PACKAGE} must not import"
    is_private = any(part.startswith("_") for part in [*target.split(".")[2:], name or ""])
    if is_private or (target.count(".") > 1 and imported != SETTINGS):
        return f"imports {'.'.join(filter(None, [target, name]))}; import from the public {PACKAGE}.{imported} instead"
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
        subpackage = subpackage_of(module)
        if subpackage not in {"", "__main__", *COMMON, *ORDER, *ASIDE_IMPORTS}:
            found.append(f"{path}: {subpackage} is not a subpackage of the design")
            continue
        if subpackage == "__main__":
            continue
        graph[module], annotations = set(), for_annotations(tree)
        for line, target, name in imports(tree, module, is_package, modules):
            if line in annotations and subpackage_of(target) == subpackage:
                continue
            what = import_breach(module, target, name)
            if what:
                found.append(f"{path}:{line}: {what}")
            if target in modules:
                graph[module].add(target)
        if subpackage in PURE:
            found += [f"{path}:{line}: calls {call}(), but {subpackage} is pure" for line, call in impure_calls(tree)]
    return found + ["circular import: " + " -> ".join(cycle) for cycle in cycles(graph)]


def module_name(path: str) -> str:
    parts = [PACKAGE, *path.removesuffix(".py").split("/")]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_package_keeps_to_the_order_of_its_subpackages():
    sources = {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in sorted(ROOT.rglob("*.py"))}
    assert {"_types.py", "_arithmetic.py", "geometry/__init__.py"} <= sources.keys()
    assert breaches(sources) == []


SOUND = {
    "__init__.py": "",
    "_types.py": "from numpy import ndarray\n",
    "_arithmetic.py": "from ._types import Array\n",
    "settings/__init__.py": "from ._settings import Setting\n",
    "settings/_settings.py": "from dataclasses import dataclass\nfrom annotated_types import Ge\n",
    "settings/filters.py": "from ._settings import Setting\n",
    "geometry/__init__.py": "from ._mesh import Mesh as Mesh\n",
    "geometry/_mesh.py": "from .._arithmetic import dot\n",
    "raster/__init__.py": "",
    "shadow/__init__.py": "from . import filters\n",
    "shadow/_bias.py": "from ..raster import draw\n",
    "shadow/filters/__init__.py": "from ._pcf import Pcf\n",
    "shadow/filters/_pcf.py": "from ...geometry import Mesh\nfrom ...settings.maps import A\nfrom .._bias import B\n",
    "fit/__init__.py": "",
    "metrics/__init__.py": "",
    "reference/__init__.py": "import numpy as np\nfrom ..geometry import Mesh\n",
    "io/__init__.py": "from pathlib import Path\nfrom .._types import Array\nopen('x')\n",
    "study/__init__.py": "from .. import io\nfrom ..reference import trace\nfrom ..fit import fit\n",
    "study/runs/__init__.py": "",
    "study/files/_run.py": "",
    "cli.py": "import diffshadow.study\nimport os\nprint(os.sep)\n",
}


@pytest.mark.parametrize(
    ("path", "text", "message"),
    [
        ("geometry/_mesh.py", "from ..raster import draw", "imports raster, which geometry must not import"),
        ("geometry/_mesh.py", "from .. import raster", "imports raster, which geometry must not import"),
        ("geometry/_mesh.py", "import diffshadow.raster", "imports raster, which geometry must not import"),
        ("geometry/_mesh.py", "def f():\n    from diffshadow.raster import draw", "which geometry must not import"),
        ("shadow/filters/_pcf.py", "from ...fit import fit", "imports fit, which shadow must not import"),
        ("raster/__init__.py", "from ..shadow import Bias", "imports shadow, which raster must not import"),
        ("raster/__init__.py", "from .. import draw", "imports diffshadow itself"),
        ("reference/__init__.py", "from ..raster import draw", "imports raster, which reference must not import"),
        ("reference/__init__.py", "from ..shadow import Bias", "imports shadow, which reference must not import"),
        ("metrics/__init__.py", "from ..geometry import Mesh", "imports geometry, which metrics must not import"),
        ("io/__init__.py", "from ..fit import fit", "imports fit, which io must not import"),
        ("fit/__init__.py", "from ..io import read", "imports io, which fit must not import"),
        ("_types.py", "from .geometry import Mesh", "imports geometry, which _types must not import"),
        ("raster/__init__.py", "from ..geometry._mesh import Mesh", "import from the public diffshadow.geometry"),
        ("raster/__init__.py", "from ..geometry import _mesh", "import from the public diffshadow.geometry"),
        ("study/__init__.py", "from ..shadow.filters import Pcf", "import from the public diffshadow.shadow"),
        ("raster/__init__.py", "from ..settings._settings import At", "import from the public diffshadow.settings"),
        ("settings/filters.py", "from ..geometry import Mesh", "imports geometry, which settings must not import"),
        ("settings/filters.py", "from .._types import Array", "imports _types, which settings must not import"),
        ("settings/filters.py", "import jax", "imports jax, but settings need nothing but the standard library"),
        ("fit/__init__.py", "import os.path", "imports os, but fit is pure"),
        ("shadow/_bias.py", "from matplotlib import pyplot", "imports matplotlib, but shadow is pure"),
        ("raster/__init__.py", "open('x')", "calls open(), but raster is pure"),
        ("raster/__init__.py", "import jax\njax.debug.print('x')", "calls print(), but raster is pure"),
        ("shadow/_bias.py", "from .filters import Pcf", "_pcf -> diffshadow.shadow._bias -> diffshadow.shadow.filters"),
        (
            "geometry/_mesh.py",
            "from . import Mesh",
            "circular import: diffshadow.geometry -> diffshadow.geometry._mesh",
        ),
        (
            "geometry/_mesh.py",
            "if TYPE_CHECKING:\n    from ..raster import draw",
            "imports raster, which geometry must not import",
        ),
        ("_types.py", "from ._arithmetic import dot", "circular import: diffshadow._arithmetic -> diffshadow._types"),
        ("study/files/_run.py", "from ..runs import draw", "imports runs, which comes after files in study"),
        ("helpers/__init__.py", "", "helpers is not a subpackage of the design"),
    ],
)
def test_a_planted_breach_is_found(path, text, message):
    assert breaches(SOUND) == []
    found = breaches({**SOUND, path: text})
    assert any(message in breach for breach in found), found


def test_an_import_for_annotations_is_free_within_its_subpackage():
    text = "if TYPE_CHECKING:\n    from . import Mesh"
    assert breaches({**SOUND, "geometry/_mesh.py": text}) == []
