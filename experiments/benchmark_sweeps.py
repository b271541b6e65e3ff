"""How much longer a sweep takes on workers that share no files with the command.

    python experiments/benchmark_sweeps.py
    python experiments/benchmark_sweeps.py --sizes 16 --turns 9 --json sweeps.json

Starts a Dask scheduler and two workers on this machine, each with a home, a cache and a working folder of its own. The
sweep is `configs/sweep_small.yaml` with 200 runs of five seeds. Both ways take turns on the same workers, and a first
turn, in which they compile and trace, is left out:

- `shared`: the workers write to the sweep's folder, as local workers do.
- `apart`: inputs are sent to the workers, results come back, and the command writes them.

`ratio` is the median of the ratios of turns. CPU seconds are those of the command, the scheduler and the workers, which
other work on the machine disturbs less than it does times.
"""

import argparse
import contextlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmark_raster import machine, positive
from rich.table import Table

from diffshadow import setup, study
from diffshadow.config import load_sweep
from diffshadow.console import Console
from diffshadow.study.sweeps import _pool

CONFIG = Path(__file__).parent.parent / "configs" / "sweep_small.yaml"
WORKERS, SEEDS = 2, 5
# Seconds for the scheduler to start.
_TIMEOUT = 60


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, list[int]]]:
    """The address of a scheduler with workers, and the identifiers of all their processes."""
    processes: list[subprocess.Popen[bytes]] = []

    def start(name: str, *command: str) -> None:
        own = folder / name
        own.mkdir()
        known = {key: os.environ[key] for key in ("PATH", "PYTHONPATH") if key in os.environ}
        command = sys.executable, "-m", *command, "--no-dashboard"
        with (own / "out").open("w") as out:
            processes.append(
                subprocess.Popen(command, cwd=own, env={**known, "HOME": str(own)}, stdout=out, stderr=out)
            )

    try:
        about = folder / "scheduler.json"
        options = "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(about)
        start("scheduler", "distributed.cli.dask_scheduler", *options)
        deadline = time.monotonic() + _TIMEOUT
        while not about.exists():
            if time.monotonic() > deadline:
                raise RuntimeError(f"no scheduler started:\n{(folder / 'scheduler' / 'out').read_text()[-2000:]}")
            time.sleep(0.1)
        address = json.loads(about.read_text())["address"]
        for i in range(WORKERS):
            start(f"worker{i}", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny")
        yield address, [process.pid for process in processes]
    finally:
        # A worker that loses its scheduler while it stops may never end.
        for process in processes:
            process.kill()
            process.wait()


def cpu_seconds(process: int) -> float:
    """The CPU time that a process has taken."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(size: int, runs: int, turns: int, address: str, others: Sequence[int], folder: Path) -> dict[str, Any]:
    """The seconds of each turn, both ways."""
    radii = [0.5 + i / 100 for i in range(runs // (2 * SEEDS))]
    changes = [
        f"scene.camera.resolution=[{size}, {size}]",
        f"shadow_map.resolution=[{4 * size}, {4 * size}]",
        f"sweep={{grid: {{filter.radius: {radii}, filter.samples: [16, 64]}}, repeats: {SEEDS}}}",
        f"output={folder / 'runs'}",
    ]
    on_cluster = _pool.OnCluster
    ways: dict[str, Callable[..., Any]] = {
        "shared": lambda *given, apart, **more: on_cluster(*given, **more),
        "apart": on_cluster,
    }
    found: dict[str, list[tuple[float, float]]] = {way: [] for way in ways}
    used = lambda: time.process_time() + sum(map(cpu_seconds, others))
    with open(os.devnull, "w") as nowhere:
        for turn in range(1 + turns):
            # The first of a turn alternates.
            for way in sorted(ways, reverse=turn % 2 == 1):
                sweep = load_sweep(CONFIG, changes)
                _pool.OnCluster = ways[way]
                began, before = time.perf_counter(), used()
                done = study.run_sweep(sweep, console=Console(file=nowhere), scheduler=address)
                _pool.OnCluster = on_cluster
                seconds = time.perf_counter() - began, used() - before
                if json.loads((done / "result.json").read_text())["done"] != len(sweep.runs):
                    raise RuntimeError(f"some runs failed; see {done}")
                shutil.rmtree(done)
                if turn > 0:
                    found[way].append(seconds)
    return {"size": size, "runs": 2 * SEEDS * len(radii), **found}


def table_of(rows: Sequence[dict[str, Any]]) -> Table:
    """Medians of times and CPU times, and of their ratios."""
    table = Table("pixels", "runs", *(f"{what}{way}" for what in ("", "CPU ") for way in ("shared", "apart", "ratio")))
    for row in rows:
        numbers: list[float] = []
        for what in (0, 1):
            shared, apart = ([seconds[what] for seconds in row[way]] for way in ("shared", "apart"))
            ratios = [b / a for a, b in zip(shared, apart, strict=True)]
            numbers += [statistics.median(values) for values in (shared, apart, ratios)]
        table.add_row(f"{row['size']}", f"{row['runs']}", *(f"{number:.2f}" for number in numbers))
    return table


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=positive, nargs="+", default=[16, 128], help="sides of images, pixels")
    parser.add_argument("--runs", type=positive, default=200, help="runs of a sweep; a multiple of 10")
    parser.add_argument("--turns", type=positive, default=5, help="turns of each way")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(argv)
    setup(progress=False)
    console, about = Console(), machine()
    console.print(", ".join(f"{name} {value}" for name, value in about.items()))
    with tempfile.TemporaryDirectory() as folder:
        os.environ["DIFFSHADOW_CACHE"] = str(Path(folder, "cache"))
        with cluster(Path(folder)) as (address, others):
            rows = [measure(size, options.runs, options.turns, address, others, Path(folder)) for size in options.sizes]
    console.print(table_of(rows))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
