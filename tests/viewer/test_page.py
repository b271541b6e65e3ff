"""The page in a browser: what one sees and does there."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from viewed import TINY

from diffshadow.config import parse_config

ROOT = Path(__file__).parent.parent.parent
ENGINES = ROOT / "experiments" / "engines"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SECONDS = 60

pytestmark = [pytest.mark.browser, pytest.mark.exhaustive]


@pytest.fixture
def browser():
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    has = all((ENGINES / "node_modules" / name).is_dir() for name in ("playwright-core", "axe-core"))
    if found is None or not has or shutil.which("node") is None:
        pytest.skip("Chromium, node, playwright-core or axe-core is missing; see experiments/engines")
    return found


@pytest.fixture
def started(tmp_path):
    """The command, and its address."""
    (tmp_path / "tiny.yaml").write_text(TINY.replace("[32, 48]", "[96, 144]").replace("[64, 64]", "[256, 256]"))
    command = [sys.executable, "-m", "diffshadow", "view", "tiny.yaml", "--no-browser"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
    address = process.stdout.readline().strip()
    assert address.startswith("http://127.0.0.1:")
    yield process, address
    process.kill()
    process.wait()
    process.stdout.close()


def test_a_person_finds_acne_turns_the_light_fits_and_keeps_what_was_found(browser, started):
    process, address = started
    drive = ["node", str(Path(__file__).parent / "drive_page.mjs"), str(ENGINES), browser, address]
    done = subprocess.run(drive, capture_output=True, text=True, check=False, timeout=400)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert seen["errors"] == []
    assert seen["lasting"] == ""
    assert all(each.startswith((address, "ws://127.0.0.1", "blob:", "data:")) for each in seen["requests"])
    # Acne darkens the picture, and a bias removes it.
    assert seen["acne"]["mean"] < seen["biased"]["mean"] - 5
    # The shadow follows the light, and comes back.
    assert abs(seen["turned"]["across"] - seen["biased"]["across"]) > 0.05
    assert seen["undone"]["across"] == pytest.approx(seen["biased"]["across"], abs=0.01)
    assert abs(seen["orbited"]["mean"] - seen["undone"]["mean"]) > 0.2
    assert seen["keyed"] > 2
    assert "reduced" in seen["fit"]
    assert seen["curve"]
    assert parse_config(seen["saved"]).bias.constant == pytest.approx(seen["fitted"], rel=1e-5)
    assert f"bias.constant={seen['fitted']:.3f}"[:18] in seen["command"]
    assert seen["shared"] == pytest.approx(seen["fitted"], rel=1e-5)
    assert seen["widths"] == [0, 0, 0]
    assert seen["violations"] == []
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert process.wait(SECONDS) == 0
    assert time.monotonic() - began < SECONDS / 2
