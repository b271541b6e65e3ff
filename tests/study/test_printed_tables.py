"""Tables that runs print, made of records whose numbers are all different: each cell is the number of its place."""

from io import StringIO

from rich.console import Console

from diffshadow.shadow import EngineSetting
from diffshadow.study.pages import _console as shown
from diffshadow.study.pages import _table as table
from diffshadow.study.record._runs import (
    At,
    BeforeAndAfter,
    Bounds,
    Course,
    End,
    Errors,
    FitMetrics,
    FitRecord,
    FittedLight,
    FrontPoint,
    Interval,
    LightErrors,
    Profile,
    RenderedLight,
    RenderMetrics,
    RenderRecord,
)

BEFORE = Errors(rmse=0.2, mae=0.11, ssim=0.4, false_shadow_rate=0.05, false_light_rate=0.06, flip=0.3)
AFTER = Errors(rmse=0.1, mae=0.07, ssim=0.8, false_shadow_rate=0.01, false_light_rate=0.02)
OF_LIGHTS = {"compare": "hard", "reference_noise_floor": None, "pixels": 9}
ABOUT = {"name": "named", "seconds": {}, "versions": {}, "seed": 0, "command": "diffshadow"}
FIT = FitRecord(
    initial={"filter.radius": 2.0, "bias.constant": 0.5},
    fitted={"filter.radius": 3.25, "bias.constant": 1.75},
    bounds={
        "filter.radius": Bounds(lower=0.0, upper=16.0, unit="texels"),
        "bias.constant": Bounds(lower=0.0, upper=30.0, unit="texels"),
    },
    metrics=FitMetrics(
        before=BEFORE,
        after=AFTER,
        lights=[FittedLight(light="scene.light", before=LightErrors.of(BEFORE), after=LightErrors.of(AFTER))],
        **OF_LIGHTS,
    ),
    solver=Course(steps=3, chosen_phase=-1, phases=[]),
    **ABOUT,
)


def render(*errors):
    """The record of a render with these errors of its lights."""
    lights = [RenderedLight(light=f"scene.lights.{i}", errors=LightErrors.of(one)) for i, one in enumerate(errors)]
    return RenderRecord(metrics=RenderMetrics(errors=BEFORE, lights=lights, **OF_LIGHTS), **ABOUT)


ERRORS = [
    ["RMSE", "0.2000", "0.1000", "visibility"],
    ["MAE", "0.1100", "0.0700", "visibility"],
    ["SSIM", "0.4000", "0.8000", ""],
    ["false shadow (acne)", "5.000%", "1.000%", "of light"],
    ["false light (leaks, Peter-panning)", "6.000%", "2.000%", "of light"],
    ["FLIP of the shaded picture", "0.3000", "–", ""],
]


def printed(show, *arguments):
    """The cells of the table, head first, and all that is printed."""
    console = Console(record=True, width=160, file=StringIO())
    show(console, *arguments)
    text = console.export_text()
    rows = [line.replace("┃", "│") for line in text.splitlines() if line.startswith(("│", "┃"))]
    return [[cell.strip() for cell in row.split("│")[1:-1]] for row in rows], text


def test_a_fit_has_its_values_and_errors_before_and_after():
    rows, text = printed(shown.print_fit, FIT)
    assert text.startswith("named")
    assert rows[1:3] == [["filter.radius", "2", "3.25", "texels"], ["bias.constant", "0.5", "1.75", "texels"]]
    assert rows[3:] == ERRORS


def test_validation_has_the_errors_of_its_views():
    rows, text = printed(shown.print_validation, 7, BeforeAndAfter(before=BEFORE, after=AFTER))
    assert "7 views for validation" in text
    assert rows[1:] == ERRORS


def test_profiles_have_values_and_not_errors():
    end = lambda value, error: End(value=value, error=error, is_bound=value == 16.0)
    ends = {0.01: (2.9, 3.6), 0.05: (2.0, 16.0)}
    intervals = [Interval(within=w, lower=end(low, 0.101), upper=end(high, 0.102)) for w, (low, high) in ends.items()]
    profile = Profile(best=At(value=3.1, error=0.1), points=[[2.9, 0.101], [3.1, 0.1]], intervals=intervals)
    rows, _ = printed(shown.print_profiles, {"filter.radius": profile}, FIT.fitted)
    assert rows == [
        ["error along each", "fitted", "least error", "within 1 %", "within 5 %"],
        ["filter.radius", "3.25", "3.1", "2.9 to 3.6", "2 to 16 (bound)"],
    ]


def test_a_front_has_its_errors_and_values_and_marks_its_knee():
    numbers = [(1.0, 2.0, 0.01, 0.09, 0.0906), (3.0, 4.0, 0.03, 0.05, 0.0583), (5.0, 6.0, 0.08, 0.02, 0.05)]
    front = [
        FrontPoint(
            values={"filter.radius": radius, "bias.constant": bias},
            false_shadow=dark,
            false_light=light,
            rmse=rmse,
            is_knee=bias == 4.0,
        )
        for radius, bias, dark, light, rmse in numbers
    ]
    rows, text = printed(shown.print_front, front)
    assert rows == [
        ["false shadow", "false light", "RMSE", "filter.radius", "bias.constant", ""],
        ["0.0100", "0.0900", "0.0906", "1", "2", ""],
        ["0.0300", "0.0500", "0.0583", "3", "4", "knee"],
        ["0.0800", "0.0200", "0.0500", "5", "6", ""],
    ]
    assert "at the knee, the RMSE is 0.0583, 16.6% more than the lowest of the front, 0.0500" in text


def test_errors_of_several_lights_have_a_column_each_and_one_of_all():
    none = LightErrors(rmse=0.9, mae=None, ssim=None, false_shadow_rate=None, false_light_rate=None)
    rows, _ = printed(shown.print_render, render(AFTER, none))
    assert rows[0] == ["", "scene.lights.0", "scene.lights.1", "all lights"]
    assert rows[1] == ["RMSE", "0.1000", "0.9000", "0.2000"]
    assert rows[4] == ["false shadow (acne)", "1.000%", "–", "5.000%"]
    alone, _ = printed(shown.print_render, render(AFTER))
    assert alone[:2] == [["", "error"], ["RMSE", "0.2000"]]


def test_a_comparison_has_its_rows_as_they_are():
    parts = [[["filter.radius", "1", "2", "texels"]], [["RMSE", "0.1", "0.2", "visibility"]]]
    rows, _ = printed(table.print_comparison, ["one", "other"], parts)
    assert rows == [["", "one", "other", "unit"], *parts[0], *parts[1]]


def test_settings_and_rows_have_their_numbers_in_a_line():
    settings = [
        EngineSetting("three.js", "light.shadow.bias", -0.00125, "window depth", True),
        EngineSetting("Godot", "shadow_bias", None, "has none", False),
    ]
    _, text = printed(table.print_settings, "settings", settings)
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert lines == [
        "settings",
        "three.js light.shadow.bias -0.00125 window depth",
        "Godot shadow_bias – has none; not verified against the engine",
    ]
    _, text = printed(table.print_rows, {"pcf": dict(BEFORE), "esm": dict(AFTER)})
    assert [" ".join(line.split()) for line in text.splitlines()] == [
        "pcf RMSE 0.2000, false shadow 5.000%, false light 6.000%",
        "esm RMSE 0.1000, false shadow 1.000%, false light 2.000%",
    ]
