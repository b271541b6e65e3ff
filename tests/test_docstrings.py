"""The examples in docstrings run, and their values are what their comments say."""

import ast
import re
import textwrap
from pathlib import Path
from typing import Any

import pytest
from scenes import staying_in

import diffshadow

SUBPACKAGES = ("config", "fit", "geometry", "io", "metrics", "raster", "reference", "shading", "shadow", "study")
PACKAGE = Path(__file__).parent.parent / "diffshadow"
BLOCK = re.compile(r"^!!! Example\n(?:\n|    .*\n?)*?    ```python\n((?:\n|    .*\n)*?)    ```$", re.MULTILINE)
# A comment with such a value is what the expression before it has as its text.
VALUE = re.compile(r"# ([\[(\d'].*|True)$")
# What draws or traces compiles.
DRAWS = re.compile(r"\b(?:state|surface|visibility|truth|prepare|draw_\w+|trace_\w+)\b")
_SHARED: dict[str, Any] = {}


def examples() -> dict[str, str]:
    """The code of each example, by the name of the class or function that it shows."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if "!!! Example" not in text:
            continue
        tree = ast.parse(text)
        for node in (tree, *tree.body):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (doc := ast.get_docstring(node)):
                blocks = BLOCK.findall(doc)
                assert len(blocks) == doc.count("!!! Example"), f"{path}: an example that is not read"
                if blocks:
                    found[getattr(node, "name", "diffshadow")] = textwrap.dedent(blocks[0])
    return found


EXAMPLES = examples()
NAMES = [name for name in EXAMPLES if name != "diffshadow"]


def run(code: str, names: dict[str, Any]) -> int:
    """Runs `code`, and compares expressions with the values in the comments after them; how many there were."""
    lines, compared = code.splitlines(), 0
    for node in ast.parse(code).body:
        if not isinstance(node, ast.Expr):
            exec(compile(ast.Module([node], []), "example", "exec"), names)
            continue
        value = eval(compile(ast.Expression(node.value), "example", "eval"), names)
        if comment := VALUE.search(lines[node.end_lineno - 1]):
            assert str(value) == comment[1], lines[node.end_lineno - 1]
            compared += 1
    return compared


def shared(code: str) -> dict[str, Any]:
    """The names of the package's own example, up to the last that `code` uses. Each statement runs once."""
    statements = ast.parse(EXAMPLES["diffshadow"]).body
    used = {node.id for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)}
    imports = sum(isinstance(each, ast.Import | ast.ImportFrom) for each in statements)
    last = max((k for k, each in enumerate(statements) if stored(each) & used), default=imports - 1)
    for k, statement in enumerate(statements[: last + 1]):
        if isinstance(statement, ast.Import | ast.ImportFrom) or not stored(statement) <= _SHARED.keys():
            exec(compile(ast.Module([statement], []), f"line {k}", "exec"), _SHARED)
    return dict(_SHARED)


def stored(statement: ast.stmt) -> set[str]:
    return {each.id for each in ast.walk(statement) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)}


def marked(name: str) -> Any:
    return pytest.param(name, marks=pytest.mark.exhaustive) if DRAWS.search(EXAMPLES[name]) else name


@pytest.mark.parametrize("name", [marked(name) for name in NAMES])
def test_example_runs(name, tmp_path):
    with staying_in(tmp_path):
        run(EXAMPLES[name], shared(EXAMPLES[name]))


@pytest.mark.parametrize("name", EXAMPLES)
def test_names_in_an_example_exist(name):
    for node in ast.walk(ast.parse(EXAMPLES[name])):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in SUBPACKAGES:
            getattr(getattr(diffshadow, node.value.id), node.attr)


def test_examples_are_short_and_many():
    assert len(NAMES) >= 30
    assert not [name for name in NAMES if len(EXAMPLES[name].splitlines()) > 10]


def test_wrong_values_in_comments_are_found():
    assert run("n = 3\n(n, 2 * n)  # (3, 6)\nn  # a number", {}) == 1
    with pytest.raises(AssertionError):
        run("3 + 3  # 7", {})
