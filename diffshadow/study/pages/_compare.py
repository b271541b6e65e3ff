"""Compares runs: a page with their images side by side, and a table of their differences."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ... import io
from ..._checks import text_within
from ..record._stored import VisibilityRun, is_fit, read_run
from . import _table as table
from ._next import after_comparison
from ._table import ERRORS, UNITS, number, print_comparison

# A run's name and folder do not count as differences.
_NOT_COMPARED = ("name", "output")
_NONE = "–"
# Settings that define the scene or its reference, and the maximum number of them that a remark names.
_SCENE = ("scene.", "reference.path")
_MAX_KEYS = 4


class Line(NamedTuple):
    """One row of the comparison: its name and unit, a text for each run, and the indices of the best runs."""

    name: str
    unit: str
    cells: list[str]
    best: frozenset[int] = frozenset()


def compare(folders: Sequence[Path], page: Path, *, console: Console) -> Path:
    """Prints the differences between the finished runs in `folders`, and writes them with the images to `page`.

    **Returns** the page.

    **Raises** `FileError` if a folder has no finished run or the page cannot be written. **Raises** `ValueError` if
    there are fewer than two folders or a folder is given twice.
    """
    resolved = [folder.resolve() for folder in folders]
    if len(set(resolved)) < max(len(resolved), 2):
        given = ", ".join(map(str, folders)) or "none"
        raise ValueError(f"the runs to compare are {given}; expected two or more, each once")
    io.check_writable(page.parent)
    runs = [read_run(folder) for folder in folders]
    labels = _labels(folders)
    parts = {
        "settings that differ": _settings(runs),
        "fitted values": _fitted(runs),
        "errors": _errors(runs),
    }
    print_comparison(
        console, labels, [[(line.name, *line.cells, line.unit) for line in part] for part in parts.values()]
    )
    remarks = _scene_remarks(runs, parts["settings that differ"])
    table.print_lines(console, remarks, warn=True)
    page.parent.mkdir(parents=True, exist_ok=True)
    _write(page, runs, labels, parts, remarks)
    return page


def _labels(folders: Sequence[Path]) -> list[str]:
    """Unique names of the runs: the names of their folders, or the whole paths if the names are not unique."""
    names = [folder.resolve().name for folder in folders]
    return [name if names.count(name) == 1 else str(folder) for name, folder in zip(names, folders, strict=True)]


def _settings(runs: Sequence[VisibilityRun[Any]]) -> list[Line]:
    settings = [{row.key: row for row in run.settings if row.key not in _NOT_COMPARED} for run in runs]
    kinds = [run.record.kind for run in runs]
    lines = [Line("kind of run", "", kinds)] if len(set(kinds)) > 1 else []
    for key in dict.fromkeys(key for each in settings for key in each):
        cells = [each[key].value if key in each else _NONE for each in settings]
        # A fit made in Python has no settings to compare.
        if len({cell for cell, each in zip(cells, settings, strict=True) if each}) > 1:
            lines.append(Line(key, next(each[key].unit for each in settings if key in each), cells))
    return lines


def _fitted(runs: Sequence[VisibilityRun[Any]]) -> list[Line]:
    fits = [run.record for run in runs if is_fit(run)]
    values = [run.record.fitted if is_fit(run) else {} for run in runs]
    bounds = {name: bound for fit in fits for name, bound in fit.bounds.items()}
    text = lambda name, value: text_within(value, bounds[name].lower, bounds[name].upper)
    return [
        Line(name, bounds[name].unit, [text(name, each[name]) if name in each else _NONE for each in values])
        for name in dict.fromkeys(name for each in values for name in each)
    ]


def _errors(runs: Sequence[VisibilityRun[Any]]) -> list[Line]:
    """The errors of the results, with the best runs marked."""
    last = [run.errors[-1][1] for run in runs]
    lines = []
    for name, label in ERRORS.items():
        values = np.asarray([getattr(errors, name) for errors in last], np.float64)
        cells = [number(name, value) for value in values]
        cost = np.where(np.isnan(values), np.inf, -values if name == "ssim" else values)
        # Values that print the same are equally good.
        best = frozenset(i for i, cell in enumerate(cells) if cell == cells[int(np.argmin(cost))])
        lines.append(Line(label, UNITS[name], cells, best if len(best) < len(runs) else frozenset()))
    return lines


def _scene_remarks(runs: Sequence[VisibilityRun[Any]], differing: Sequence[Line]) -> list[str]:
    """A remark that the runs have different scenes or references, if they do. Their errors then do not rank techniques.

    Runs with the same reference images show the same scene. The parameters of a fit, such as a light's pose, do not
    count as a difference.
    """
    images = [[light.reference for light in run.lights] for run in runs]
    if all(len(each) == len(images[0]) and all(map(np.array_equal, each, images[0])) for each in images):
        return []
    sizes = list(dict.fromkeys(f"{len(each)} of {each[0].shape[1]} × {each[0].shape[0]}" for each in images))
    fitted = {name for run in runs if is_fit(run) for name in run.record.fitted}
    keys = [line.name for line in differing if line.name.startswith(_SCENE) and line.name not in fitted]
    if not keys and len(sizes) > 1:
        keys = [f"images: {', '.join(sizes)} pixels"]
    if not keys:
        return []
    more = f" and {len(keys) - _MAX_KEYS} more" if len(keys) > _MAX_KEYS else ""
    named = f"{', '.join(keys[:_MAX_KEYS])}{more}"
    return [f"the runs are of different scenes or references ({named}); their errors do not rank their techniques"]


def _warnings(run: VisibilityRun[Any]) -> list[str]:
    """The remarks on a run. The first is that a fit does not explain its references."""
    said = run.record.said
    unexplained = [said.sentence] if said is not None and not run.record.is_explained else []
    return [*unexplained, *(run.record.warnings or [])]


def _write(
    page: Path,
    runs: Sequence[VisibilityRun[Any]],
    labels: Sequence[str],
    parts: dict[str, list[Line]],
    remarks: Sequence[str],
) -> None:
    # Imported here because they load Matplotlib.
    from .. import style
    from . import _figures as figures
    from ._page import difference_scale, picture, write_page

    limit, extend = figures.difference_limit([light for run in runs for light in run.shown], slice(-1, None))
    groups = list(_groups(runs, labels, limit))
    shaded = [
        picture(f"{label}, shaded", run.shaded[-1][1], title=label) for label, run in _named(labels, runs) if run.shaded
    ]
    fits = [(label, run) for label, run in _named(labels, runs) if is_fit(run)]
    pictures = [p.name for p in groups[0]["visibility"]]
    write_page(
        page,
        "compare.html.j2",
        labels=labels,
        folders=[str(run.folder) for run in runs],
        # Results come first.
        parts_of_table=dict(reversed(parts.items())),
        warnings=[
            *remarks,
            *(f"{label}: {warning}" for label, run in _named(labels, runs) for warning in _warnings(run)),
        ],
        slides=([p.name for p in shaded] if len(shaded) > 1 else pictures)[-2:],
        commands=after_comparison([run.folder for run in runs], page),
        groups=groups,
        scale=difference_scale(limit, extend == "both"),
        shaded=shaded,
        curves=style.inline_svg(figures.convergence(fits), "convergence") if fits else "",
    )


def _named(labels: Sequence[str], runs: Sequence[VisibilityRun[Any]]) -> Iterator[tuple[str, VisibilityRun[Any]]]:
    return zip(labels, runs, strict=True)


def _groups(runs: Sequence[VisibilityRun[Any]], labels: Sequence[str], limit: float) -> Iterator[dict[str, Any]]:
    """The images of each light: the distinct references, and each run's result and its difference."""
    from .. import style
    from ._page import picture

    for index in range(max(len(run.shown) for run in runs)):
        lit = [(label, run.shown[index]) for label, run in _named(labels, runs) if index < len(run.shown)]
        end = f", {lit[0][1].key}" if index or any(len(run.shown) > 1 for run in runs) else ""
        visibility, differences, references = [], [], []
        for label, light in lit:
            truth = np.where(light.mask, light.reference, np.nan)
            if not any(np.array_equal(light.reference, other) for other in references):
                title = "Reference" if not references else f"Reference of {label}"
                visibility.insert(len(references), picture(f"{title}{end}", truth, title=title))
                references.append(light.reference)
            image = np.where(light.mask, light.images[-1][1], np.nan)
            note = f"RMSE {number('rmse', light.errors[-1].rmse)}"
            visibility.append(picture(f"{label}{end}", image, note, title=label))
            name = f"{label} − reference"
            differences.append(
                picture(f"{name}{end}", image - truth, title=name, colours=style.DIFFERENCE, limit=limit)
            )
        yield {"key": lit[0][1].key, "visibility": visibility, "differences": differences}
