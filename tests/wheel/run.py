"""Installs a wheel into a bare environment outside of the clone, and runs README's example and a fit there.

    python tests/wheel/run.py dist/diffshadow-*.whl

The environment has the pinned packages that the wheel asks for, and no others.
"""

import os
import re
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXAMPLE = re.compile(r"```python\n(.*?)```", re.DOTALL)
FIT = ("scene.camera.resolution=[64, 64]", "shadow_map.resolution=[128, 128]", "reference.samples=4")
_HERE = "import diffshadow, sys; sys.exit(not diffshadow.__file__.startswith(sys.prefix))"


def main(wheel: Path) -> None:
    """Installs `wheel` and runs what a user would; a command that fails ends the process with its status."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        venv.create(folder / "venv", with_pip=True)
        programs = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        pip = (str(programs / "python"), "-m", "pip", "--disable-pip-version-check")
        pins = ("--constraint", str(ROOT / "constraints.txt"))
        run(folder, *pip, "install", "--quiet", "--only-binary", ":all:", *pins, str(wheel))
        run(folder, *pip, "check")
        run(folder, str(programs / "python"), "-c", _HERE)
        found = EXAMPLE.search((ROOT / "README.md").read_text(encoding="utf-8"))
        if found is None:
            sys.exit("README.md has no example in Python")
        (folder / "example.py").write_text(found[1], encoding="utf-8")
        run(folder, str(programs / "python"), "example.py")
        run(folder, str(programs / "diffshadow"), "fit", "builtin:quickstart", *FIT)
        if not (folder / "runs" / "quickstart" / "report.html").is_file():
            sys.exit("diffshadow fit wrote no report")


def run(folder: Path, *command: str) -> None:
    """Runs `command` in `folder`, where nothing of the clone is found."""
    print("$", *command, flush=True)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(command, cwd=folder, env=environment, check=False)
    if done.returncode:
        sys.exit(done.returncode)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("expected one wheel, such as dist/diffshadow-1.0-py3-none-any.whl; `make dist` builds it")
    main(Path(sys.argv[1]).resolve())
