"""Numbers and sentences in tables, and printed tables. Both are readable without colour."""

import math
from collections.abc import Iterable, Mapping, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ...config import printable
from ...console import print_folded, print_table
from ...shadow import EngineSetting
from ..record._runs import End, Errors, FrontPoint, LightErrors

LIGHT_ERRORS = {
    "rmse": "RMSE",
    "mae": "MAE",
    "ssim": "SSIM",
    "false_shadow_rate": "false shadow (acne)",
    "false_light_rate": "false light (leaks, Peter-panning)",
}
"""The names of the errors of each light's visibility in tables and reports. Lower is better, except for SSIM."""

ERRORS = {**LIGHT_ERRORS, "flip": "FLIP of the shaded picture"}
"""The names of all errors. The last is the error of the picture under all lights."""

UNITS = {
    "rmse": "visibility",
    "mae": "visibility",
    "ssim": "",
    "false_shadow_rate": "of light",
    "false_light_rate": "of light",
    "flip": "",
}
"""The units of errors."""

# Errors of visibility below this value are rounding errors.
_MIN_ERROR = 1e-5


def number(name: str, value: float | None) -> str:
    """The error `name` as text; a dash if there is none."""
    if value is None or math.isnan(value):
        return "–"
    return f"{value:.3%}" if name.endswith("_rate") else f"{value:.4f}"


def cells(errors: Errors | LightErrors, names: Iterable[str] = ERRORS) -> list[str]:
    """Errors as texts."""
    return [number(name, getattr(errors, name)) for name in names]


def words(text: str) -> Text:
    """`text` for a table, without markup and control characters."""
    return Text(printable(text))


def noise_text(noise_floor: float | None) -> str:
    """A phrase about the error of the reference itself."""
    if noise_floor is None:
        return "the reference's own error is unknown, because it was not traced"
    return f"the reference's own noise is {noise_floor:.4f} RMSE"


def knee_text(front: Sequence[FrontPoint]) -> list[str]:
    """The RMSE cost of a front's knee, as a sentence. Empty without a knee, or for a front without RMSEs."""
    errors = [point.rmse for point in front if point.rmse is not None]
    at_knee = [point.rmse for point in front if point.is_knee and point.rmse is not None]
    if not at_knee:
        return []
    (knee,), least = at_knee, min(errors)
    more = knee / max(least, _MIN_ERROR) - 1
    cost = f"{more:.1%} more than the lowest of the front, {least:.4f}" if knee > least else "the lowest of the front"
    return [f"at the knee, the RMSE is {knee:.4f}, {cost}"]


def within_text(within: float) -> str:
    """The head of a column of intervals."""
    return f"within {100 * within:.3g} %"


def interval_text(*ends: End) -> str:
    """The two ends of an interval. An end at a parameter's bound is marked."""
    return " to ".join(f"{end.value:.3g}{' (bound)' if end.is_bound else ''}" for end in ends)


def print_comparison(console: Console, labels: Sequence[str], parts: Sequence[Sequence[Sequence[str]]]) -> None:
    """Prints rows with a name, a text for each of the runs `labels`, and a unit. Each part is a section."""
    table = Table()
    table.add_column("")
    for label in labels:
        table.add_column(words(label), justify="right")
    table.add_column("unit")
    for part in parts:
        for row in part:
            table.add_row(*(words(cell) for cell in row))
        table.add_section()
    print_table(console, table)


def print_settings(console: Console, title: str, settings: Sequence[EngineSetting]) -> None:
    """Prints the settings of engines, one per line. On a narrow console, the value has its own line."""
    notes = [each.note + ("" if each.is_verified else "; not verified against the engine") for each in settings]
    lines = [
        f"  {each.engine:<12}{each.setting:<37}{_value(each):>11}  {note}"
        for each, note in zip(settings, notes, strict=True)
    ]
    if max(map(len, lines), default=0) <= console.width:
        print_code(console, title, "\n".join(lines))
        return
    print_folded(console, printable(title), style="bold")
    for each, note in zip(settings, notes, strict=True):
        print_folded(console, f"{each.engine}: {each.setting}", indent=2)
        print_folded(console, f"{_value(each)}  {note}", indent=6)


def _value(setting: EngineSetting) -> str:
    return "–" if setting.value is None else f"{setting.value:.4g}"


def print_rows(console: Console, errors: Mapping[str, Mapping[str, float | None]]) -> None:
    """Prints RMSE and rates of several techniques, one per line."""
    shown = {"rmse": "RMSE", "false_shadow_rate": "false shadow", "false_light_rate": "false light"}
    for name, of in errors.items():
        numbers = ", ".join(f"{what} {number(key, of[key])}" for key, what in shown.items())
        line = printable(f"  {name:<20}{numbers}")
        if len(line) <= console.width:
            console.print(Text(line), soft_wrap=True)
        else:
            print_folded(console, printable(name), indent=2)
            print_folded(console, numbers, indent=6)


def print_code(console: Console, title: str, code: str) -> None:
    """Prints lines of code under a title, so that they can be copied."""
    console.print(Text(printable(title), "bold"))
    for line in code.splitlines():
        console.print(Text(printable(line)), soft_wrap=True)


def print_lines(console: Console, lines: Sequence[str], *, warn: bool = False) -> None:
    """Prints sentences under a table, with the prefix "warning: " if `warn`."""
    for line in map(printable, lines):
        text = Text.assemble(("warning: ", "bold yellow"), line) if warn else Text(line)
        console.print(text, soft_wrap=True)
