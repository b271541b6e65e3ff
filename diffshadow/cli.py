"""The command `diffshadow`.

It imports as little as it can: a mistake in a configuration is reported in a fraction of a second, before JAX is
loaded.
"""

import contextlib
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NoReturn

from cyclopts import App, CycloptsError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from ._xla import use_all_cores
from .config import ConfigError, describe, load_config, load_sweep, printable

SUCCESS, USER_ERROR, INTERRUPTED = 0, 2, 130
"""Exit codes: done; a mistake in what was asked for; stopped by Ctrl-C."""

# More only wait for each other, and each takes a gigabyte.
_WORKERS_A_CORE = 4
# From the coarsest figure that can be read to the finest that a page can show.
_DPI = (10, 2400)
# Seconds after which Ctrl-C that had no effect is repeated.
_INSISTENCE = 0.2
# Runs that are checked in a tenth of a second.
_RUNS_A_MOMENT = 100

_NO_MEMORY = (
    "there is not enough memory; expected enough for all images, maps and rays; lower scene.camera.resolution, "
    "shadow_map.resolution or reference.supersampling"
)

_HELP = """
Fits the settings of shadow maps to ray-traced truth, by gradient.

CONFIG is a YAML file. Each KEY=VALUE after it replaces one of the file's values: the key is dotted, list entries are
numbered from 0, and the value is YAML.

For example:

    diffshadow validate configs/quickstart.yaml

    diffshadow fit configs/quickstart.yaml

    diffshadow fit configs/quickstart.yaml filter.samples=64 bias.slope=1

    diffshadow render configs/spot.yaml scene.meshes.0.path=bunny.obj

    diffshadow render configs/spot.yaml 'scene.camera.resolution=[256, 256]'
"""

app = App(
    name="diffshadow",
    help=_HELP,
    help_format="markdown",
    version=lambda: version("diffshadow"),
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)


@app.command
def fit(config: Path, /, *overrides: str) -> None:
    """Fits the parameters named in CONFIG, and writes values, images and a report.

    The path of the run's folder is the last line printed.

    Example: `diffshadow fit configs/quickstart.yaml fit.solver.max_steps=10`

    Parameters
    ----------
    config
        YAML file that says what to fit.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    """
    settings = load_config(config, overrides, fitting=True)
    _keep_compiled_programs()
    from . import study

    _print_path(study.run_fit(settings, console=_console()))


@app.command
def render(config: Path, /, *overrides: str, debug: bool = False) -> None:
    """Draws the scene of CONFIG with its technique as it stands, and writes the images.

    The path of the run's folder is the last line printed.

    Example: `diffshadow render configs/quickstart.yaml bias.constant=2 --debug`

    Parameters
    ----------
    config
        YAML file that says what to draw.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    debug
        Also write pictures of what the technique works with: depths, silhouettes, blockers, patterns, volume counts.
    """
    settings = load_config(config, overrides)
    _keep_compiled_programs()
    from . import study

    _print_path(study.run_render(settings, console=_console(), debug=debug))


@app.command
def validate(config: Path, /, *overrides: str) -> None:
    """Checks CONFIG, draws its scene, and lists every setting with its unit. Writes nothing.

    It finds all that a render or a fit can refuse before it traces rays.

    Example: `diffshadow validate configs/quickstart.yaml filter.type=random_disk`

    Parameters
    ----------
    config
        YAML file to check.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    """
    settings = load_config(config, overrides, fitting=True)
    _keep_compiled_programs()
    from . import study

    console = _console()
    triangles = study.check(settings, console=console)
    table = Table("setting", "value", "unit", title=Text(settings.name), title_justify="left")
    for row in describe(settings):
        table.add_row(*(Text(printable(cell)) for cell in row))
    console.print(table)
    said = printable(f"{config} is valid; its scene has {triangles:,} triangles")
    console.print(Text(said), soft_wrap=True)


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
    """Does the many runs that the section `sweep` of CONFIG describes, and gathers their results in one table.

    Started again, it does what is missing or has failed. The path of the sweep's folder is the last line printed.

    Example: `diffshadow sweep configs/sweep_small.yaml --dry-run`

    Parameters
    ----------
    config
        YAML file with a section `sweep`.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `sweep.repeats=2`.
    scheduler
        Address of a Dask scheduler, such as tcp://host:8786, whose workers have this package and see the same files.
    workers
        Local worker processes, by default one for each core; 0 does the runs in this process.
    limit
        Runs to do at most.
    dry_run
        Only list what would be done.
    """
    _check_count("--workers", workers, 0, _WORKERS_A_CORE * (os.cpu_count() or 1))
    _check_count("--limit", limit, 1)
    with _checking() as progress:
        plan = load_sweep(config, overrides, check=not dry_run, progress=progress)
    _keep_compiled_programs()
    from . import study

    if dry_run:
        study.print_plan(_console(), plan, limit)
        return
    done = study.run_sweep(plan, console=_console(), scheduler=scheduler, workers=workers, limit=limit)
    _print_path(done)


@app.command
def report(folder: Path, /, *, figures: Literal["png", "svg", "pdf"] | None = None, dpi: int = 150) -> None:
    """Writes the page of a finished run or sweep again, from the files in FOLDER alone.

    The path of the page is the last line printed.

    Example: `diffshadow report runs/quickstart --figures pdf`

    Parameters
    ----------
    folder
        Folder of a fit, a render or a sweep.
    figures
        Also write the run's figures again, in this format; the shadow map and debug views stay as they are.
    dpi
        Pixels an inch in these figures.
    """
    _check_count("--dpi", dpi, *_DPI)
    from . import study

    _print_path(study.report(folder, form=figures, dpi=dpi))


@app.command
def compare(first: Path, second: Path, /, *more: Path, output: Path = Path("compare.html")) -> None:
    """Prints what differs between finished runs, and writes a page with their images side by side.

    The path of the page is the last line printed.

    Example: `diffshadow compare runs/quickstart runs/spot --output comparison.html`

    Parameters
    ----------
    first
        Folder of a fit or a render.
    second
        Another one.
    more
        Further ones.
    output
        Where the page is written; what is there is replaced.
    """
    if output.is_dir():
        raise ValueError(
            f"--output is {output}, a folder; expected the path of a page; name a file such as compare.html"
        )
    from . import study

    _print_path(study.compare([first, second, *more], output, console=_console()))


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs the command with `arguments`, by default the process's, and exits.

    The exit code is 0 on success, 2 on a mistake of the user's, which is reported in one message on stderr, and 130
    after an interrupt. Any other error is a fault of the program, and keeps its traceback.
    """
    use_all_cores()
    errors = _Console(stderr=True, highlight=False)
    for stream in (sys.stdout, sys.stderr):
        # An encoding may lack letters of names.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with _insistent_interrupts():
            app(
                sys.argv[1:] if arguments is None else list(arguments),
                exit_on_error=False,
                print_error=False,
                error_console=errors,
            )
    except CycloptsError as error:
        _tell(errors, [f"{_sentence(error)}; see diffshadow --help"])
        sys.exit(USER_ERROR)
    except KeyboardInterrupt:
        _tell(errors, ["interrupted"])
        sys.exit(INTERRUPTED)
    except (ValueError, OSError) as error:
        if not _is_mistake(error):
            raise
        _tell(errors, map(str, error.problems) if isinstance(error, ConfigError) else [str(error)])
        sys.exit(USER_ERROR)
    except (MemoryError, RuntimeError) as error:
        # XLA's own error is a `RuntimeError`, which names its cause in its text alone.
        if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):
            raise
        _tell(errors, [_NO_MEMORY])
        sys.exit(USER_ERROR)
    sys.exit(SUCCESS)


@contextlib.contextmanager
def _insistent_interrupts() -> Iterator[None]:
    """Repeats the `KeyboardInterrupt` of Ctrl-C until it has an effect.

    Python raises it wherever the main thread is. In a callback of the garbage collector it is dropped with a message,
    and by a library's native code that has called Python, such as Pydantic's, without one.
    """
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        yield
        return

    def interrupt(*_: Any) -> None:
        signal.setitimer(signal.ITIMER_REAL, _INSISTENCE)
        # What is done because of the first must come to its end.
        error = sys.exception()
        while error is not None:
            if isinstance(error, KeyboardInterrupt):
                return
            error = error.__context__
        raise KeyboardInterrupt

    def report(unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            others(unraisable)

    others, sys.unraisablehook = sys.unraisablehook, report
    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGALRM)}
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = others


def _check_count(option: str, value: int | None, least: int, most: int | None = None) -> None:
    if value is not None and (value < least or (most is not None and value > most)):
        limits = f"at least {least}" + ("" if most is None else f" and at most {most}")
        raise ValueError(f"{option} is {value}; expected a whole number {limits}, or nothing: leave it out")


@contextlib.contextmanager
def _checking() -> Iterator[Callable[[int, int], None]]:
    """A bar for the runs of a sweep that have been checked. It shows only if they are many, and somebody watches."""
    console = _console()
    bar = Progress(
        TextColumn("checking runs"),
        BarColumn(bar_width=40),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = bar.add_task("")

    def progress(done: int, total: int) -> None:
        if done % _RUNS_A_MOMENT == 0:
            bar.start()
            bar.update(task, completed=done, total=total)

    try:
        yield progress
    finally:
        bar.stop()


def _keep_compiled_programs() -> None:
    """Lets JAX keep compiled programs in the cache folder, where that can be: the next run starts sooner.

    A folder that the user gave to JAX (`JAX_COMPILATION_CACHE_DIR`) stays.
    """
    import jax

    from .io import FileError, cache_folder, check_writable

    if jax.config.jax_compilation_cache_dir:
        return
    with contextlib.suppress(OSError, RuntimeError, FileError):
        folder = cache_folder() / "xla"
        check_writable(folder)
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _is_mistake(error: ValueError | OSError) -> bool:
    """Whether `error` tells of what the user gave, rather than of a fault in this program.

    This package raises `ValueError` for the former alone; a `ValueError` from inside a library slipped past its checks.
    """
    if isinstance(error, ConfigError | OSError):
        return True
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    module = str(frames[-1].f_globals.get("__name__", ""))
    return module.partition(".")[0] == __name__.partition(".")[0]


def _sentence(error: CycloptsError) -> str:
    return " ".join(str(error).split()).rstrip(".")


def _tell(console: Console, messages: Iterable[str]) -> None:
    """Prints an error, whose `messages` have a line each."""
    # Without wrapping, so that FILE:LINE stays in one piece for editors and for grep.
    lines = "\n".join(map(printable, messages))
    console.print(Text.assemble(("error: ", "bold red"), lines), soft_wrap=True)


def _print_path(path: Path) -> None:
    _console().print(Text(printable(str(path))), soft_wrap=True)


class _Console(Console):
    """A console that writes characters which are not printable as Python escapes them, wherever text comes from."""

    def render(self, *args: Any, **kwargs: Any) -> Iterator[Segment]:
        """As rich's, with the text of every segment printable."""
        for segment in super().render(*args, **kwargs):
            plain = "\n".join(map(printable, segment.text.split("\n")))
            yield segment if segment.control else segment._replace(text=plain)


def _console() -> Console:
    return _Console(highlight=False)
