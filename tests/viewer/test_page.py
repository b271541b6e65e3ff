"""The page in a browser: what one sees and does there."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from viewed import TINY

import diffshadow
from diffshadow.config import parse_config

ROOT = Path(__file__).parent.parent.parent
ENGINES = ROOT / "experiments" / "engines"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SECONDS = 60
LARGER = TINY.replace("[32, 48]", "[96, 144]").replace("[64, 64]", "[256, 256]")

pytestmark = [pytest.mark.browser, pytest.mark.exhaustive]


@pytest.fixture
def browser():
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    has = all((ENGINES / "node_modules" / name).is_dir() for name in ("playwright-core", "axe-core"))
    if found is None or not has or shutil.which("node") is None:
        pytest.skip("Chromium, node, playwright-core or axe-core is missing; see experiments/engines")
    return found


@pytest.fixture
def start(tmp_path):
    """Starts the command, and gives its process and its address."""
    processes = []

    def started(*arguments):
        command = [sys.executable, "-m", "diffshadow", "view", *arguments, "--no-browser"]
        # Without references from before.
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "DIFFSHADOW_CACHE": str(tmp_path / "cache")}
        process = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
        processes.append(process)
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:")
        return process, address

    yield started
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def driven(browser, script, *addresses, at_rest=lambda: None):
    """What a script of `drive_page.mjs` sees; `at_rest` is called when it says so."""
    drive = ["node", str(Path(__file__).parent / "drive_page.mjs"), str(ENGINES), browser, script, *addresses]
    with subprocess.Popen(drive, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        said = process.stderr.readline()
        if said == "rest\n":
            at_rest()
            said = ""
        out, more = process.communicate(timeout=400)
    assert process.returncode == 0, said + more
    seen = json.loads(out)
    assert seen["errors"] == []
    return seen


def cpu_seconds(process):
    """CPU time of all threads of a process, in seconds."""
    user, system = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_all_rays_come_at_rest_and_nothing_is_done_afterwards(browser, start):
    """The template as users get it, of 512 × 512 pixels."""
    process, address = start("builtin:quickstart")
    spent = []

    def at_rest():
        before = cpu_seconds(process)
        time.sleep(3)
        spent.append(cpu_seconds(process) - before)

    seen = driven(browser, "rest", address, at_rest=at_rest)
    rays = [int(each.split()[-4]) for each in seen["figures"] if "against" in each]
    # Each once; a busy browser may leave one out.
    assert rays == sorted(set(rays))
    assert rays[-1] == 64
    assert set(rays) <= {4, 16, 64}
    assert seen["quiet"] == 0
    assert spent[0] < 0.2
    # Some 7 s on two idle cores.
    assert seen["seconds"] < SECONDS
    # A bias keeps the reference: one small picture a key, and a full one at rest.
    assert 1 <= len(seen["biased"]) <= 4
    assert all("against 64 rays" in each for each in seen["biased"])
    assert len({each.split(" ")[1] for each in [seen["figures"][-1], seen["biased"][-1]]}) == 2
    seen = driven(browser, "fit", address)
    assert "check the box beside a number, such as bias.constant" in seen["refused"]
    assert parse_config(seen["unfitted"]).fit.parameters == {}
    assert seen["linked"] == 0.25
    assert seen["cleared"] == ""
    assert seen["before"] == seen["otherKept"] == 0.5
    assert seen["kept"] == 3
    assert seen["isRunning"]
    assert seen["stopped"] < SECONDS / 6
    assert seen["otherNote"].startswith("stopped")
    assert seen["undone"] != 3
    assert seen["error"] == ""


def test_what_one_turns_stands_first_and_the_light_is_dragged_in_the_picture(browser, start, tmp_path):
    (tmp_path / "tiny.yaml").write_text(LARGER)
    seen = driven(browser, "tune", start("tiny.yaml")[1])
    lamp = ["scene.light.azimuth", "scene.light.elevation"]
    assert seen["first"] == ["bias.constant", "bias.slope", "bias.normal_offset", "filter.radius", *lamp]
    assert {"bias.slope_profile", "bias.unit", "bias.normal_offset_profile", "bias.plane.type"} <= {*seen["folded"]}
    assert not {"filter.type", "technique.type", "shadow_map.resolution", "filter.samples"} & {*seen["folded"]}
    assert len(seen["found"]) == 1
    assert seen["found"][0].startswith("slope profile")
    assert not seen["openAfter"]
    started, dragged, undone, redone, keyed = seen["angles"]
    assert started == undone == [-60, 50]
    assert dragged == redone
    assert keyed != redone
    # The handle stays under the pointer.
    assert seen["moved"] == pytest.approx([30, 40], abs=2)
    assert dragged[1] < 50
    assert seen["framed"]["mean"] < seen["far"]["mean"] - 2
    name, head = seen["png"]
    assert name == "tiny-view.png"
    assert head == "89504e470d0a1a0a0000000d49484452" + "0000009000000060"
    assert seen["beside"] == ["three.js defaults", True]
    assert seen["error"] == ""


SPHERES = ", ".join(
    f"{{path: builtin:sphere, options: {{radius: 0.4, subdivisions: 6}}, translate: [{x}, 0.5, 0]}}"
    for x in (-0.9, 0, 0.9)
)
SHOWN = {
    "spot": ("scene.light={type: spot, position: [1, 3, 1], radius: 0.1}",),
    "cascades": ("technique={type: cascades, count: 2}", "filter.radius=1"),
    # 3 × 81,920 triangles.
    "large": (f"scene.meshes=[{{path: builtin:plane, options: {{size: 4}}}}, {SPHERES}]",),
}


def test_spots_cascades_and_200_000_triangles_are_shown_and_freed(browser):
    before = threading.active_count()
    with contextlib.ExitStack() as stack:
        pages = [stack.enter_context(diffshadow.view(parse_config(LARGER, each))) for each in SHOWN.values()]
        seen = driven(browser, "look", *(page.address for page in pages))
        assert [page.values["bias.constant"] for page in pages] == [2.25, 2.25, 2.25]
    assert threading.active_count() == before
    assert seen["lasting"] == ""
    for name, found in zip(SHOWN, seen["pages"], strict=True):
        assert abs(found["lit"] - found["started"]) > 0.05, name
        assert found["quiet"] == 0, name
        assert abs(found["viewed"] - found["lit"]) > 0.2, name
        assert "light's view" in found["views"]
        assert ("layers of the map" in found["views"]) == (name == "cascades")


def test_a_person_finds_acne_turns_the_light_fits_and_keeps_what_was_found(browser, start, tmp_path):
    (tmp_path / "tiny.yaml").write_text(LARGER)
    process, address = start("tiny.yaml")
    seen = driven(browser, "person", address)
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
    assert seen["unfitted"] == seen["keyed"]
    assert seen["shared"] == pytest.approx(seen["fitted"], rel=1e-5)
    assert seen["widths"] == [0, 0, 0]
    assert seen["violations"] == []
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert process.wait(SECONDS) == 0
    assert time.monotonic() - began < SECONDS / 2
