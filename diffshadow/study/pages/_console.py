"""Prints a run's record when the run ends."""

from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ..._checks import text_within
from ..._words import counted
from ...console import print_table
from ...fit import FitResult
from ..record import _runs as records
from ._table import (
    ERRORS,
    UNITS,
    cells,
    interval_text,
    knee_text,
    noise_text,
    print_code,
    print_lines,
    within_text,
    words,
)

"""The name of the file with an engine's code in a run's folder."""
# The console lists the losses of at most this many starts.
_MAX_STARTS = 8


def print_run(console: Console, record: records.FolderRecord, seconds: float, result: FitResult | None = None) -> None:
    """Prints a finished run.

    **Arguments:**

    - `seconds`: the total time.
    - `result`: the result of a fit of numbers. It does not record how its values were chosen.
    """
    if record.said is not None:
        print_lines(console, [record.said.sentence, *record.said.remedies], warn=not record.is_explained)
    match record:
        case records.RenderRecord():
            print_render(console, record)
            lines = [noise_text(record.metrics.reference_noise_floor)]
        case records.FitRecord():
            lines = _print_fit(console, record, seconds, result)
        case records.PictureRecord():
            print_picture(console, record)
            lines = [f"{counted(record.steps, 'step')}, {seconds:.1f} s in all"]
        case records.ShapeRecord():
            lines = [*print_shape(console, record), f"{seconds:.1f} s in all"]
    if result is not None and (
        isinstance(record, records.PictureRecord) or (isinstance(record, records.FitRecord) and record.poses)
    ):
        print_values(console, record)
        _print_starts(console, result)
    print_lines(console, lines)
    if isinstance(record, records.FitRecord):
        for key, code in record.code.items():
            print_code(console, f"{record.code_file}, for {key}:", code)
    print_lines(console, record.warnings or [], warn=True)


def _print_fit(console: Console, record: records.FitRecord, seconds: float, result: FitResult | None) -> list[str]:
    """Prints the tables of a fit. **Returns** the sentences to print below them."""
    print_fit(console, record)
    if record.profiles:
        print_profiles(console, record.profiles, record.fitted)
        if result is not None and result.sureness.prefer:
            chosen = "fit.prefer chose among values with at most"
            print_lines(console, [f"{chosen} {100 * result.sureness.tolerance:.3g} % more than the lowest error"])
    if record.front:
        print_front(console, record.front)
    if record.metrics.validation is not None:
        count = sum(bool(light.validation) for light in record.metrics.lights)
        print_validation(console, count, record.metrics.validation)
    noise = noise_text(record.metrics.reference_noise_floor)
    steps = counted(record.solver.steps, "step")
    return [f"errors are under the hard compare; {noise}", f"{steps}, {seconds:.1f} s in all"]


def print_fit(console: Console, record: records.FitRecord) -> None:
    """Prints the parameters and the errors under the hard compare, before and after the fit."""
    table = _table(record.name, "before", "after", "unit")
    for name, fitted in record.fitted.items():
        bounds = record.bounds[name]
        table.add_row(words(name), *(_within(value, bounds) for value in (record.initial[name], fitted)), bounds.unit)
    table.add_section()
    _add_errors(table, record.metrics)
    print_table(console, table)


def print_profiles(console: Console, profiles: Mapping[str, records.Profile], fitted: Mapping[str, float]) -> None:
    """Prints the intervals in which the error stays close to the minimum while the other parameters are fitted
    again."""
    heads = [within_text(each.within) for each in next(iter(profiles.values())).intervals]
    table = Table("error along each", "fitted", "least error", *heads, title_justify="left")
    for name, profile in profiles.items():
        ranges = [interval_text(each.lower, each.upper) for each in profile.intervals]
        table.add_row(words(name), f"{fitted[name]:.4g}", f"{profile.best.value:.4g}", *ranges)
    print_table(console, table)


def print_front(console: Console, front: Sequence[records.FrontPoint]) -> None:
    """Prints the front of false shadow against false light, and the cost of its knee."""
    table = Table("false shadow", "false light", "RMSE", *map(escape, front[0].values), "", title_justify="left")
    for point in front:
        errors = (f"{error:.4f}" for error in (point.false_shadow, point.false_light, point.rmse))
        values = (f"{value:.4g}" for value in point.values.values())
        table.add_row(*errors, *values, "knee" if point.is_knee else "")
    print_table(console, table)
    print_lines(console, knee_text(front))


def print_validation(console: Console, views: int, errors: records.BeforeAndAfter) -> None:
    """Prints the errors before and after a fit over the validation views."""
    table = _table(f"{counted(views, 'view')} for validation", "before", "after", "unit")
    _add_errors(table, errors)
    print_table(console, table)


def print_render(console: Console, record: records.RenderRecord) -> None:
    """Prints the errors of each light's image, and the errors over all lights, if there are several lights."""
    all_lights, lights = cells(record.metrics.errors), record.metrics.lights
    table = Table("", title=words(record.name), title_justify="left")
    columns = {"error": all_lights}
    if len(lights) > 1:
        columns = {each.light: [*cells(each.errors, list(ERRORS)[:-1]), "–"] for each in lights}
        columns["all lights"] = all_lights
    for head in columns:
        table.add_column(words(head), justify="right")
    for label, *row in zip(ERRORS.values(), *columns.values(), strict=True):
        table.add_row(label, *row)
    print_table(console, table)


def print_picture(console: Console, record: records.PictureRecord) -> None:
    """Prints the errors of a picture before and after the fit."""
    before, after = record.metrics.before, record.metrics.after
    table = _table(record.name, "before", "after")
    for key, title in (("rmse", "RMSE of the picture"), ("mae", "MAE of the picture"), ("flip", "FLIP")):
        if getattr(before, key) is not None:
            table.add_row(title, f"{getattr(before, key):.4f}", f"{getattr(after, key):.4f}")
    print_table(console, table)


def print_values(console: Console, record: records.FitRecord | records.PictureRecord) -> None:
    """Prints truth, fitted value, error and standard deviation of each parameter."""
    table = Table("", "truth", "fitted", "error", "std. dev.")
    for column in table.columns[1:]:
        column.justify = "right"
    for name, fitted in record.fitted.items():
        bounds, truth, deviation = record.bounds[name], record.truth.get(name), record.deviations.get(name)
        known = ("", "") if truth is None else (_within(truth, bounds, 5), f"{fitted - truth:+.2g}")
        spread = "" if deviation is None else f"{deviation:.2g}"
        table.add_row(words(name), known[0], _within(fitted, bounds, 5), known[1], spread)
    print_table(console, table)


def _print_starts(console: Console, result: FitResult) -> None:
    """Prints the losses of several starts."""
    if not result.starts:
        return
    losses = sorted(start.loss for start in result.starts)
    shown = losses[:_MAX_STARTS] if result.is_own_loss else [loss**0.5 for loss in losses[:_MAX_STARTS]]
    listed = ", ".join(f"{loss:.4f}" for loss in shown) + (", …" if len(losses) > _MAX_STARTS else "")
    name = "loss" if result.is_own_loss else "RMSE"
    print_lines(console, [f"blurred {name} of {len(losses)} starts after the first phases, best first: {listed}"])


def print_shape(console: Console, record: records.ShapeRecord) -> list[str]:
    """Prints the overlap of a shape's shadows with their targets. **Returns** the sentences below the table."""
    measured = record.metrics
    heads = ("intersection over union", "before", "after, map", "after, rays")
    table = _table(record.name, *heads[1:], first=heads[0])
    for light in measured.lights:
        table.add_row(words(light.light), *(f"{overlap:.4f}" for overlap in (light.before, light.map, light.rays)))
    for light in measured.unseen:
        table.add_row(words(light.light), "", "", f"{light.rays:.4f}")
    print_table(console, table)
    lines = [f"mean square error {measured.initial_loss:.3g} before, {measured.loss:.3g} after"]
    if measured.chamfer is not None and measured.size is not None:
        share = measured.chamfer / measured.size
        lines.append(f"Chamfer distance {measured.chamfer:.4g} world units, {share:.2%} of the shape's size")
    return lines + [
        f"{light.light} is {light.after:.3f}° from its position in the scene, {light.before:.3f}° before"
        for light in measured.moved
    ]


def _table(title: str, *heads: str, first: str = "") -> Table:
    """A table whose columns hold numbers, except for the first column and the units."""
    table = Table(first, *heads, title=words(title), title_justify="left")
    for column in table.columns[1:]:
        column.justify = "left" if column.header == "unit" else "right"
    return table


def _add_errors(table: Table, errors: records.BeforeAndAfter | records.FitMetrics) -> None:
    rows = zip(ERRORS.items(), cells(errors.before), cells(errors.after), strict=True)
    for (key, label), before, after in rows:
        table.add_row(label, before, after, UNITS[key])


def _within(value: float, bounds: records.Bounds, digits: int = 4) -> str:
    return text_within(value, bounds.lower, bounds.upper, digits)
