"""The command `diffshadow`.

It imports as little as possible, so that mistakes in a configuration are reported in a fraction of a second, before
JAX is loaded.
"""

import contextlib
import io
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NoReturn

from cyclopts import App, CycloptsError
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from ._interrupts import repeated_interrupts, reported_interrupts
from ._setup import setup
from .config import (
    DEFAULT_TEMPLATE,
    Config,
    ConfigError,
    describe,
    load_advice,
    load_config,
    load_sweep,
    printable,
    settings_file,
    write_template,
)
from .console import Console
from .settings.engines import EngineName, ImportedTechnique, ShadowType, ThreeJs
from .settings.quantities import MAX_TEXELS

SUCCESS, USER_ERROR, INTERRUPTED = 0, 2, 130
"""Exit codes: success; a mistake of the user's; stopped by Ctrl-C."""

# More workers would only wait for each other, and each takes a gigabyte.
_MAX_WORKERS_PER_CORE = 4
# More frames would take gigabytes.
_MAX_FRAMES = 1000
# A number that changes, as KEY=FROM:TO.
_CHANGE = re.compile(r"([^=]+)=([-+.\deE]*\d\.?):([-+.\deE]*\d\.?)")
# Runs between updates of the progress bar: about a tenth of a second.
_RUNS_PER_UPDATE = 100

_NO_MEMORY = (
    "ran out of memory; expected enough for all images, maps and rays; lower scene.camera.resolution, "
    "shadow_map.resolution or reference.supersampling"
)

_HELP = """
Fits the settings of shadow maps to a ray-traced reference, using gradients.

CONFIG is a YAML file, a mesh file, the folder of a finished run, or builtin:NAME, a template that comes with the
package. Each KEY=VALUE after it replaces a value. Keys are dotted, list entries are numbered from 0, and values are
YAML.

For example:

    diffshadow fit my_mesh.glb

    diffshadow init quickstart

    diffshadow fit builtin:quickstart filter.samples=64 bias.slope=1

    diffshadow validate configs/quickstart.yaml --preview

    diffshadow render runs/quickstart 'scene.camera.resolution=[256, 256]'

    diffshadow convert runs/quickstart

Completion of commands and options in bash, zsh and fish: diffshadow --install-completion
"""

app = App(
    name="diffshadow",
    help=_HELP,
    help_format="markdown",
    version=lambda: version("diffshadow"),
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
app.register_install_completion_command(add_to_startup=False)


@app.command
def init(template: str = DEFAULT_TEMPLATE, /, *, mesh: Path | None = None, output: Path | None = None) -> None:
    """Writes a configuration with comments to start from. Its path is the last line printed.

    Example: `diffshadow init three_js --mesh my_mesh.glb`

    Parameters
    ----------
    template
        Name of a template, such as quickstart, three_js, babylon_js or many_views.
    mesh
        Mesh file that replaces the template's meshes; a camera, a light and a ground are found for it.
    output
        Path of the configuration, by default named like the mesh and the template, in the current folder.
    """
    written, notes = write_template(template, mesh, output)
    _print_notes(notes)
    _print_path(written)


@app.command
def fit(config: Path, /, *overrides: str, distributed: bool = False) -> None:
    """Fits the parameters named in CONFIG, and writes values, images and a report.

    The path of the run's folder is the last line printed.

    Example: `diffshadow fit configs/quickstart.yaml fit.solver.max_steps=10`

    Parameters
    ----------
    config
        YAML file, mesh file, folder of a finished run or builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    distributed
        Share the fit among several processes, which SLURM or Open MPI starts with this same command, and all their
        devices. The first of them prints and writes.
    """
    if distributed:
        _join_processes()
        overrides = "fit.devices=0", *overrides
    settings = _loaded(config, overrides, fitting=True)
    _start_jax()
    from . import study

    _print_path(study.run_fit(settings, console=Console()))


@app.command
def render(config: Path, /, *overrides: str, debug: bool = False) -> None:
    """Renders the scene of CONFIG without fitting, and writes the images.

    The path of the run's folder is the last line printed.

    Example: `diffshadow render configs/quickstart.yaml bias.constant=2 --debug`

    Parameters
    ----------
    config
        YAML file, mesh file, folder of a finished run or builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    debug
        Also write images of intermediate results: depths, silhouettes, blockers, patterns, volume counts.
    """
    settings = _loaded(config, overrides)
    _start_jax()
    from . import study

    _print_path(study.run_render(settings, console=Console(), debug=debug))


@app.command
def validate(config: Path, /, *overrides: str, preview: bool = False) -> None:
    """Checks CONFIG, draws its scene, and lists every setting with its unit. Writes no files without --preview.

    Finds every mistake that a render or a fit would report before it traces its reference.

    Example: `diffshadow validate configs/quickstart.yaml filter.type=random_disk`

    Parameters
    ----------
    config
        YAML file, mesh file, folder of a run or builtin:NAME to check.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    preview
        Also write a picture of the scene with its mapped shadow. Its path is the last line printed.
    """
    settings = _loaded(config, overrides, fitting=True)
    _start_jax()
    from . import study

    console = Console()
    checked = study.check(settings, console=console, preview=preview)
    table = Table("setting", "value", "unit", title=Text(settings.name), title_justify="left")
    for row in describe(settings):
        table.add_row(*(Text(printable(cell)) for cell in row))
    console.print(table)
    message = printable(f"{config} is valid; its scene has {checked.triangles:,} triangles")
    console.print(Text(message), soft_wrap=True)
    if checked.preview is not None:
        console.print(f"{checked.shadow:.1%} of the picture is in shadow")
        _print_path(checked.preview)


@app.command
def view(config: Path, /, *overrides: str, port: int = 0, browser: bool = True) -> None:
    """Shows CONFIG in a page of the browser, and draws it again as its settings are dragged. Ctrl-C ends it.

    Example: `diffshadow view configs/quickstart.yaml`

    Parameters
    ----------
    config
        YAML file, mesh file, folder of a finished run or builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `filter.radius=3`.
    port
        Port to listen on, on this machine only; 0 is any free one.
    browser
        Whether to open the page in a browser.
    """
    settings = _loaded(config, overrides)
    _start_jax()
    from .viewer import run

    run(settings, name=str(config), console=Console(), port=port, browser=browser)
    # Threads that draw or trace would delay an ordinary exit.
    sys.stdout.flush()
    os._exit(SUCCESS)


@app.command
def animate(
    source: Path,
    /,
    *settings: str,
    output: Path | None = None,
    frames: int = 60,
    seconds: float = 3.0,
    view: str = "shaded",
    pixels: int = 384 * 288,
) -> None:
    """Writes an animation: of a configuration whose numbers change, or of a finished fit.

    A fit's is put into its folder, and into its report. The path of the animation is the last line printed.

    Example: `diffshadow animate configs/quickstart.yaml scene.light.azimuth=-150:-70`

    Example: `diffshadow animate runs/quickstart`

    Parameters
    ----------
    source
        YAML file, mesh file or builtin:NAME with changing numbers, or the folder of a fit without.
    settings
        KEY=FROM:TO of numbers that change, all at once, and KEY=VALUE of others.
    output
        Path of the animation: .webp, .gif or .png. By default NAME.webp in the current folder, or the fit's folder.
    frames
        Number of frames.
    seconds
        Seconds that they take.
    view
        What is shown, such as shaded, visibility, error or "shadow map".
    pixels
        Most pixels of a frame, which keeps the camera's aspect.
    """
    _check_count("--frames", frames, 2, _MAX_FRAMES)
    _check_count("--pixels", pixels, 1, MAX_TEXELS**2)
    if not 0 < seconds < _MAX_FRAMES:
        raise ValueError(f"--seconds is {seconds:g}; expected more than 0 and less than {_MAX_FRAMES}; change it")
    changes = [found.groups() for each in settings if (found := _CHANGE.fullmatch(each))]
    overrides = [each for each in settings if not _CHANGE.fullmatch(each)]
    if not changes and not source.is_dir():
        raise ValueError(
            f"no number of {source} changes; expected KEY=FROM:TO, such as scene.light.azimuth=-150:-70, or the folder "
            "of a fit"
        )
    if not changes:
        if overrides:
            raise ValueError(f"{overrides[0]} sets a value of a finished fit; expected its folder alone; leave it out")
        _start_jax()
        from . import viewer

        _print_path(viewer.animate_run(source, output, pixels=pixels))
        return
    settled = _loaded(source, overrides)
    _start_jax()
    from . import viewer

    with _counting("drawing frames") as progress:
        file = Path(f"{settled.name}.webp") if output is None else output
        moving = [viewer.Change(key, float(first), float(last)) for key, first, last in changes]
        how: Any = {"frames": frames, "seconds": seconds, "view": view, "pixels": pixels}
        made = viewer.animate(settled, moving, file, **how, progress=progress)
    if made.flicker is not None:
        Console().print(f"flicker {made.flicker:.4f}: the error's RMS change from frame to frame", soft_wrap=True)
    _print_path(made.path)


@app.command
def convert(config: Path, /, *overrides: str) -> None:
    """Prints the bias and the radius of CONFIG in the units of three.js, Babylon.js, Godot, Bevy, Filament and Unity.

    Of a finished fit, it converts the fitted values. To a bias that engines lack, such as a slope or a receiver plane,
    it fits the shadows of three.js and Babylon.js, which takes as long as two fits, and says how to fit what another
    engine has. The technique may be three.js' or Babylon.js' own.

    Example: `diffshadow convert runs/quickstart`

    Example: `diffshadow convert configs/quickstart.yaml bias.slope=0 bias.constant=1.5`

    Parameters
    ----------
    config
        YAML file with technique type shadow_map, three.js or babylon.js, mesh file, folder of a finished run or
        builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `bias.constant=2`.
    """
    file, origin = settings_file(config)
    settings = load_config(file, overrides)
    _print_notes(settings.notes)
    origin += f", with {' '.join(overrides)}" if overrides else ""
    _start_jax()
    from . import study

    study.convert(settings, console=Console(), origin=origin, source=config, overrides=overrides)


@app.command
def defaults(
    *,
    filter: str | None = None,
    radius: float | None = None,
    engine: EngineName | None = None,
    map: int | None = None,
    window: float | None = None,
    depth: float | None = None,
) -> None:
    """Prints rules of thumb: biases that hold over many scenes, and what they cost against a fit.

    Example: `diffshadow defaults --filter random_disk --radius 3`

    Example: `diffshadow defaults --engine godot --map 2048 --window 40 --depth 100`

    Parameters
    ----------
    filter
        Type of a filter, such as pcf, whose bias is printed as a part of a configuration.
    radius
        Its radius in texels.
    engine
        Engine whose settings are printed, for its default filter and a directional light.
    map
        Texels along a side of the engine's map.
    window
        How wide the light's shadow camera is, in world units.
    depth
        Its far plane less its near plane, in world units.
    """
    from . import study

    study.print_defaults(
        console=Console(), filter=filter, radius=radius, engine=engine, size=map, window=window, depth=depth
    )


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
    _check_count("--workers", workers, 0, _MAX_WORKERS_PER_CORE * (os.cpu_count() or 1))
    _check_count("--limit", limit, 1)
    with _counting("checking runs", _RUNS_PER_UPDATE) as progress:
        plan = load_sweep(_file_of(config, sweep=True), overrides, check=not dry_run, progress=progress)
    _start_jax()
    from . import study

    if dry_run:
        study.print_plan(Console(), plan, limit)
        return
    done = study.run_sweep(plan, console=Console(), scheduler=scheduler, workers=workers, limit=limit)
    _print_path(done)


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
    _check_count("--workers", workers, 0, _MAX_WORKERS_PER_CORE * (os.cpu_count() or 1))
    file = _file_of(config)
    if engine is None:
        with _counting("checking runs", _RUNS_PER_UPDATE) as progress:
            advice = load_advice(file, overrides, progress=progress)
        _start_jax()
        from . import study
    else:
        # Its mistakes are reported before JAX is loaded.
        _print_notes(load_config(file, overrides).notes)
        _start_jax()
        from . import study

        with _counting("checking runs", _RUNS_PER_UPDATE) as progress:
            advice = study.engine_advice(file, overrides, engine, console=Console(), progress=progress)
    if dry_run:
        study.print_advise_plan(Console(), advice)
        return
    _print_path(study.run_advise(advice, console=Console(), scheduler=scheduler, workers=workers))


@app.command
def report(folder: Path, /, *, figures: Literal["png", "svg", "pdf"] | None = None, dpi: int = 150) -> None:
    """Rewrites the page of a finished run, sweep or recommendation from the files in FOLDER.

    The path of the page is the last line printed.

    Example: `diffshadow report runs/quickstart --figures pdf`

    Parameters
    ----------
    folder
        Folder of a fit, a render, a sweep or a recommendation.
    figures
        Also rewrite the run's figures, in this format; the shadow map and debug views are kept.
    dpi
        Pixels per inch in these figures.
    """
    from . import study

    _print_path(study.report(folder, form=figures, dpi=dpi))


@app.command(name="import")
def import_(
    scene: Path,
    /,
    *,
    camera: str | None = None,
    light: str | None = None,
    technique: ImportedTechnique = "three.js",
    shadow_type: ShadowType = ThreeJs.shadow_type,
    output: Path | None = None,
) -> None:
    """Makes a configuration of SCENE, a file that three.js or another program stored: JSON of scene.toJSON(), GLB or
    glTF 2.0.

    Says what is taken over, and what is left out or otherwise than in the scene. The path of the configuration is the
    last line printed.

    Example: `diffshadow import scene.json --output scene`

    Parameters
    ----------
    scene
        The scene's file.
    camera
        Name of the camera, by default the first; or the file of a scene that holds one.
    light
        Name of the light, by default the first that casts shadows.
    technique
        Technique of the configuration; three.js takes the settings of the light's shadow over.
    shadow_type
        Type of renderer.shadowMap, which no scene's file holds.
    output
        Folder for the configuration and its meshes, by default one named like the file, in the current folder.
    """
    from . import study

    made = study.import_scene(
        scene,
        console=Console(),
        camera=camera,
        light=light,
        technique=technique,
        shadow_type=shadow_type,
        output=output,
    )
    _print_path(made)


@app.command
def compare(first: Path, second: Path, /, *more: Path, output: Path = Path("compare.html")) -> None:
    """Prints the differences between finished runs, and writes a page with their images side by side.

    The path of the page is the last line printed.

    Example: `diffshadow compare runs/quickstart runs/spot --output comparison.html`

    Parameters
    ----------
    first
        Folder of a fit or a render.
    second
        Folder of another one.
    more
        Folders of further ones.
    output
        Path of the page. An existing file is replaced.
    """
    if output.is_dir():
        raise ValueError(
            f"--output is {output}, a folder; expected the path of a page; name a file such as compare.html"
        )
    from . import study

    _print_path(study.compare([first, second, *more], output, console=Console()))


@app.command
def cache(*, clear: bool = False) -> None:
    """Says where traced references and compiled programs are kept, and how much they take.

    Each kind takes at most 2 GiB: beyond that, the least recently used are removed. The folder is $DIFFSHADOW_CACHE, by
    default `diffshadow` in the user's cache folder.

    Example: `diffshadow cache --clear`

    Parameters
    ----------
    clear
        Remove them all. Later runs trace and compile again.
    """
    from . import io

    console = Console()
    table = Table("kept", "entries", "MiB", "folder")
    for what, folder in (("traced references", io.cache_folder()), ("compiled programs", io.programs_folder())):
        entries, size = io.cache_size(folder)
        table.add_row(what, f"{entries:,}", f"{size / (1 << 20):,.1f}", Text(printable(str(folder)), overflow="fold"))
        if clear:
            io.clear_cache(folder)
    console.print(table)
    console.print("removed all of them" if clear else "to remove them: diffshadow cache --clear")


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs the command with `arguments`, by default the process's own, and exits.

    The exit code is 0 on success, 2 on a mistake of the user's, which is reported in one message on stderr, and 130
    after an interrupt. Any other error is a bug, and keeps its traceback.
    """
    # Without JAX, which `_start_jax` loads.
    setup(programs=False, progress=False)
    errors = Console(stderr=True)
    for stream in (sys.stdout, sys.stderr):
        # The stream's encoding may lack characters of names.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with reported_interrupts(), repeated_interrupts():
            app(
                sys.argv[1:] if arguments is None else list(arguments),
                exit_on_error=False,
                print_error=False,
                error_console=errors,
            )
    except CycloptsError as error:
        _print_error(errors, [f"{_sentence(error)}; see diffshadow --help"])
        sys.exit(USER_ERROR)
    except KeyboardInterrupt:
        _print_error(errors, ["interrupted"])
        sys.exit(INTERRUPTED)
    except (ValueError, OSError) as error:
        if not _is_mistake(error):
            raise
        _print_error(errors, map(str, error.mistakes) if isinstance(error, ConfigError) else [str(error)])
        sys.exit(USER_ERROR)
    except (MemoryError, RuntimeError) as error:
        # XLA raises a `RuntimeError` whose text alone names the cause.
        if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):
            raise
        _print_error(errors, [_NO_MEMORY])
        sys.exit(USER_ERROR)
    sys.exit(SUCCESS)


def _file_of(given: Path, *, sweep: bool = False) -> Path:
    """The configuration's file. Of a run's folder, the one with the values that the run found, which is said.

    **Arguments:**

    - `sweep`: whether the folder may be of a sweep, whose own configuration is meant.
    """
    if not given.is_dir():
        return given
    file, origin = settings_file(given, sweep=sweep)
    _print_notes([f"the values are taken from {origin}"])
    return file


def _loaded(given: Path, overrides: Sequence[str], *, fitting: bool = False) -> Config:
    """The configuration of a run. Says what was found for it."""
    settings = load_config(_file_of(given), overrides, fitting=fitting)
    _print_notes(settings.notes)
    return settings


def _print_notes(notes: Iterable[str]) -> None:
    for note in notes:
        Console().print(Text(printable(f"note: {note}")), soft_wrap=True)


def _check_count(option: str, value: int | None, least: int, most: int | None = None) -> None:
    if value is not None and (value < least or (most is not None and value > most)):
        limits = f"at least {least}" + ("" if most is None else f" and at most {most}")
        raise ValueError(f"{option} is {value}; expected a whole number {limits}; change it, or leave it out")


@contextlib.contextmanager
def _counting(name: str, every: int = 1) -> Iterator[Callable[[int, int], None]]:
    """A progress bar, called with the number done and of all. It moves with `every` so many, and only on a terminal."""
    console = Console()
    bar = Progress(
        TextColumn(name),
        BarColumn(bar_width=40),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = bar.add_task("")

    def progress(done: int, total: int) -> None:
        if done % every == 0:
            bar.start()
            bar.update(task, completed=done, total=total)

    try:
        yield progress
    finally:
        bar.stop()


def _start_jax() -> None:
    """Starts JAX's backend, with a cache of the programs that it compiles.

    **Raises** `ValueError` if it cannot run on the platforms that the environment names.
    """
    setup(cores=False, memory=False, collector=False, progress=False)
    platforms = os.environ.get("JAX_PLATFORMS")
    if not platforms:
        return
    import jax

    try:
        jax.devices()
    except (AssertionError, RuntimeError) as error:
        raise ValueError(
            f"JAX cannot run on JAX_PLATFORMS={platforms}; expected platforms whose plugins are installed, such as "
            "cpu: change it, or unset it"
        ) from error


def _join_processes() -> None:
    """Makes this process one of several that JAX knows. All but the first print only errors.

    **Raises** `ValueError` unless a launcher has started several processes.
    """
    import jax

    try:
        jax.distributed.initialize()
    except (ValueError, RuntimeError) as error:
        raise ValueError(
            f"JAX finds no other processes for --distributed ({str(error).rstrip('.')}); expected several that SLURM "
            "or Open MPI started, as by srun diffshadow fit CONFIG --distributed: leave it out, or start the processes "
            "in Python with jax.distributed.initialize"
        ) from error
    if jax.process_index() > 0:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115


def _is_mistake(error: ValueError | OSError) -> bool:
    """Whether `error` is a mistake of the user's rather than a bug in this program.

    This package raises `ValueError` only for mistakes of the user's. A `ValueError` raised inside a library is a bug.
    """
    if isinstance(error, ConfigError | OSError):
        return True
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    module = str(frames[-1].f_globals.get("__name__", ""))
    return module.partition(".")[0] == __name__.partition(".")[0]


def _sentence(error: CycloptsError) -> str:
    text = " ".join(str(error).split())
    return text if text.endswith("...") else text.removesuffix(".")


def _print_error(console: Console, messages: Iterable[str]) -> None:
    """Prints an error, with one line per message."""
    # Without wrapping, so that editors and grep find FILE:LINE in one piece.
    lines = "\n".join(map(printable, messages))
    console.print(Text.assemble(("error: ", "bold red"), lines), soft_wrap=True)


def _print_path(path: Path) -> None:
    Console().print(Text(printable(str(path))), soft_wrap=True)
