"""The mistakes still suit the source, and their runner finds them."""

import ast
import subprocess
from pathlib import Path

import draw
import examine
import kept
import pytest

PACKAGE, TESTS = examine.ROOT / examine.PACKAGE, examine.ROOT / "tests"


def test_each_kept_mistake_changes_one_place_and_leaves_python():
    for mistake in kept.KEPT:
        before = (PACKAGE / mistake.file).read_text(encoding="utf-8")
        after = mistake.changed(before)
        assert after not in (None, before), mistake
        ast.parse(after, mistake.file)


def test_each_kept_mistake_has_a_name_of_its_own_and_tests_that_there_are():
    assert len({mistake.name for mistake in kept.KEPT}) == len(kept.KEPT)
    there = {path.name for path in TESTS.rglob("test_*.py")}
    for mistake in kept.KEPT:
        assert mistake.tests, mistake
        assert set(mistake.tests) <= there, mistake


def test_a_kept_mistake_lies_in_its_function_alone():
    source = "def one():\n    return 1 + 1\n\n\nclass Two:\n    def one(self):\n        return 1 + 1\n"
    of = lambda function: kept.Kept("file.py", "less", function, "1 + 1", "1 - 1", ()).changed(source)
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
    )
    (package / "half.py").write_text(source)
    found = list(draw.draw(package, [package / "half.py"], 100, 3))
    # The condition, the division and its number.
    assert sorted({each.name.partition(":")[0] for each in found}) == ["line 7", "line 9"]
    assert len(found) == 3
    assert [each.name for each in draw.draw(package, [package / "half.py"], 100, 3)] == [each.name for each in found]


def _repository(folder: Path) -> Path:
    """A repository of one function and its one test."""
    package, tests = folder / examine.PACKAGE, folder / "tests" / "of_sums"
    package.mkdir(parents=True)
    tests.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "sums.py").write_text("def plus(a, b):\n    return a + b  # never less\n")
    (tests / "test_sums.py").write_text(
        f"from {examine.PACKAGE}.sums import plus\n\n\ndef test_sums():\n    assert plus(1, 2) == 3\n"
    )
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True)
    return folder


def test_a_planted_mistake_is_found_and_the_source_put_back(tmp_path, request, monkeypatch):
    copy = examine.Copy(_repository(tmp_path / "repository"), tmp_path / "copy")
    copy.check_import()
    of = lambda old, new: kept.Kept("sums.py", "planted", "plus", old, new, ("test_sums.py",))
    judged = lambda mistake: copy.examine(mistake, "not exhaustive", whole=False)
    request.addfinalizer(copy.close)
    monkeypatch.setattr(examine, "LIBRARIES", ("pytest",))
    found = judged(of("a + b", "a - b"))
    assert (found.verdict, found.what) == (examine.CAUGHT, "tests/of_sums/test_sums.py::test_sums")
    assert judged(of("never less", "ever more")).verdict == examine.MISSED
    assert judged(of("nowhere", "")).verdict == examine.NOT_THERE
    assert copy.failing([found.what]) == set()
    assert (copy.root / examine.PACKAGE / "sums.py").read_text().count("a + b") == 1


def test_a_copy_that_imports_another_package_is_refused(tmp_path):
    folder = _repository(tmp_path / "repository")
    (folder / examine.PACKAGE / "__init__.py").unlink()
    (folder / examine.PACKAGE / "sums.py").unlink()
    copy = examine.Copy(folder, tmp_path / "copy")
    with pytest.raises(RuntimeError, match="expected the package that lies there"):
        copy.check_import()
