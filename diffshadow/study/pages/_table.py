"""The tables that a run prints at its end. They are readable without colour."""

import math
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from ..._checks import text_within
from ..._words import counted
from ...config import printable
from ...fit import FrontPoint, Parameter, Profile
from ...shadow import EngineSetting

LIGHT_ERRORS = {
    "rmse": "RMSE",
    "mae": "MAE",
    "ssim": "SSIM",
    "false_shadow_rate": "false shadow (acne)",
    "false_light_rate": "false light (leaks, Peter-panning)",
}
"""The names of the errors of each light's visibility in tables and reports. Smaller is better, except for SSIM."""

ERRORS = {**LIGHT_ERRORS, "flip": "FLIP of the shaded picture"}
"""The names of all errors; the last is of the picture under all lights."""

UNITS = {
    "rmse": "visibility",
    "mae": "visibility",
    "ssim": "",
    "false_shadow_rate": "of light",
    "false_light_rate": "of light",
    "flip": "",
}
"""The units of errors."""

# Errors below this, in visibility, are rounding.
_MIN_ERROR = 1e-5
UNEXPLAINED = "unexplained"
"""The kind of the verdict on a fit that does not explain its references."""


def number(name: str, value: float | None) -> str:
    """The error `name` as text; a dash if there is none."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.3%}" if name.endswith("_rate") else f"{value:.4f}"


def words(text: str) -> Text:
    """`text` for a table, without markup and control characters."""
    return Text(printable(text))


def noise_text(noise_floor: float | None) -> str:
    """A phrase on the error of the reference itself."""
    if noise_floor is None:
        return "the reference's own error is unknown, since it was given, not traced"
    return f"the reference's own noise is {noise_floor:.4f} RMSE"


def print_fit(
    console: Console,
    name: str,
    parameters: Sequence[Parameter],
    fitted: Mapping[str, float],
    before: Mapping[str, float | None],
    after: Mapping[str, float | None],
) -> None:
    """Prints the parameters and the errors under the hard compare, before and after the fit."""
    table = Table("", "before", "after", "unit", title=words(name), title_justify="left")
    for column in table.columns[1:3]:
        column.justify = "right"
    for p in parameters:
        cells = (text_within(value, p.lower, p.upper) for value in (p.initial, fitted[p.name]))
        table.add_row(words(p.name), *cells, p.unit)
    table.add_section()
    _add_errors(table, before, after)
    console.print(table)


def print_profiles(console: Console, profiles: Sequence[Profile], fitted: Mapping[str, float]) -> None:
    """Prints where each parameter may lie for errors close to the best, with the others fitted again."""
    heads = [within_text(each.within) for each in profiles[0].intervals]
    table = Table("error along each", "fitted", "least error", *heads, title_justify="left")
    for profile in profiles:
        ranges = [
            interval_text(*((end.value, end.is_bound) for end in (each.lower, each.upper)))
            for each in profile.intervals
        ]
        table.add_row(words(profile.name), f"{fitted[profile.name]:.4g}", f"{profile.best[0]:.4g}", *ranges)
    console.print(table)


def print_front(console: Console, names: Sequence[str], front: Sequence[FrontPoint]) -> None:
    """Prints the front of false shadow against false light, and what its knee costs."""
    table = Table("false shadow", "false light", "RMSE", *map(escape, names), "", title_justify="left")
    for point in front:
        errors = (f"{error:.4f}" for error in (point.false_shadow, point.false_light, point.rmse))
        table.add_row(*errors, *(f"{value:.4g}" for value in point.values), "knee" if point.is_knee else "")
    console.print(table)
    print_lines(console, knee_text([(point.rmse, point.is_knee) for point in front]))


def knee_text(front: Sequence[tuple[float | None, bool]]) -> list[str]:
    """What the knee of a front costs in RMSE, in a sentence; none without a knee, or for a front without RMSEs.

    **Arguments:** `front`: the RMSE of each point, and whether it is the knee.
    """
    errors = [rmse for rmse, _ in front if rmse is not None]
    at_knee = [rmse for rmse, is_knee in front if is_knee and rmse is not None]
    if not at_knee:
        return []
    (knee,), least = at_knee, min(errors)
    more = knee / max(least, _MIN_ERROR) - 1
    cost = f"{more:.1%} more than the least of the front, {least:.4f}" if knee > least else "the least of the front"
    return [f"at the knee, the RMSE is {knee:.4f}, {cost}"]


def within_text(within: float) -> str:
    """The head of a column of intervals."""
    return f"within {100 * within:.3g} %"


def interval_text(*ends: tuple[float, bool]) -> str:
    """From where to where; an end is marked if it is a parameter's bound."""
    return " to ".join(f"{value:.3g}{' (bound)' if is_bound else ''}" for value, is_bound in ends)


def print_validation(
    console: Console, views: int, before: Mapping[str, float | None], after: Mapping[str, float | None]
) -> None:
    """Prints the errors before and after a fit over views that it has not seen."""
    table = Table(
        "",
        "before",
        "after",
        "unit",
        title=f"{counted(views, 'view')} for validation",
        title_justify="left",
    )
    for column in table.columns[1:3]:
        column.justify = "right"
    _add_errors(table, before, after)
    console.print(table)


def _add_errors(table: Table, before: Mapping[str, float | None], after: Mapping[str, float | None]) -> None:
    for key, label in ERRORS.items():
        table.add_row(label, number(key, before.get(key)), number(key, after.get(key)), UNITS[key])


def print_errors(
    console: Console, name: str, errors: Mapping[str, float | None], lights: Mapping[str, Mapping[str, float]]
) -> None:
    """Prints the errors of each of several lights' images, by the light's key, and those over all lights."""
    columns = {"error": errors} if len(lights) == 1 else {**lights, "all lights": errors}
    table = Table("", title=words(name), title_justify="left")
    for head in columns:
        table.add_column(words(head), justify="right")
    for key, label in ERRORS.items():
        table.add_row(label, *(number(key, column.get(key)) for column in columns.values()))
    console.print(table)


def print_comparison(console: Console, labels: Sequence[str], parts: Sequence[Sequence[Sequence[str]]]) -> None:
    """Prints rows of a name, a text for each of the runs named `labels`, and a unit. Each part is a section."""
    table = Table()
    table.add_column("", overflow="fold")
    for label in labels:
        table.add_column(words(label), justify="right")
    table.add_column("unit")
    for part in parts:
        for row in part:
            table.add_row(*(words(cell) for cell in row))
        table.add_section()
    console.print(table)


def print_settings(console: Console, title: str, settings: Sequence[EngineSetting]) -> None:
    """Prints the settings of engines, one on each line."""
    lines = [
        f"  {each.engine:<12}{each.setting:<37}{_value(each):>11}  {each.note}"
        + ("" if each.is_verified else "; not verified against the engine")
        for each in settings
    ]
    print_code(console, title, "\n".join(lines))


def _value(setting: EngineSetting) -> str:
    return "–" if setting.value is None else f"{setting.value:.4g}"


def print_rows(console: Console, errors: Mapping[str, Mapping[str, float | None]]) -> None:
    """Prints RMSE and rates of several techniques, one on each line."""
    shown = {"rmse": "RMSE", "false_shadow_rate": "false shadow", "false_light_rate": "false light"}
    for name, of in errors.items():
        numbers = ", ".join(f"{what} {number(key, of[key])}" for key, what in shown.items())
        console.print(Text(printable(f"  {name:<20}{numbers}")))


def print_code(console: Console, title: str, code: str) -> None:
    """Prints lines of code under a title, so that they can be copied."""
    console.print(Text(printable(title), "bold"))
    for line in code.splitlines():
        console.print(Text(printable(line)), soft_wrap=True)


def print_lines(console: Console, lines: Sequence[str], *, warn: bool = False) -> None:
    """Prints sentences under a table, prefixed with "warning: " if `warn`."""
    for line in map(printable, lines):
        text = Text.assemble(("warning: ", "bold yellow"), line) if warn else Text(line)
        console.print(text, soft_wrap=True)
