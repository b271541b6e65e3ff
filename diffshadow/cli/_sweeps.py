"""Commands for many runs: sweep and advise."""

import os
from pathlib import Path

from ..config import load_advice, load_config, load_sweep
from ..console import Command, Console, source
from ..settings.engines import EngineName
from ._app import app, check_count, counting, file_of, print_end, print_notes
from ._jax import start_jax

# More workers would only wait for each other, and each takes a gigabyte.
_MAX_WORKERS_PER_CORE = 4
# Between updates of the progress bar: about a tenth of a second.
_RUNS_PER_UPDATE = 100


@app.command
def sweep(
    config: Path,
    /,
    *overrides: str,
    scheduler: str | None = None,
    workers: int | None = None,
    limit: int | None = None,
    dry_run: bool = False,
) -> None:
    """Does the runs of the section `sweep` of CONFIG, and collects their results in one table.

    If started again, it does the runs that are missing or have failed. The path of the sweep's folder is the last line
    printed.

    Example: `diffshadow sweep configs/sweep_small.yaml --dry-run`

    Parameters
    ----------
    config
        YAML file with a section `sweep`, or the folder of a sweep.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `sweep.repeats=2`.
    scheduler
        Address of a Dask scheduler, such as tcp://host:8786, whose workers have this version of the package.
    workers
        Number of local worker processes, by default one per core; 0 does the runs in this process.
    limit
        Most runs to do.
    dry_run
        Only count the runs that would be done, and show the first.
    """
    check_count("--workers", workers, 0, _MAX_WORKERS_PER_CORE * (os.cpu_count() or 1))
    check_count("--limit", limit, 1)
    with counting("checking runs", _RUNS_PER_UPDATE) as progress:
        plan = load_sweep(file_of(config, sweep=True), overrides, check=not dry_run, progress=progress)
    start_jax()
    from .. import study

    if dry_run:
        study.print_plan(Console(), plan, limit)
        options = [] if limit is None else ["--limit", str(limit)]
        print_end(None, [Command("Do these runs.", ["sweep", source(config), *overrides, *options])])
        return
    done = study.run_sweep(plan, console=Console(), scheduler=scheduler, workers=workers, limit=limit)
    print_end(done, study.next_after(done))


@app.command
def advise(
    config: Path,
    /,
    *overrides: str,
    scheduler: str | None = None,
    workers: int | None = None,
    dry_run: bool = False,
    engine: EngineName | None = None,
) -> None:
    """Fits several techniques to the views of CONFIG, times them, and recommends one.

    The section `advise` lists the techniques, by default five biases with three filters and two sizes of maps.
    Prints a ranking and a verdict, and writes a page and `recommended.yaml`. If started again, it does the fits that
    are missing or have failed. The path of the folder is the last line printed.

    Example: `diffshadow advise configs/quickstart.yaml advise.within=0.1`

    Example: `diffshadow advise runs/quickstart --engine godot`

    Parameters
    ----------
    config
        YAML file, mesh file, folder of a finished run or builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `'advise.resolutions=[[512, 512]]'`.
    scheduler
        Address of a Dask scheduler, such as tcp://host:8786, whose workers have this version of the package.
    workers
        Number of local worker processes, by default one per core; 0 does the fits in this process.
    dry_run
        Only list the fits that would be done.
    engine
        Rank only the filters and biases that this engine has, and end with the code to paste.
    """
    check_count("--workers", workers, 0, _MAX_WORKERS_PER_CORE * (os.cpu_count() or 1))
    file = file_of(config)
    if engine is None:
        with counting("checking runs", _RUNS_PER_UPDATE) as progress:
            advice = load_advice(file, overrides, progress=progress)
        start_jax()
        from .. import study
    else:
        # Its mistakes are reported before JAX is loaded.
        print_notes(load_config(file, overrides).notes)
        start_jax()
        from .. import study

        with counting("checking runs", _RUNS_PER_UPDATE) as progress:
            advice = study.engine_advice(file, overrides, engine, console=Console(), progress=progress)
    if dry_run:
        study.print_advise_plan(Console(), advice)
        options = [] if engine is None else ["--engine", engine]
        print_end(None, [Command("Do these fits.", ["advise", source(config), *overrides, *options])])
        return
    done = study.run_advise(advice, console=Console(), scheduler=scheduler, workers=workers)
    print_end(done, study.next_after(done))
