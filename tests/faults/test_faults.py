"""The mistakes still suit the source, and their runner finds them."""

import ast
import importlib.util
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml
from faults import FAULTS, Fault


def _runner() -> Any:
    # By its path, for there is another run.py among the tests.
    spec = importlib.util.spec_from_file_location("run_faults", Path(__file__).with_name("run.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


run = _runner()
PACKAGE, TESTS = run.ROOT / run.PACKAGE, run.ROOT / "tests"


def test_each_fault_changes_one_place_and_leaves_python():
    for fault in FAULTS:
        source = (PACKAGE / fault.file).read_text(encoding="utf-8")
        assert source.count(fault.old) == 1, fault
        assert fault.new != fault.old, fault
        ast.parse(source.replace(fault.old, fault.new), fault.file)


def test_each_fault_has_a_name_of_its_own_and_tests_that_there_are():
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
    there = {path.name for path in TESTS.rglob("test_*.py")}
    for fault in FAULTS:
        assert fault.tests, fault
        assert set(fault.tests) <= there, fault


def test_each_fault_stands_in_the_file_of_its_subpackage():
    for listed in Path(__file__).parent.glob("*.yaml"):
        files = yaml.safe_load(listed.read_text(encoding="utf-8"))
        assert {file.partition("/")[0].removesuffix(".py").lstrip("_") for file in files} == {listed.stem}


def test_every_subpackage_has_faults_that_its_tests_must_see():
    assert len(FAULTS) >= 100
    subpackages = {folder.name for folder in PACKAGE.iterdir() if any(folder.glob("*.py"))} | {"_arithmetic"}
    counts = Counter(fault.subpackage for fault in FAULTS)
    # Too short for as many.
    assert counts.pop("console") >= 2
    assert counts.pop("_padding") >= 2
    # Facts, whose readers the tests compare with one another.
    subpackages.remove("settings")
    assert counts.keys() == subpackages
    assert min(counts.values()) >= 6


def _repository(folder: Path) -> Path:
    """A repository of one function and its one test."""
    package, tests = folder / run.PACKAGE, folder / "tests" / "of_sums"
    package.mkdir(parents=True)
    tests.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "sums.py").write_text("def plus(a, b):\n    return a + b  # never less\n")
    (tests / "test_sums.py").write_text(
        f"from {run.PACKAGE}.sums import plus\n\n\ndef test_sums():\n    assert plus(1, 2) == 3\n"
    )
    subprocess.run(["git", "init", "--quiet", str(folder)], check=True)
    return folder


def test_a_planted_fault_is_found_and_the_source_put_back(tmp_path, request, monkeypatch):
    copy = run.Copy(_repository(tmp_path / "repository"), tmp_path / "copy")
    copy.check_import()
    of = lambda old, new: Fault("planted", "sums.py", old, new, ("test_sums.py",))
    judged = lambda fault: copy.examine(fault, "not exhaustive", whole=False)
    request.addfinalizer(copy.close)
    monkeypatch.setattr(run, "LIBRARIES", ("pytest",))
    found = judged(of("a + b", "a - b"))
    assert (found.verdict, found.what) == (run.CAUGHT, "tests/of_sums/test_sums.py::test_sums")
    assert judged(of("never less", "ever more")).verdict == run.MISSED
    assert judged(of("nowhere", "")).verdict == run.NOT_THERE
    assert copy.failing([found.what]) == set()
    assert (copy.root / run.PACKAGE / "sums.py").read_text().count("a + b") == 1


def test_a_copy_that_imports_another_package_is_refused(tmp_path):
    folder = _repository(tmp_path / "repository")
    (folder / run.PACKAGE / "__init__.py").unlink()
    (folder / run.PACKAGE / "sums.py").unlink()
    copy = run.Copy(folder, tmp_path / "copy")
    with pytest.raises(RuntimeError, match="expected the package that lies there"):
        copy.check_import()
