"""What to do after a run: commands that its page ends with."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ...config import CONFIG_FILE, FITTED_FILE, RECOMMENDED_FILE
from ..record._folder import final_folder
from ..record._runs import FitRecord, FolderRecord

# The technique whose bias the command convert reads.
_CONVERTED = "shadow_map"


class Command(NamedTuple):
    """A command to copy.

    - `why`: what it does, in a sentence; `text`: the command.
    """

    why: str
    text: str


def _command(why: str, verb: str, *arguments: Path | str) -> Command:
    # A page cannot know the folder in which its commands are pasted.
    words = (str(each.absolute()) if isinstance(each, Path) else each for each in arguments)
    return Command(why, shlex.join(["diffshadow", verb, *words]))


def _figures(folder: Path) -> Command:
    return _command("Write the figures again, for a paper.", "report", folder, "--figures", "pdf")


def _again(command: str | None) -> list[Command]:
    return [Command("Run it again.", command)] if command else []


def after_run(folder: Path, record: FolderRecord, technique: str | None = None) -> list[Command]:
    """The commands after a fit or a render.

    **Arguments:**

    - `folder`: of the run, with its files; `record`: of the run.
    - `technique`: that was fitted to visibility or rendered; none without a configuration.
    """
    place, again = final_folder(folder), _again(record.command)
    if technique is None:
        return [_figures(place), *again]
    is_fit, is_fitted = isinstance(record, FitRecord), (folder / FITTED_FILE).is_file()
    commands = []
    if not is_fit:
        commands.append(_command("Fit its bias and its filter.", "fit", place / CONFIG_FILE))
    if is_fitted:
        why = "Draw the fitted shadow, with intermediate results."
        commands.append(_command(why, "render", place / FITTED_FILE, "--debug"))
    if technique == _CONVERTED and (is_fitted or not is_fit):
        commands.append(_command("Convert the bias to the units of engines.", "convert", place))
        if is_fit:
            commands.append(_command("Try other biases and filters on these views.", "advise", place / CONFIG_FILE))
    return [*(commands or [_figures(place)]), *again]


def after_comparison(folders: Sequence[Path], page: Path) -> list[Command]:
    """The commands after a comparison of the runs in `folders`, whose page is `page`."""
    return [
        *(_figures(folder)._replace(why=f"Write the figures of {folder.name} again.") for folder in folders[:2]),
        _command("Compare them again.", "compare", *folders, "--output", page),
    ]


def after_advice(folder: Path, command: str) -> list[Command]:
    """The commands after a recommendation in `folder`, which `command` made."""
    return [
        _command("Fit the recommended technique.", "fit", folder / RECOMMENDED_FILE),
        _command("Draw it, with all pictures.", "render", folder / RECOMMENDED_FILE),
        *_again(command),
    ]


def after_sweep(folder: Path, kind: str, best: Path | None, command: str) -> list[Command]:
    """The commands after a sweep.

    **Arguments:**

    - `folder`: of the sweep; `kind`: `"fit"` or `"render"`.
    - `best`: the folder of the run with the least RMSE, if there is one.
    - `command`: the sweep's command.
    """
    run = (
        []
        if best is None
        else [_command("Do the run with the least RMSE, with all pictures.", kind, best / CONFIG_FILE)]
    )
    return [*run, _figures(folder), *_again(command)]
