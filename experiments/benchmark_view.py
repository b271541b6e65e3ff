"""What a picture of `diffshadow view` costs, by what was changed.

Each change is made many times to other values, at full and at half size. CPU time is of the whole process, with all of
its threads: what a picture takes on a machine that does nothing else. Programs are compiled before; `compiled` counts
those that were compiled after all.
"""

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import jax
from benchmark_raster import machine, positive
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, default=Path("configs/quickstart.yaml"))
    parser.add_argument("--repeats", type=positive, default=15)
    parser.add_argument("--json", type=Path, help="file for the figures")
    given = parser.parse_args()
    diffshadow.setup(progress=False)
    config = load_config(given.config, [f"scene.camera.resolution={list(SIZE)}"])
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
    if given.json:
        given.json.write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
