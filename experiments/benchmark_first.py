"""What the first run of each shipped configuration costs, from an empty cache: to trace, to compile and to run.

    python experiments/benchmark_first.py
    python experiments/benchmark_first.py configs/picture.yaml configs/room.yaml --programs 8 --json first.json

Each configuration is a process of its own, with an empty cache: a fit if it has a section `fit`, else a render; those
of sweeps are left out. Columns are CPU seconds of all threads, which other work on the machine disturbs less than it
does times; only `trace` is the time of JAX's events, which is its CPU time on an idle machine.

- `all`: of the whole process. `trace`: to make JAX's programs and to lower them. `compile`: by XLA. `rest`: to import,
  to draw, to trace rays, to fit, and to write the run.
- `programs`: how many were compiled. `--programs` names those that took longest.
"""

import argparse
import json
import os
import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from _child import rows_of_child
from benchmark_raster import machine, positive
from rich.table import Table

import diffshadow
from diffshadow.console import Console

CONFIGS = Path(__file__).parent.parent / "configs"


class Compiled:
    """The CPU seconds that JAX takes to trace and to compile, and each program's."""

    def __init__(self):
        # Here, after `diffshadow.setup`.
        import jax
        from jax._src import compiler

        self.tracing, self.compiling, self.count = 0.0, 0.0, 0
        self.programs: dict[str, float] = {}
        compile_or_get = compiler.compile_or_get_cached

        def timed(backend: Any, module: Any, *given: Any, **more: Any) -> Any:
            began = time.process_time()
            try:
                return compile_or_get(backend, module, *given, **more)
            finally:
                seconds = time.process_time() - began
                self.compiling, self.count = self.compiling + seconds, self.count + 1
                name = str(module.operation.attributes["sym_name"]).strip('"')
                self.programs[name] = self.programs.get(name, 0.0) + seconds

        compiler.compile_or_get_cached = timed
        jax.monitoring.register_event_duration_secs_listener(self._add)
        self._spans: list[tuple[float, float]] = []

    def _add(self, event: str, duration_secs: float, **_: Any) -> None:
        # Tracing keeps one thread busy, so its time is its CPU time, on an idle machine.
        if event in ("/jax/core/compile/jaxpr_trace_duration", "/jax/core/compile/jaxpr_to_mlir_module_duration"):
            end = time.perf_counter()
            # Spans may lie in one another: those within the last one are part of it.
            while self._spans and self._spans[-1][0] >= end - duration_secs:
                self.tracing -= self._spans.pop()[1]
            self._spans.append((end - duration_secs, duration_secs))
            self.tracing += duration_secs


def measure(path: Path, changes: Sequence[str]) -> dict[str, Any]:
    """The first run of a configuration, in this process."""
    diffshadow.setup(progress=False)
    compiled = Compiled()
    from diffshadow import study
    from diffshadow.config import load_config

    with open(os.devnull, "w") as nowhere, tempfile.TemporaryDirectory() as folder:
        config = load_config(path, [*changes, f"output={folder}"])
        run = study.run_fit if has_section(path, "fit") else study.run_render
        run(config, console=Console(file=nowhere))
    used = resource.getrusage(resource.RUSAGE_SELF)
    everything = used.ru_utime + used.ru_stime
    return {
        "name": path.stem,
        "all": everything,
        "trace": compiled.tracing,
        "compile": compiled.compiling,
        "rest": everything - compiled.tracing - compiled.compiling,
        "programs": compiled.count,
        "dearest": sorted(compiled.programs.items(), key=lambda item: -item[1]),
    }


def has_section(path: Path, name: str) -> bool:
    """Whether a configuration has a section at its top."""
    return any(line.startswith(f"{name}:") for line in path.read_text().splitlines())


def table_of(rows: Sequence[dict[str, Any]], programs: int) -> Table:
    """All figures, the dearest first."""
    columns = "all", "trace", "compile", "rest"
    table = Table("configuration", *columns, "programs", *(["dearest"] if programs else []))
    for row in sorted(rows, key=lambda row: -row["all"]):
        dearest = ", ".join(f"{name.removeprefix('jit_')} {seconds:.1f}" for name, seconds in row["dearest"][:programs])
        table.add_row(
            row["name"],
            *(f"{row[name]:.1f}" for name in columns),
            str(row["programs"]),
            *([dearest] if programs else []),
        )
    return table


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("configs", type=Path, nargs="*", help="by default all in configs/ but sweeps")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a change of each")
    parser.add_argument("--programs", type=positive, help="how many of the programs are named")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.child:
        print(json.dumps(measure(options.configs[0], options.set)))
        return
    paths = options.configs or [
        path
        for path in sorted(CONFIGS.glob("*.yaml"))
        if not has_section(path, "sweep") and not has_section(path, "advise")
    ]
    console, about = Console(), machine()
    console.print(", ".join(f"{name} {value}" for name, value in about.items()))
    rows = []
    for path in paths:
        rows += rows_of_child(__file__, path.name, str(path.resolve()), *(f"--set={each}" for each in options.set))
        console.print(f"{path.name}: {rows[-1]['all']:.0f} s")
    console.print(table_of(rows, options.programs or 0))
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
