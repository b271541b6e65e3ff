"""Which everyday tests enter each line of the package, and how long they take: measured once for each state of a file.

pytest-cov tells the lines of each test. JAX runs a function's Python code once for all tests of a process, so that only
the first of them enters its lines: the others of its file are taken after it.
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
    """The tests that enter the statement at a line of a file of the package, and then the others of their files: the
    seconds of each.

    The cheapest tests are taken, from the folder that is named like the package's first, until they take `budget`
    seconds; there is at least one. Those of a file of tests stay together, cheap files first. What runs at import is
    entered by all tests that run code of the module, or else of its folder.
    """
    if (span := _span(source, line)) is not None:
        entering = _entering(measured, lambda name, at: name == file and at in span)
    else:
        beside = lambda name, at: Path(name).parent == Path(file).parent
        entering = _entering(measured, lambda name, at: name == file) or _entering(measured, beside)
    folder = f"tests/{Path(file).parts[1]}/"
    entering.sort(key=lambda test: (test.only_beside, not test.name.startswith(folder), test.seconds))
    ends = accumulate(test.seconds for test in entering)
    taken = [test for n, (test, end) in enumerate(zip(entering, ends, strict=True)) if end <= budget or n == 0]
    costs = Counter[str]()
    for test in taken:
        costs[test.file] += test.seconds
    return {test.name: test.seconds for test in sorted(taken, key=lambda test: costs[test.file])}


class _Test(NamedTuple):
    """A test, with whether only others of its file enter the lines."""

    name: str
    seconds: float
    only_beside: bool

    @property
    def file(self) -> str:
        return self.name.partition("::")[0]


def _entering(measured: Sequence[Measured], enters: Callable[[str, int], bool]) -> list[_Test]:
    """All tests of the files whose tests enter some lines."""
    found = []
    for each in measured:
        lines = [tests for file, known in each.lines.items() for at, tests in known.items() if enters(file, int(at))]
        if entering := set().union(*lines):
            tests = enumerate(each.seconds.items())
            found += [_Test(name, seconds, n not in entering) for n, (name, seconds) in tests]
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
