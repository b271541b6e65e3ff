"""What type checkers see of the package."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent / "typing" / "user_script.py"
REVEALED = [
    "dict[str, float]",
    "numpy.ndarray[",
    "jax._src.basearray.Array",
    "diffshadow.shadow.biases._abstract.AbstractBias",
    "jax._src.basearray.Array",
]


@pytest.mark.skipif(not importlib.util.find_spec("mypy"), reason="mypy is no dependency")
def test_mypy_sees_the_types_of_a_users_script(tmp_path):
    check_types([sys.executable, "-m", "mypy"], tmp_path)


def check_types(mypy: list[str], folder: Path) -> None:
    """Runs `mypy`, a command, on the script, and asserts that it finds what types there are, and no mistake."""
    command = [*mypy, "--strict", "--python-executable", sys.executable, "--cache-dir", str(folder), SCRIPT.name]
    # Where the package is found as an installed one, so that its own files are not judged.
    packages = {**os.environ, "MYPYPATH": ""}
    ran = subprocess.run(command, cwd=SCRIPT.parent, env=packages, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    revealed = [line.split('"')[1] for line in ran.stdout.splitlines() if "Revealed type" in line]
    assert len(revealed) == len(REVEALED), ran.stdout
    for found, expected in zip(revealed, REVEALED, strict=True):
        assert found.startswith(expected)
