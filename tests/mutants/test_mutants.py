"""The mistakes still suit the source, and their runner finds them."""

import ast
import shutil
import subprocess
from pathlib import Path

import draw
import entered
import examine
import kept
import pytest

PACKAGE = examine.ROOT / examine.PACKAGE


def test_each_kept_mistake_changes_one_place_and_leaves_python():
    for mistake in kept.KEPT:
        before = (PACKAGE / mistake.file).read_text(encoding="utf-8")
        after = mistake.changed(before)
        assert after not in (None, before), mistake
        ast.parse(after, mistake.file)


def test_each_kept_mistake_has_a_name_of_its_own():
    assert len({mistake.name for mistake in kept.KEPT}) == len(kept.KEPT)


def test_a_kept_mistake_lies_in_its_function_alone():
    source = "def one():\n    return 1 + 1\n\n\nclass Two:\n    def one(self):\n        return 1 + 1\n"
    of = lambda function: kept.Kept("file.py", "less", function, "1 + 1", "1 - 1").changed(source)
    assert of("one") == source.replace("1 + 1", "1 - 1", 1)
    assert of("Two.one") == "1 - 1".join(source.rsplit("1 + 1", 1))
    assert of("Two.three") is None


def test_mutants_are_drawn_where_code_computes(tmp_path):
    pytest.importorskip("cosmic_ray", reason="make mutants installs cosmic-ray")
    package = tmp_path / "diffshadow"
    package.mkdir()
    source = (
        "Number = dict[str, int | None]\n\n\n@cache(1 + 1)\ndef half(x: int | None) -> int | None:\n"
        '    """1 + 1."""\n    if x is None:\n        raise ValueError(f"{1 + 1}")\n    return x / 2\n'
        "\n\ndef third(x, *, y):\n    return [*x, y]\n"
    )
    (package / "half.py").write_text(source)
    found = list(draw.draw(package, [package / "half.py"], 100, 3))
    # The condition, the division and its number.
    assert sorted({each.name.partition(":")[0] for each in found}) == ["line 7", "line 9"]
    assert len(found) == 3
    assert [each.name for each in draw.draw(package, [package / "half.py"], 100, 3)] == [each.name for each in found]


SOURCE = """LIMIT = 3


def half(x):
    if x > LIMIT:
        return [
            x / 2
        ]
    return x


def twice(x=LIMIT):
    return 2 * x
"""
A, B = "tests/test_a.py::", "tests/test_b.py::"
MEASURED = [
    entered.Measured(
        {f"{A}long": 9.0, f"{A}short": 2.0, f"{A}other": 1.0},
        {"diffshadow/half.py": {"5": [0, 1], "6": [0, 1], "9": [0], "13": [2]}},
        {},
    ),
    entered.Measured({f"{B}one": 4.0}, {"diffshadow/half.py": {"5": [0]}, "diffshadow/odd.py": {"2": [0]}}, {}),
]


def test_tests_are_chosen_by_the_statement_that_they_enter():
    def of(line, budget=60, file="half", source=SOURCE):
        return list(entered.tests_of(MEASURED, f"diffshadow/{file}.py", source, line, budget))

    # Cheap files first, and in them cheap tests.
    assert of(5) == [f"{B}one", f"{A}short", f"{A}long"]
    assert of(5, 6) == [f"{A}short", f"{B}one"]
    assert of(5, 1) == [f"{A}short"]
    # A line within a statement is the statement's.
    assert of(7) == [f"{A}short", f"{A}long"]
    assert of(13) == [f"{A}other"]
    # Import runs constants and defaults.
    assert of(1) == of(12) == [f"{B}one", f"{A}other", f"{A}short", f"{A}long"]
    assert of(1, file="new") == of(1)
    assert of(5, file="new") == []
    # Other tests of a file may use what JAX traced.
    assert of(13, source=f"{SOURCE}\n\nimport jax") == [f"{A}other", f"{A}short", f"{A}long"]
    assert of(5, 8, source=f"{SOURCE}\n\nimport jax") == [f"{A}other", f"{A}short", f"{B}one"]


def _repository(folder: Path) -> Path:
    """A repository of two functions and a test of one."""
    package, tests = folder / examine.PACKAGE, folder / "tests" / "of_sums"
    package.mkdir(parents=True)
    tests.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "sums.py").write_text(
        "def plus(a, b):\n    return a + b  # never less\n\n\ndef times(a, b):\n    return a * b\n"
    )
    (tests / "test_sums.py").write_text(
        f"from {examine.PACKAGE}.sums import plus\n\n\ndef test_sums():\n    assert plus(1, 2) == 3\n"
    )
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True)
    return folder


KNOWN = [entered.Measured({"tests/of_sums/test_sums.py::test_sums": 0.1}, {"diffshadow/sums.py": {"2": [0]}}, {})]


@pytest.fixture
def copy(tmp_path, monkeypatch):
    monkeypatch.setattr(examine, "LIBRARIES", ("pytest",))
    made = examine.Copy(_repository(tmp_path / "repository"), tmp_path / "copy")
    made.check_import()
    yield made
    made.close()


def test_a_planted_mistake_is_found_and_the_source_put_back(copy):
    of = lambda old, new: kept.Kept("sums.py", "planted", "plus", old, new)
    judged = lambda mistake: copy.examine(mistake, KNOWN, 60, whole=False)
    found = judged(of("a + b", "a - b"))
    assert (found.verdict, found.what) == (examine.CAUGHT, "tests/of_sums/test_sums.py::test_sums")
    assert judged(of("never less", "ever more")).verdict == examine.MISSED
    assert judged(of("nowhere", "")).verdict == examine.NOT_THERE
    assert (copy.root / examine.PACKAGE / "sums.py").read_text().count("a + b") == 1


def test_what_tests_enter_is_measured_once(copy, tmp_path, capsys, monkeypatch):
    pytest.importorskip("pytest_cov", reason="make mutants installs pytest-cov")
    shutil.copy(examine.ROOT / "pyproject.toml", copy.root)
    for is_first in (True, False):
        (found,) = entered.measured(copy.root, tmp_path / "cache", copy.seconds)
        assert list(found.seconds) == list(KNOWN[0].seconds)
        assert found.lines["diffshadow/sums.py"] == {"2": [0]}
        assert ("test_sums.py" in capsys.readouterr().out) == is_first
    monkeypatch.chdir(copy.root)
    entered.print_missing([found], ["diffshadow"])
    assert [line.split()[-1] for line in capsys.readouterr().out.splitlines() if "sums.py" in line] == ["6"]


def test_a_copy_that_imports_another_package_is_refused(tmp_path):
    folder = _repository(tmp_path / "repository")
    (folder / examine.PACKAGE / "__init__.py").unlink()
    (folder / examine.PACKAGE / "sums.py").unlink()
    copy = examine.Copy(folder, tmp_path / "copy")
    with pytest.raises(RuntimeError, match="expected the package that lies there"):
        copy.check_import()
