"""The command's program, and what its commands share."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

from cyclopts import App
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from ..config import Config, load_config, printable, settings_file
from ..console import Command, Console, print_next, source, to_view

SUCCESS, USER_ERROR, INTERRUPTED = 0, 2, 130
"""Exit codes: success; a mistake of the user's; stopped by Ctrl-C."""

# So many commands are printed at the end of one.
_MOST_NEXT = 3

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


def file_of(given: Path, *, sweep: bool = False) -> Path:
    """The configuration's file. For a run's folder, it is the file with the values that the run found, and the command
    prints its name.

    **Arguments:**

    - `sweep`: whether the folder of a sweep is allowed, as the sweep's configuration.
    """
    if not given.is_dir():
        return given
    file, origin = settings_file(given, sweep=sweep)
    print_notes([f"the values are taken from {origin}"])
    return file


def loaded(given: Path, overrides: Sequence[str], *, fitting: bool = False) -> Config:
    """The configuration of a run. Prints what was found for the parts that the configuration leaves out."""
    settings = load_config(file_of(given), overrides, fitting=fitting)
    print_notes(settings.notes)
    return settings


def print_notes(notes: Iterable[str]) -> None:
    for note in notes:
        Console().print(Text(printable(f"note: {note}")), soft_wrap=True)


def print_path(path: Path) -> None:
    Console().print(Text(printable(str(path))), soft_wrap=True)


def print_end(path: Path | None, commands: Sequence[Command]) -> None:
    """Prints what to do next; the last line is the path that a command wrote, for scripts."""
    print_next(Console(), commands[:_MOST_NEXT])
    if path is not None:
        print_path(path)


def to_try(config: Path, overrides: Sequence[str] = ()) -> list[Command]:
    """What to do with a configuration that is new."""
    given = source(config)
    return [
        Command("Fit its settings; a report shows the result.", ["fit", given, *overrides]),
        to_view(given, overrides),
        Command("Draw it without fitting.", ["render", given, *overrides]),
    ]


def check_count(option: str, value: int | None, least: int, most: int | None = None) -> None:
    if value is not None and (value < least or (most is not None and value > most)):
        limits = f"at least {least}" + ("" if most is None else f" and at most {most}")
        raise ValueError(f"{option} is {value}; expected a whole number {limits}; change it, or leave it out")


@contextlib.contextmanager
def counting(name: str, every: int = 1) -> Iterator[Callable[[int, int], None]]:
    """A progress bar, which is called with the finished number and the total. It moves after every `every` items, and
    only on a terminal."""
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
