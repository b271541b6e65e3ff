"""Scripts that drive a headless Chromium."""

import shutil
import subprocess
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
ENGINES = TESTS.parent / "experiments" / "engines"
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


def in_browser(script, *arguments, packages=("playwright-core",)):
    """What a script of this folder prints, given the folder of its packages, the browser and more arguments.

    The test is skipped where something is missing.
    """
    browser = next((found for name in _BROWSERS if (found := shutil.which(name))), None)
    there = {name: (ENGINES / "node_modules" / name).is_dir() for name in packages}
    lacking = [
        name for name, found in {"node": shutil.which("node"), "chromium": browser, **there}.items() if not found
    ]
    if lacking:
        pytest.skip(
            f"needs {', '.join(lacking)}: `apt-get install nodejs npm chromium` and "
            f"`npm install --no-package-lock --prefix {ENGINES}`"
        )
    command = ["node", str(TESTS / script), str(ENGINES), str(browser), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
