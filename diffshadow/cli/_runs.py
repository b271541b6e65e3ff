"""Commands for single runs: init, validate, render, fit; and cache, for what runs keep."""

from pathlib import Path

from rich.table import Table
from rich.text import Text

from .._words import counted
from ..config import DEFAULT_TEMPLATE, describe, printable, write_template
from ..console import Console, print_table
from ._app import app, loaded, print_end, print_notes, to_try
from ._jax import join_processes, start_jax


@app.command
def init(template: str = DEFAULT_TEMPLATE, /, *, mesh: Path | None = None, output: Path | None = None) -> None:
    """Writes a configuration with comments to start from. The path of the configuration is the last line printed.

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
    print_notes(notes)
    print_end(written, to_try(written))


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
        join_processes()
        overrides = "fit.devices=0", *overrides
    settings = loaded(config, overrides, fitting=True)
    start_jax()
    from .. import study

    folder = study.run_fit(settings, console=Console(names_stages=True))
    print_end(folder, study.next_after(folder))


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
    settings = loaded(config, overrides)
    start_jax()
    from .. import study

    folder = study.run_render(settings, console=Console(names_stages=True), debug=debug)
    print_end(folder, study.next_after(folder))


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
        Also write a picture of the scene with its mapped shadow. The picture's path is the last line printed.
    """
    settings = loaded(config, overrides, fitting=True)
    start_jax()
    from .. import study

    console = Console()
    checked = study.check(settings, console=console, preview=preview)
    table = Table("setting", "value", "unit", title=Text(settings.name), title_justify="left")
    for row in describe(settings):
        table.add_row(*(Text(printable(cell)) for cell in row))
    print_table(console, table)
    message = printable(f"{config} is valid; its scene has {counted(checked.triangles, 'triangle')}")
    console.print(Text(message), soft_wrap=True)
    if checked.preview is not None:
        console.print(f"{checked.shadow:.1%} of the picture is in shadow")
    print_end(checked.preview, to_try(config, overrides))


@app.command
def cache(*, clear: bool = False) -> None:
    """Prints where traced references and compiled programs are cached, and their size.

    Each kind takes at most 2 GiB: beyond that, the least recently used are removed. The folder is $DIFFSHADOW_CACHE, by
    default `diffshadow` in the user's cache folder.

    Example: `diffshadow cache --clear`

    Parameters
    ----------
    clear
        Remove them all. Later runs trace and compile again.
    """
    from .. import io

    console = Console()
    table = Table("kept", "entries", "MiB", "folder")
    for what, folder in (("traced references", io.cache_folder()), ("compiled programs", io.programs_folder())):
        entries, size = io.cache_size(folder)
        table.add_row(what, f"{entries:,}", f"{size / (1 << 20):,.1f}", Text(printable(str(folder))))
        if clear:
            io.clear_cache(folder)
    print_table(console, table)
    console.print("removed all of them" if clear else "to remove them: diffshadow cache --clear")
