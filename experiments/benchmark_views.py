"""How the time and the memory of a joint fit grow with the number of its views.

    python experiments/benchmark_views.py
    python experiments/benchmark_views.py --views 32 1000 --over worst --json views.json

Each number of views is a run of `configs/many_views.yaml` in a process of its own, with an empty cache: four meshes,
each under a quarter as many suns. Times are in seconds. Those without a title of their own leave the time to compile
out.

- `set-up`: to read and check the configuration, draw all views and trace their references.
- `fit`: all phases with their steps and samples, and the hard compare of whole images after each.
- `a step`: of the solver, the median.
- `rest`: the errors of all views, the pictures and the files of the run.
- `with compiling`: all of these, and the time to compile.
- `peak`: the most memory of the process, its maximum resident set size.

The last rows are the slope of a line through the logarithms of a column and of the number of views, and the ratio of
the last number of views to the first.
"""

import argparse
import json
import os
import statistics
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from _child import rows_of_child
from benchmark_raster import machine, peak_memory, positive
from rich.table import Table

import diffshadow
from diffshadow.console import Console
from diffshadow.settings.fit import Loss

CONFIG = Path(__file__).parent.parent / "configs" / "many_views.yaml"
MESHES = ("torus_knot", "chair", "sphere", "blob")
TIMES = {
    "setup": "set-up",
    "fit": "fit",
    "step": "a step",
    "rest": "rest",
    "all": "all",
    "with_compiling": "with compiling",
}
"""The times that are measured, by their titles."""


class CompileTime:
    """The seconds that JAX takes to trace and compile."""

    def __init__(self):
        # Here, after `diffshadow.setup`.
        import jax

        self._spans: list[tuple[float, float]] = []
        jax.monitoring.register_event_duration_secs_listener(self._add)

    def _add(self, event: str, duration_secs: float, **_: Any) -> None:
        if event.startswith("/jax/core/compile/"):
            end = time.perf_counter()
            self._spans.append((end - duration_secs, end))

    def between(self, start: float, end: float) -> float:
        """The seconds from `start` to `end` in which something was compiled. Spans may lie in one another."""
        total = 0.0
        for first, last in sorted(self._spans):
            first, last = max(first, start), min(last, end)
            if last > first:
                total, start = total + last - first, last
        return total


def settings(views: int, size: int, over: str, folder: str) -> list[str]:
    """The changes of the configuration."""
    paths = ", ".join(f"builtin:{name}" for name in MESHES)
    suns = f"{{count: {views // len(MESHES)}, latitude: 45, day: 172, first: 6.5, last: 17.5}}"
    return [
        f"fit.views={{grid: {{scene.meshes.0.path: [{paths}]}}, sun: {suns}}}",
        f"scene.camera.resolution=[{size}, {size}]",
        f"shadow_map.resolution=[{4 * size}, {4 * size}]",
        f"fit.loss.over={over}",
        f"output={folder}",
    ]


def measure(views: int, size: int, over: str) -> dict[str, Any]:
    """One fit in this process."""
    diffshadow.setup(progress=False)
    compiling, began = CompileTime(), time.perf_counter()
    from diffshadow import fit, study
    from diffshadow.config import load_config

    steps: list[tuple[int, float]] = []
    ends: list[float] = []
    fit_views = fit.fit

    def timed(*given: Any, **settings: Any) -> Any:
        """The fit, with the times of its steps and of its ends."""
        ends.append(time.perf_counter())
        result = fit_views(
            *given, **{**settings, "on_step": lambda step: steps.append((step.phase, time.perf_counter()))}
        )
        ends.append(time.perf_counter())
        return result

    fit.fit = timed
    with tempfile.TemporaryDirectory() as folder, open(os.devnull, "w") as nowhere:
        config = load_config(CONFIG, settings(views, size, over, folder))
        path = study.run_fit(config, console=Console(file=nowhere))
        found = json.loads((path / "result.json").read_text())
    places = [began, *ends, time.perf_counter()]
    setup, fitting, rest = (end - start - compiling.between(start, end) for start, end in pairwise(places))
    total = places[-1] - began
    return {
        "views": views,
        "size": size,
        "dtype": "float32",
        "steps": found["solver"]["steps"],
        "setup": setup,
        "fit": fitting,
        "step": statistics.median(b - a for (p, a), (q, b) in pairwise(steps) if p == q),
        "rest": rest,
        "all": setup + fitting + rest,
        "with_compiling": total,
        "peak": peak_memory() / 2**10,
        "stages": found["seconds"],
    }


def table_of(rows: Sequence[dict[str, Any]]) -> Table:
    """All times and memory, with slopes and ratios."""
    table = Table("views", *TIMES.values(), "peak [GiB]")
    columns = (*TIMES, "peak")
    for row in rows:
        table.add_row(f"{row['views']:,}", *(f"{row[name]:.3g}" for name in columns))
    if len(rows) > 1:
        views = np.log([row["views"] for row in rows])
        slopes = (np.polyfit(views, np.log([row[name] for row in rows]), 1)[0] for name in columns)
        table.add_section()
        table.add_row("slope", *(f"{slope:.2f}" for slope in slopes))
        table.add_row("ratio", *(f"{rows[-1][name] / rows[0][name]:.1f}" for name in columns))
    return table


def views_of(text: str) -> int:
    number = positive(text)
    if number % len(MESHES):
        raise argparse.ArgumentTypeError(f"{text} is no multiple of {len(MESHES)}, the number of meshes; expected one")
    return number


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    counts = [32, 100, 316, 1000]
    parser.add_argument("--views", type=views_of, nargs="+", default=counts, help="multiples of four")
    parser.add_argument("--size", type=positive, default=128, help="side of images; maps have 4 times as many texels")
    parser.add_argument("--over", default=Loss.over, help="of the loss: mean, worst or cvar")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.child:
        print(json.dumps(measure(options.views[0], options.size, options.over)))
        return
    console, about = Console(), machine()
    console.print(", ".join(f"{name} {value}" for name, value in about.items()))
    rows = []
    for views in options.views:
        case, size = f"the fit to {views} views", str(options.size)
        rows += rows_of_child(__file__, case, "--views", str(views), "--size", size, "--over", options.over)
        console.print(f"{views:,} views: {rows[-1]['with_compiling']:.0f} s")
    console.print(table_of(rows))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
