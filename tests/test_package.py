"""The files that the package consists of, as it is published."""

import inspect
import re
import tomllib
import zipfile
from collections import Counter
from importlib import import_module
from pathlib import Path
from types import ModuleType

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


def public_names() -> dict[str, object]:
    """Each public name, by its path, with what it stands for."""
    found: dict[str, object] = {}
    for name in ("", *(f".{part}" for part in (*diffshadow._SUBPACKAGES, "settings"))):
        module = import_module(f"diffshadow{name}")
        assert dir(module) == sorted(module.__all__), name
        found |= {f"{module.__name__}.{each}": getattr(module, each) for each in module.__all__}
    return {name: value for name, value in found.items() if not isinstance(value, ModuleType)}


def test_public_names_are_few_documented_and_each_has_one_path():
    names = public_names()
    assert len(names) < 300
    own = {name: value for name, value in names.items() if getattr(value, "__module__", "").startswith("diffshadow")}
    described = {name: value for name, value in own.items() if inspect.isclass(value) or inspect.isfunction(value)}
    assert [name for name, value in described.items() if not (value.__doc__ or "").strip()] == []
    assert [value for value, count in Counter(map(id, described.values())).items() if count > 1] == []
