"""The commands to run after a run. Its page shows them, and the terminal prints them."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from ...config import CONFIG_FILE, FITTED_FILE, RECOMMENDED_FILE
from ...console import Command, to_view
from ...settings.engines import ENGINES, EngineName
from ..record._folder import final_folder
from ..record._runs import FitRecord, FolderRecord

# The technique that the command convert reads the bias of.
_CONVERTED = "shadow_map"
_SCENE = "builtin:quickstart"
_FIRST_ENGINE: EngineName = "three.js"
_OTHERS = ", ".join(name for name in ENGINES if name != _FIRST_ENGINE)


def for_engine(source: Path | str, overrides: Sequence[str] = (), engine: EngineName | None = None) -> Command:
    """The command that recommends settings of an engine for the views of `source`. Without an engine, it is for
    three.js, and the sentence names the other engines."""
    name = engine or _FIRST_ENGINE
    others = "" if engine else f"; or for {_OTHERS}"
    why = f"Find the best bias and filter for {ENGINES[name]}, with code to paste{others}."
    return Command(why, ["advise", source, *overrides, "--engine", name])


def to_convert(source: Path | str, overrides: Sequence[str] = ()) -> Command:
    """The command that prints the bias of `source` for engines."""
    return Command("Convert the bias to the units of engines.", ["convert", source, *overrides])


def _figures(folder: Path) -> Command:
    return Command("Write the figures again, for a paper.", ["report", folder, "--figures", "pdf"])


def after_run(folder: Path, record: FolderRecord, technique: str | None = None) -> list[Command]:
    """The commands after a fit or a render. The most useful command comes first.

    **Arguments:**

    - `folder`: the run's folder, with its files; `record`: the run's record.
    - `technique`: the technique that was fitted to visibility or rendered, or `None` without a configuration.
    """
    place, is_fit, is_fitted = final_folder(folder), isinstance(record, FitRecord), (folder / FITTED_FILE).is_file()
    again = []
    if getattr(record, "command", None) is not None:
        again = [Command("Run it again.", ["render" if record.kind == "render" else "fit", place / CONFIG_FILE])]
    if technique is None:
        return [_figures(place), *again]
    commands = []
    has_bias = technique == _CONVERTED or technique in ENGINES
    if not is_fit:
        commands += [Command("Fit its bias and its filter.", ["fit", place / CONFIG_FILE]), to_view(place)]
    if has_bias and (is_fitted or not is_fit):
        commands.append(to_convert(place))
    if is_fitted:
        if has_bias:
            engines: dict[str, EngineName] = {name: name for name in ENGINES}
            commands.append(for_engine(place, engine=engines.get(technique)))
        commands.append(to_view(place))
        why = "Draw the fitted shadow, with intermediate results."
        commands.append(Command(why, ["render", place / FITTED_FILE, "--debug"]))
        if technique == _CONVERTED:
            commands.append(Command("Try other biases and filters on these views.", ["advise", place / CONFIG_FILE]))
    elif is_fit:
        commands += [Command("Write an animation of the fit.", ["animate", place]), _figures(place)]
    return [*commands, *again]


def after_comparison(folders: Sequence[Path], page: Path) -> list[Command]:
    """The commands after a comparison of the runs in `folders`, whose page is `page`."""
    return [
        *(_figures(folder)._replace(why=f"Write the figures of {folder.name} again.") for folder in folders[:2]),
        Command("Compare them again.", ["compare", *folders, "--output", page]),
    ]


def _again(command: str) -> Command:
    """The command of a sweep, with absolute paths."""
    return Command("Run it again; finished runs are kept.", shlex.split(command)[1:])


def after_advice(folder: Path, engine: EngineName | None, command: str) -> list[Command]:
    """The commands after a recommendation in `folder`, for an engine or for any renderer. `command` made the
    recommendation."""
    recommended = folder / RECOMMENDED_FILE
    others = [for_engine(recommended)] if engine is None else []
    return [
        *others,
        to_view(recommended),
        Command("Draw it, with all pictures.", ["render", recommended]),
        Command("Fit the recommended technique again.", ["fit", recommended]),
        _again(command),
    ]


def after_sweep(folder: Path, kind: str, best: Path | None, command: str) -> list[Command]:
    """The commands after a sweep.

    **Arguments:**

    - `folder`: the sweep's folder; `kind`: `"fit"` or `"render"`.
    - `best`: the folder of the run with the lowest RMSE, if there is one.
    - `command`: the sweep's command.
    """
    why = "Repeat the run with the lowest RMSE, with all pictures."
    run = [] if best is None else [Command(why, [kind, best / CONFIG_FILE]), to_view(best / CONFIG_FILE)]
    return [*run, _figures(folder), _again(command)]


def after_defaults(filter: str | None, radius: float | None, engine: EngineName | None) -> list[Command]:
    """The commands after rules of thumb for the `filter` and the `engine`. They fit the package's scene, because the
    user's scene is unknown."""
    overrides = [] if filter is None else [f"filter.type={filter}"]
    overrides += [] if radius is None else [f"filter.radius={radius:g}"]
    why = "Fit the bias to a scene; replace builtin:quickstart with your mesh file."
    return [
        Command(why, ["fit", _SCENE, *overrides]),
        for_engine(_SCENE, engine=engine),
    ]
