"""The files that the package consists of, as it is published."""

import re
import tomllib
import zipfile
from pathlib import Path

from hatchling.builders.wheel import WheelBuilder

import diffshadow

ROOT = Path(__file__).parent.parent


def test_wheel_has_the_mark_of_typed_packages_and_all_that_is_no_python(tmp_path):
    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    packed = set(zipfile.ZipFile(wheel).namelist())
    others = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "diffshadow").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert "diffshadow/py.typed" in packed
    assert others <= packed


def test_citation_names_the_version_of_the_package():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert diffshadow.__version__ == version
    assert re.search(rf"^version: {re.escape(version)}$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
