"""Which everyday tests enter each line of the package, and how long they take: measured once for each state of a file.

pytest-cov tells the lines of each test. JAX runs a function's Python code once for all tests of a process, so that only
the first of them enters its lines.
"""

import ast
import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

PACKAGE = "diffshadow"
_OPTIONS = ("--dist", "no", "--maxfail", "0", "--cov", "--cov-context", "test", "--cov-report", "")


class Measured(NamedTuple):
    """What the tests of a file enter.

    - `seconds`: of each test that passes, by its identifier, in pytest's order.
    - `lines`: by file of the package or the tests and by line, places in `seconds` of the tests that enter it.
    - `arcs`: by file, pairs of lines that ran one after the other.
    """

    seconds: dict[str, float]
    lines: dict[str, dict[str, list[int]]]
    arcs: dict[str, list[tuple[int, int]]]


def tests_of(measured: Sequence[Measured], file: str, source: str, line: int, budget: float) -> dict[str, float]:
    """Which tests to run for a line of a file of the package, and the seconds of each.

    They are those that enter the line's statement; in modules that import JAX also the others of their files, which may
    use what the first of them traced. The cheapest are taken, in such modules from the cheapest files, and before
    others those in the folder that is named like the package's, until they take `budget` seconds; there is at least
    one. Those of a file stay together, cheap files first. What runs at import is entered by all tests that run code of
    the module, or else of its folder.
    """
    folder, is_traced, span = f"tests/{Path(file).parts[1]}/", "import jax" in source, _span(source, line)
    if span is not None:
        found = _entering(measured, lambda name, at: name == file and at in span, is_traced)
    else:
        beside = lambda name, at: Path(name).parent == Path(file).parent
        found = _entering(measured, lambda name, at: name == file, is_traced) or _entering(measured, beside, is_traced)
    tests = sorted(
        (not name.startswith(folder), sum(each.values()) if is_traced else 0, seconds, name)
        for each in found
        for name, seconds in each.items()
    )
    ends, spent = accumulate(test[2] for test in tests), Counter[str]()
    taken = {name: seconds for n, (*_, seconds, name) in enumerate(tests) if next(ends) <= budget or n == 0}
    file_of = lambda name: name.partition("::")[0]
    for name, seconds in taken.items():
        spent[file_of(name)] += seconds
    return {name: taken[name] for name in sorted(taken, key=lambda name: spent[file_of(name)])}


def _entering(
    measured: Sequence[Measured], enters: Callable[[str, int], bool], with_others: bool
) -> list[dict[str, float]]:
    """Of each file with tests that enter some lines, the seconds of those tests, or of all."""
    found = []
    for each in measured:
        lines = [tests for file, known in each.lines.items() for at, tests in known.items() if enters(file, int(at))]
        if entering := set().union(*lines):
            tests = enumerate(each.seconds.items())
            found.append({name: seconds for n, (name, seconds) in tests if with_others or n in entering})
    return found


def _span(source: str, line: int) -> range | None:
    """The lines of the innermost statement at a line, without statements within it; none for what runs at import."""
    found, is_called = range(line, line + 1), False
    # Outer nodes come first.
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", [])
        body = body if isinstance(body, list) else [body]
        if isinstance(node, ast.FunctionDef | ast.Lambda):
            is_called |= body[0].lineno <= line <= body[-1].end_lineno
        if isinstance(node, ast.stmt) and node.lineno <= line <= node.end_lineno:
            found = range(node.lineno, max(body[0].lineno, line + 1) if body else node.end_lineno + 1)
    return found if is_called else None


def measured(root: Path, cache: Path, run: Callable[..., dict[str, float]]) -> Iterator[Measured]:
    """What the everyday tests in `root` enter, a file of tests after the other.

    `run` runs pytest in `root` with some arguments and returns the seconds of each test that passes. Records in the
    folder `cache` serve again, until a file of tests or what its tests enter changes.
    """
    for file in sorted((root / "tests").rglob("test_*.py")):
        name = file.relative_to(root).as_posix()
        record = cache / f"{name}.json"
        digest, *found = json.loads(record.read_text()) if record.exists() else ("", {}, {}, {})
        if digest != _digest(root, [name, *found[1]]):
            print(f"which lines the tests in {name} enter", flush=True)
            found = _measured(root, run(*_OPTIONS, name))
            record.parent.mkdir(parents=True, exist_ok=True)
            record.write_text(json.dumps([_digest(root, [name, *found.lines]), *found]))
        yield Measured(*found)


def _digest(root: Path, names: Sequence[str]) -> str:
    """Of the contents of files."""
    contents = [path.read_bytes() for path in (root / name for name in sorted(names)) if path.exists()]
    return hashlib.sha256(b"".join(contents)).hexdigest()


def _measured(root: Path, seconds: dict[str, float]) -> Measured:
    from coverage import CoverageData

    data, places = CoverageData(str(root / ".coverage")), {name: n for n, name in enumerate(seconds)}
    data.read()
    lines = {}
    for file in data.measured_files():
        for line, contexts in data.contexts_by_lineno(file).items():
            # The phase of a test follows its name; what runs at import has no name.
            tests = {places[name] for name in (each.rpartition("|")[0] for each in contexts) if name in places}
            if tests:
                lines.setdefault(file, {})[str(line)] = sorted(tests)
    return Measured(seconds, lines, {file: data.arcs(file) or [] for file in data.measured_files()})


def print_missing(measured: Sequence[Measured], paths: Sequence[str]) -> None:
    """Prints the lines and branches of files and folders that no everyday test enters."""
    from coverage import Coverage

    report = Coverage(data_file=None)
    for each in measured:
        report.get_data().add_arcs(each.arcs)
    include = [path if path.endswith(".py") else f"{path.rstrip('/')}/*" for path in paths]
    report.report(include=include, show_missing=True, skip_covered=True)
