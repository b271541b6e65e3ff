"""Each notebook runs at small settings, and what is kept of it is whole, small, and of no one machine."""

import getpass
import importlib.util
import json
import os
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import jupytext
import nbformat
import pytest
from jupyter_client.manager import KernelManager

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
MAX_BYTES = 600_000
# Names that other words contain, or that a container gives everybody.
_COMMON_NAMES = {"root", "user", "localhost"}


def execute() -> ModuleType:
    """The script that executes notebooks, which is no part of a package."""
    spec = importlib.util.spec_from_file_location("execute", ROOT / "notebooks" / "execute.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def kernel(tmp_path_factory) -> Iterator[KernelManager]:
    """One kernel for all notebooks, at small settings: what one has compiled, the others need not."""
    cache = str(tmp_path_factory.mktemp("cache"))
    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(env={**os.environ, "DIFFSHADOW_SMALL": "1", "DIFFSHADOW_CACHE": cache}, cwd=ROOT / "notebooks")
    yield manager
    manager.shutdown_kernel(now=True)


@pytest.mark.exhaustive
# What the client of a kernel says of its own workings.
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_at_small_settings(path, kernel):
    found = execute().executed(path.with_suffix(".py"), kernel)
    assert any("image/png" in output.get("data", {}) for output in outputs(found))
    assert not [output.text for output in outputs(found) if output.get("name") == "stderr"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_and_its_text_hold_the_same_cells(path):
    cells = lambda notebook: [(cell.cell_type, cell.source, cell.metadata.get("tags")) for cell in notebook.cells]
    kept = nbformat.read(path, as_version=4)
    nbformat.validate(kept)
    assert cells(kept) == cells(jupytext.read(path.with_suffix(".py"), fmt="py:percent"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_kept_with_its_outputs(path):
    kept = nbformat.read(path, as_version=4)
    counts = [cell.execution_count for cell in kept.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1)), "executed from top to bottom, once"
    assert any("image/png" in output.get("data", {}) for output in outputs(kept))
    assert not [output for output in outputs(kept) if output.output_type == "error" or output.get("name") == "stderr"]
    assert path.stat().st_size < MAX_BYTES


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_imports_fold_and_one_picture_leads(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    tagged = lambda tag: [number for number, cell in enumerate(cells) if tag in cell.metadata.get("tags", ())]
    assert tagged("hide-input") == [number for number, cell in enumerate(cells) if "\nimport " in cell.source] == [0]
    (chosen,) = tagged("picture")
    assert any("image/png" in output.get("data", {}) for output in cells[chosen].outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_name_no_machine(path):
    kept = nbformat.read(path, as_version=4)
    assert not machine_words(json.dumps([without_pictures(output) for output in outputs(kept)]))
    assert not [cell.metadata for cell in kept.cells if cell.metadata.keys() - {"tags"}], "times, for one"


def test_words_of_a_machine_are_found():
    assert machine_words(f"written to {ROOT}/runs"), "wherever the project happens to lie"
    assert machine_words("/home/somebody/.cache/jax")
    assert machine_words(r"C:\Users\somebody")
    assert not machine_words("../configs/quickstart.yaml in 3 / 4 of all cases")


def machine_words(text: str) -> list[str]:
    """What in `text` names a place on a machine, its user or its host."""
    names = {name for name in (getpass.getuser(), socket.gethostname()) if len(name) > 2} - _COMMON_NAMES
    places = r"(?<![\w.])/(?:home|root|tmp|work|Users|usr|opt|var|mnt|etc|private)/\S+|[A-Z]:\\+\w+"
    places = rf"{re.escape(str(ROOT))}|{places}"
    return re.findall(places, text) + [name for name in sorted(names) if re.search(rf"\b{re.escape(name)}\b", text)]


def outputs(notebook: Any) -> list[Any]:
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def without_pictures(output: Any) -> Any:
    """An output without the letters and digits that encode its pictures."""
    kept = {kind: value for kind, value in output.get("data", {}).items() if not kind.startswith("image/")}
    return nbformat.from_dict({**output, "data": kept})
