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


def test_version_is_stated_once():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert diffshadow.__version__ == version
    again = re.compile(rf"(?<![\d.]){re.escape(version)}(?![\d.])|^ *version *[:=]", re.MULTILINE)
    for name in ("CITATION.cff", "README.md", "mkdocs.yml", "diffshadow/__init__.py"):
        assert not again.search((ROOT / name).read_text(encoding="utf-8")), name
