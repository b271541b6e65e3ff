"""Mutants at random: cosmic-ray's operators at places drawn from the package's source."""

import ast
import random
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

Place = tuple[tuple[int, int], tuple[int, int]]
"""Line and column of where code begins and of where it ends; lines count from 1."""

# Arithmetic on arrays and logic of masks. Others, such as shifts of floats, fail wherever they are run.
_BINARY = ({"Add", "Sub", "Mul", "Div"}, {"BitAnd", "BitOr", "BitXor"}, {"FloorDiv", "Mod", "Div"})
_OTHERS = (
    *("AddNot", "NumberReplacer", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse"),
    *("ReplaceFalseWithTrue", "ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"),
)


class Mutant(NamedTuple):
    """A change that an operator makes at one place.

    `file`: below `diffshadow/`; `name`: the line, before and after; `source`: the whole file after it.
    """

    file: str
    name: str
    source: str

    def changed(self, before: str) -> str | None:
        """The file with the change, given the file without; none if it does not apply."""
        return self.source if self.source != before else None


def draw(package: Path, files: Sequence[Path], count: int, seed: int) -> Iterator[Mutant]:
    """`count` mutants of `files` at as many places, each drawn uniformly; all places if there are fewer.

    An operator of those that suit a place is drawn uniformly, too.
    """
    rng = random.Random(seed)
    sources = {file: file.read_text(encoding="utf-8") for file in sorted(files)}
    places = [(file, place, ways) for file, source in sources.items() for place, ways in _places(source)]
    drawn = (
        _mutant(package, file, sources[file], *rng.choice(ways)) for file, _, ways in rng.sample(places, len(places))
    )
    return islice(filter(None, drawn), count)


def _mutant(package: Path, file: Path, before: str, operator: str, occurrence: int) -> Mutant | None:
    """None where an operator takes a star for a product and leaves no Python."""
    after = _mutated(before, operator, occurrence)
    try:
        ast.parse(after)
    except SyntaxError:
        return None
    number, first, second = first_difference(before, after)
    return Mutant(str(file.relative_to(package)), f"line {number}: {first.strip()} -> {second.strip()}", after)


def _places(source: str) -> list[tuple[Place, list[tuple[str, int]]]]:
    """Where operators apply, and by which operator and as which of its occurrences."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator

    left_out, found = _left_out(source), defaultdict(list)
    nodes = list(ast_nodes(get_ast(source)))
    for name in _operators():
        operator, number = get_operator(name)(), 0
        for node in nodes:
            # The star of a signature is no product.
            is_star = node.parent is not None and node.parent.type in ("parameters", "param")
            for begin, end in operator.mutation_positions(node):
                if not is_star and not any(low <= begin < high for low, high in left_out):
                    found[begin, end].append((name, number))
                number += 1
    return sorted(found.items())


def _operators() -> list[str]:
    from cosmic_ray.plugins import operator_names

    def is_used(name: str) -> bool:
        kind, _, change = name.removeprefix("core/").partition("_")
        if kind == "ReplaceBinaryOperator":
            return any(set(change.split("_")) <= alike for alike in _BINARY)
        return kind in _OTHERS or (kind == "ReplaceComparisonOperator" and "Is" not in change)

    return [name for name in operator_names() if is_used(name)]


def _mutated(source: str, operator: str, occurrence: int) -> str:
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    return mutate_code(source, get_operator(operator)(), occurrence)


def _left_out(source: str) -> list[Place]:
    """Where a change could not be seen, or would be seen by any test: annotations, decorators, messages of errors and
    docstrings."""
    found = []
    for node in ast.walk(ast.parse(source)):
        parts = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        parts += getattr(node, "decorator_list", [])
        if isinstance(node, ast.Raise | ast.JoinedStr):
            parts.append(node)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Subscript):
            # Names of types.
            names = [getattr(target, "id", "").lstrip("_") for target in node.targets]
            parts += [node for name in names if name[:1].isupper() and not name.isupper()]
        found += [((part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)) for part in parts if part]
    return found


def first_difference(before: str, after: str) -> tuple[int, str, str]:
    """Number and texts of the first line that differs."""
    pairs = enumerate(zip(before.splitlines(), after.splitlines(), strict=False), start=1)
    return next((number, one, other) for number, (one, other) in pairs if one != other)
