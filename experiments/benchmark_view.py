"""What a picture of `diffshadow view` costs, by what was changed.

Each change is made many times to other values, at full and at half size. CPU time is of the whole process, with all of
its threads: what a picture takes on a machine that does nothing else. Programs are compiled before; `compiled` counts
those that were compiled after all.

With `--browser`, a headless Chromium shows the page, and the time is also measured from the press of a key to the frame
that shows its picture. It needs what `experiments/engines` needs.
"""

import argparse
import json
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
from benchmark_raster import machine, positive
from engines.engines import BROWSERS
from engines.engines import HERE as ENGINES
from rich.table import Table

import diffshadow
from diffshadow.config import load_config
from diffshadow.console import Console
from diffshadow.viewer import Look, State, Viewer

SIZE = (384, 512)
"""Height and width of a full picture, in pixels."""


def look(**state: Any) -> Look:
    return Look(state=State(**state))


def looks(viewer: Any, change: str, repeats: int) -> list[Any]:
    """Settings that differ in what was `change`d."""
    camera = viewer.controls(look().state)["camera"]
    eye = camera["eye"]
    shares = [(i + 1) / (repeats + 1) for i in range(repeats)]
    if change == "bias":
        return [look(numbers={"bias.constant": 4 * share}) for share in shares]
    if change == "camera":
        return [look(camera={**camera, "eye": [eye[0] + 0.3 * share, *eye[1:]]}) for share in shares]
    return [look(numbers={"scene.light.azimuth": -150 + 80 * share}) for share in shares]


def browser() -> str | None:
    """Chromium, where it and what drives it are installed."""
    has = shutil.which("node") and (ENGINES / "node_modules" / "playwright-core").is_dir()
    return next(filter(None, map(shutil.which, BROWSERS)), None) if has else None


def key_to_picture(config: Path, override: str, chromium: str, repeats: int) -> dict[str, dict[str, float]]:
    """Milliseconds from a key to its picture in `chromium`, by what the key changes."""
    view = [sys.executable, "-m", "diffshadow", "view", str(config), override, "--no-browser"]
    server = subprocess.Popen(view, stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        drive = ["node", str(ENGINES / "press_keys.mjs"), str(ENGINES), chromium, address, str(repeats)]
        taken = json.loads(subprocess.run(drive, stdout=subprocess.PIPE, text=True, check=True).stdout)
    finally:
        server.kill()
        server.communicate()
    return {change: {"median_ms": statistics.median(ms), "least_ms": min(ms)} for change, ms in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, default=Path("configs/quickstart.yaml"))
    parser.add_argument("--repeats", type=positive, default=15)
    parser.add_argument("--size", type=positive, nargs=2, default=SIZE, help="height and width, in pixels")
    parser.add_argument("--browser", action="store_true", help="whether to measure from key to picture in Chromium")
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parser.parse_args()
    chromium = browser() if given.browser else None
    if given.browser and chromium is None:
        parser.error("--browser needs chromium, node, and `npm install` in experiments/engines; install them")
    diffshadow.setup(progress=False)
    override = f"scene.camera.resolution={list(given.size)}"
    config = load_config(given.config, [override])
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, *_, **__: compiled.append(name) if "backend_compile" in name else None
    )
    started, clock = time.process_time(), time.perf_counter()
    viewer = Viewer(config, str(given.config))
    first = viewer.show(look(), at_rest=True).about
    report: dict[str, Any] = {
        "machine": machine(),
        "first_picture": {"cpu_s": time.process_time() - started, "wall_s": time.perf_counter() - clock},
        "size": first["size"],
        "changes": {},
    }
    table = Table("change", "full, CPU ms", "wall ms", "half, CPU ms", "wall ms", "compiled")
    for change in ("bias", "camera", "light"):
        row: dict[str, Any] = {}
        for full in (True, False):
            draw = lambda each, full=full: viewer.shown(each, full=full)
            draw(looks(viewer, change, 3)[0])
            before, cpu, wall = len(compiled), [], []
            for each in looks(viewer, change, given.repeats):
                at = time.process_time(), time.perf_counter()
                draw(each)
                cpu.append(1e3 * (time.process_time() - at[0]))
                wall.append(1e3 * (time.perf_counter() - at[1]))
            size = "full" if full else "half"
            row[size] = {"cpu_ms": statistics.median(cpu), "least_cpu_ms": min(cpu), "wall_ms": statistics.median(wall)}
            row["compiled"] = row.get("compiled", 0) + len(compiled) - before
        report["changes"][change] = row
        cells = [f"{row[size][key]:.1f}" for size in ("full", "half") for key in ("cpu_ms", "wall_ms")]
        table.add_row(change, *cells, str(row["compiled"]))
    console = Console()
    console.print(table)
    console.print(f"first picture: {report['first_picture']['cpu_s']:.1f} CPU s; medians of {given.repeats}")
    if chromium is not None:
        report["key_to_picture"] = key_to_picture(given.config, override, chromium, given.repeats)
        said = ", ".join(f"{change} {row['median_ms']:.0f} ms" for change, row in report["key_to_picture"].items())
        console.print(f"key to picture, medians of {given.repeats}: {said}")
    if given.json:
        given.json.write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
