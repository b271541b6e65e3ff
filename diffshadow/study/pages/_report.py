"""The pages of runs. Each page is made from the files in a run's folder.

This module loads Matplotlib, so import it only to write pages.
"""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from markupsafe import Markup

from ..._checks import text_within
from ..._words import counted
from ...console import Command
from ...shading import to_srgb
from .. import style
from ..record import _runs as records
from ..record._files import add_files
from ..record._stored import REPORT, LightImages, StoredRun, VisibilityRun
from . import _figures as figures
from ._next import after_run
from ._page import Picture, Scale, data_uri, difference_scale, file_pictures, lines_of, picture, write_page
from ._table import ERRORS, LIGHT_ERRORS, UNITS, cells, interval_text, knee_text, noise_text, number, within_text

# Files in the folder that the page draws itself.
_SHOWN = ("profiles", "front", "comparison", "shaded", "loss", "parameters", "visibility", "reference", "difference")
# Techniques whose reports also name the filter.
_FILTERED = ("shadow_map", "cascades", "perspective_warp", "resolution_matched")
_HEADINGS = {
    "paths": "How lights and meshes moved",
    "landscape": "Error landscape",
    "animation": "How the fit went",
    "shadow_map": "View from the light",
    "texture": "View from the light",
    "debug": "Intermediate results",
}
TURNTABLE, PROGRESS = "turntable.webp", "progress.webp"
_ANIMATIONS = {
    TURNTABLE: "The fitted shape from all sides. Faces that are seen from behind are blue.",
    PROGRESS: "The shape as it was fitted.",
}


def write_report(run: StoredRun[Any], form: str | None = None, dpi: int = style.DPI) -> Path:
    """Writes the page of `run` to its folder, and its figures if a format `form` is given.

    **Returns** the page.
    """
    if form is not None:
        add_files(run.folder, [path.name for path in figures.write_figures(run, run.folder, form, dpi)])
    view = _VIEWS[run.record.kind](run)
    write_page(run.folder / REPORT, view.template, view=view)
    return run.folder / REPORT


class View[Of: records.FolderRecord]:
    """The contents of a run's page. Texts are as on the page."""

    template: ClassVar[str]

    def __init__(self, run: StoredRun[Any]):
        self.run = run
        self.record: Of = run.record

    @property
    def summary(self) -> list[str]:
        """The verdict on the fit, one sentence each, or its errors for an older run without a verdict."""
        said = self.record.said
        if said is None:
            return self.without_verdict
        return [f"{text[:1].upper()}{text[1:]}." for text in (said.sentence, *said.remedies) if text]

    @property
    def without_verdict(self) -> list[str]:
        """What to say instead."""
        return []

    @property
    def environment(self) -> list[tuple[str, Any, str]]:
        """Name and value of every input of the run except its settings."""
        seed = {} if self.record.seed is None else {"seed": self.record.seed}
        return [(name, value, "") for name, value in {**self.record.versions, **seed}.items()]

    @property
    def seconds(self) -> list[tuple[str, str, str]]:
        """The time of each stage."""
        return [(name, f"{value:.2f}", "s") for name, value in self.record.seconds.items()]

    @property
    def commands(self) -> list[Command]:
        """What to do next."""
        return after_run(self.run.folder, self.record)

    def chart(self, name: str) -> str:
        """The figure with this name in `figures`."""
        return style.inline_svg(getattr(figures, name)(self.run), name)


class FittedNumber(NamedTuple):
    """A parameter before and after a fit. For poses and pictures, also the truth and the standard deviation.

    - `best`, `intervals`: the value with the lowest error, and the intervals in which the error is close to the lowest.
    """

    name: str
    initial: str
    fitted: str
    deviation: str
    truth: str
    unit: str
    lower: str
    upper: str
    best: str = ""
    intervals: tuple[str, ...] = ()


def _fitted(
    record: records.FitRecord | records.PictureRecord, digits: tuple[int, int], deviation: str
) -> Iterator[FittedNumber]:
    """Each parameter. `digits` is the number of digits of its start and result."""
    for name, value in record.fitted.items():
        bounds, spread = record.bounds[name], record.deviations.get(name)
        text = lambda value, digits, bounds=bounds: text_within(value, bounds.lower, bounds.upper, digits)
        yield FittedNumber(
            name,
            text(record.initial[name], digits[0]),
            text(value, digits[1]),
            "" if spread is None else f"± {spread:{deviation}}",
            text(record.truth[name], 5) if name in record.truth else "",
            bounds.unit,
            text(bounds.lower, 6),
            text(bounds.upper, 6),
            *_sureness(record.profiles.get(name) if isinstance(record, records.FitRecord) else None),
        )


def _sureness(profile: records.Profile | None) -> tuple[str, tuple[str, ...]]:
    """The value with the lowest error, and the intervals in which the error is close to it."""
    if profile is None:
        return "", ()
    return f"{profile.best.value:.4g}", tuple(interval_text(each.lower, each.upper) for each in profile.intervals)


class ErrorRow(NamedTuple):
    """An error of every state, and the error of the reference itself."""

    label: str
    numbers: list[str]
    reference: str
    unit: str


class LightRow(NamedTuple):
    """The errors of a light or view: the RMSE before a fit, and all errors of the result."""

    key: str
    before: str
    numbers: list[str]
    unseen: bool
    rmse: float


class LightPictures(NamedTuple):
    """The pictures of a light or view."""

    key: str
    visibility: list[Picture]
    differences: list[Picture]


class VisibilityView[Of: records.VisibilityRecord](View[Of]):
    """The report of a fit to images of visibility, or of a render."""

    template = "report.html.j2"
    run: VisibilityRun[Any]
    labels: ClassVar = list(LIGHT_ERRORS.values())

    def __init__(self, run: StoredRun[Any]):
        super().__init__(run)
        self.limit, self.extend = figures.difference_limit(self.run.shown)

    @property
    def settings(self) -> dict[str, str]:
        """The values of all settings."""
        return {row.key: row.value for row in self.run.settings}

    @property
    def commands(self) -> list[Command]:
        return after_run(self.run.folder, self.record, self.settings.get("technique.type"))

    @property
    def errors(self) -> list[ErrorRow]:
        """Each error of every state."""
        own = {"rmse": self.record.metrics.reference_noise_floor}
        columns = zip(*(cells(errors) for _, errors in self.run.errors), strict=True)
        rows = zip(ERRORS.items(), columns, strict=True)
        return [ErrorRow(label, [*row], number(name, own.get(name)), UNITS[name]) for (name, label), row in rows]

    @property
    def noise(self) -> str:
        """The error of the reference itself, in words."""
        return noise_text(self.record.metrics.reference_noise_floor)

    @cached_property
    def by_light(self) -> list[LightRow]:
        """The errors of each light or view. Views are sorted with the worst first."""
        rows = []
        for each, light in zip(self.run.lights, self.record.metrics.lights, strict=True):
            first, last = each.errors[0], each.errors[-1]
            unseen = isinstance(light, records.FittedLight) and bool(light.validation)
            numbers = cells(last, LIGHT_ERRORS)
            rows.append(LightRow(each.key, number("rmse", first.rmse), numbers, unseen, last.rmse or 0.0))
        return sorted(rows, key=lambda row: -row.rmse) if self.run.is_of_views else rows

    @cached_property
    def lights(self) -> list[LightPictures]:
        """The pictures of each light or view, if it has pictures."""
        return [self._light(light) for light in self.run.shown]

    def _light(self, light: LightImages) -> LightPictures:
        # Names are unique on the page.
        end = f", {light.key}" if len(self.run.lights) > 1 else ""
        counted = lambda image: np.where(light.mask, image, np.nan)
        visibility = [picture(f"Reference{end}", counted(light.reference), title="Reference")]
        differences = []
        for (title, image), errors in zip(light.images, light.errors, strict=True):
            note = f"RMSE {number('rmse', errors.rmse)}"
            visibility.append(picture(f"{title}{end}", counted(image), note, title=title))
            name, off = f"{title} − reference", counted(image - light.reference)
            how: Any = {"title": name, "colours": style.DIFFERENCE, "limit": self.limit}
            differences.append(picture(f"{name}{end}", off, **how))
        return LightPictures(light.key, visibility, differences)

    @property
    def scale(self) -> Scale:
        """The colour scale of differences."""
        return difference_scale(self.limit, self.extend == "both")

    @cached_property
    def shaded(self) -> list[Picture]:
        """The shaded pictures, with the result last."""
        return [picture(f"{title}, shaded", image, title=title) for title, image in self.run.shaded]

    @property
    def slides(self) -> list[str]:
        """The pictures that the slider shows first."""
        return [p.name for p in (self.shaded or self.lights[0].visibility)[-2:]]

    @property
    def files(self) -> dict[str, list[Picture]]:
        """The folder's other pictures, by heading. If a picture exists as SVG and PNG, the SVG is used."""
        found: dict[str, list[Path]] = {}
        for suffix in (".svg", ".png", ".webp"):
            for path in sorted(self.run.folder.glob(f"*{suffix}"), key=lambda path: (len(path.stem), path.stem)):
                is_twice = suffix == ".png" and path.with_suffix(".svg").exists()
                if path.is_file() and not path.stem.startswith(_SHOWN) and not is_twice:
                    starts = (text for start, text in _HEADINGS.items() if path.stem.startswith(start))
                    found.setdefault(next(starts, "Other pictures"), []).append(path)
        return {heading: file_pictures(paths) for heading, paths in found.items()}


class RenderView(VisibilityView[records.RenderRecord]):
    """The report of a render."""

    @property
    def summary(self) -> list[str]:
        technique, kernel = self.settings["technique.type"], self.settings["filter.type"]
        name = f"{technique} with filter {kernel}" if technique in _FILTERED else technique
        # Names of engines are not converted.
        name = name if "." in technique else name.replace("_", " ").capitalize()
        return [f"{name}: the shadow's error is {self.record.metrics.errors.rmse:.4f} RMSE."]

    @property
    def aliasing(self) -> list[tuple[str, str, list[str]]]:
        """The figures of the texels' sizes on the screen, for each light that has them: the light's key, and the name
        and texts of the figures."""
        rows = []
        for light in self.record.metrics.lights:
            if light.aliasing is not None:
                parts = {"longest extent": light.aliasing.extent, "due to perspective": light.aliasing.perspective}
                for name, each in parts.items():
                    extents = (each.worst, each.percentile_99, 2**each.mean_log2)
                    rows.append((light.light, name, [*(f"{x:.3g}" for x in extents), f"{each.undersampled:.1%}"]))
        return rows


class FitView(VisibilityView[records.FitRecord]):
    """The report of a fit to images of visibility."""

    few_parameters: ClassVar = figures.FEW_PARAMETERS

    @property
    def without_verdict(self) -> list[str]:
        before, after = self.record.metrics.before.rmse, self.record.metrics.after.rmse
        return [f"The fit changed the shadow's error from {before:.4f} to {after:.4f} RMSE."]

    @cached_property
    def fitted(self) -> list[FittedNumber]:
        """Each parameter."""
        return list(_fitted(self.record, (4, 5 if self.record.truth else 4), ".1g"))

    @property
    def validation(self) -> list[ErrorRow]:
        """Each error before and after the fit, over the validation views."""
        found = self.record.metrics.validation
        if found is None:
            return []
        rows = zip(ERRORS.items(), cells(found.before), cells(found.after), strict=True)
        return [ErrorRow(label, [before, after], "", UNITS[name]) for (name, label), before, after in rows]

    @property
    def widths(self) -> list[str]:
        """The heads of the columns of intervals."""
        return list(map(within_text, self.record.widths))

    @property
    def front(self) -> Iterator[tuple[list[str], bool]]:
        """The settings on the front of false shadow against false light: errors and values, and whether the setting is
        the knee."""
        for point in self.record.front:
            errors = (number("rmse", error) for error in (point.false_shadow, point.false_light, point.rmse))
            yield [*errors, *(f"{value:.4g}" for value in point.values.values())], point.is_knee

    @property
    def knee(self) -> list[str]:
        """The cost of the front's knee, in words."""
        return knee_text(self.record.front)

    @property
    def loss(self) -> str:
        """The name of the fit's losses in tables."""
        return "loss" if self.record.solver.is_own_loss else "RMSE"

    def error(self, loss: float | None) -> str:
        """The root of a mean square error, or a user's loss."""
        if loss is not None and self.record.solver.is_own_loss:
            return f"{loss:.4g}"
        return number("rmse", None if loss is None else loss**0.5)

    def numbers(self, values: dict[str, float]) -> list[str]:
        """Texts of the parameters' values, by name."""
        bounds = self.record.bounds
        return [text_within(value, bounds[name].lower, bounds[name].upper) for name, value in values.items()]

    @property
    def starts(self) -> list[tuple[str, list[str]]]:
        """The final error and the initial values of each of several starts, best first."""
        starts = sorted(self.record.starts, key=lambda start: np.inf if start.loss is None else start.loss)
        return [(self.error(start.loss), self.numbers(start.initial)) for start in starts]

    @property
    def code(self) -> dict[str, Markup]:
        """The code for an engine, by the light's key."""
        return {key: lines_of(text) for key, text in self.record.code.items()}


class PictureView(View[records.PictureRecord]):
    """The report of a fit to a picture."""

    template = "picture.html.j2"
    titles: ClassVar = {"reference": "Reference", "before": "Before", "after": "After"}
    slides: ClassVar = ["Reference", "After"]

    @property
    def summary(self) -> list[str]:
        colours = "sRGB" if self.record.encoding == "srgb" else "linear"
        over = f"Errors compare {colours} colours over {counted(self.record.metrics.pixels, 'pixel')}."
        return [*super().summary, over]

    @property
    def without_verdict(self) -> list[str]:
        before, after = self.record.metrics.before.rmse, self.record.metrics.after.rmse
        steps = counted(self.record.steps, "step")
        return [f"The picture's error went from {before:.4f} to {after:.4f} RMSE, in {steps}."]

    @cached_property
    def pictures(self) -> list[Picture]:
        """The reference, and the picture before and after the fit."""
        shown = []
        for state, title in self.titles.items():
            image = np.clip(self.run.arrays[state], 0, 1)
            seen = image if self.record.encoding == "srgb" else to_srgb(image)
            errors = getattr(self.record.metrics, state, None)
            shown.append(picture(title, seen, f"RMSE {errors.rmse:.4f}" if errors else ""))
        return shown

    @property
    def differences(self) -> Iterator[Picture]:
        """The mean differences of the channels at the pixels that count."""
        arrays = self.run.arrays
        for state in ("before", "after"):
            difference = np.where(arrays["mask"], (arrays[state] - arrays["reference"]).mean(axis=-1), 0)
            name = f"{self.titles[state]} − reference"
            shown = picture(name, difference, "from −0.25 to 0.25", colours=style.DIFFERENCE, limit=0.25)
            yield shown._replace(slides=False)

    @property
    def fitted(self) -> list[FittedNumber]:
        """Each parameter."""
        return list(_fitted(self.record, (5, 5), ".2g"))

    @property
    def errors(self) -> list[tuple[str, str, str]]:
        """Each error before and after the fit."""
        before, after = self.record.metrics.before, self.record.metrics.after
        pairs = {
            "RMSE": (before.rmse, after.rmse),
            "MAE": (before.mae, after.mae),
            "FLIP": (before.flip, after.flip),
        }
        return [
            (label, number("", one), number("", other)) for label, (one, other) in pairs.items() if other is not None
        ]

    @property
    def camera(self) -> list[tuple[str, str, str]]:
        """The fitted camera's numbers."""
        return [(key, ", ".join(f"{x:.5g}" for x in value), "") for key, value in self.record.camera.items()]


class ShapeView(View[records.ShapeRecord]):
    """The report of a fit of a shape."""

    template = "shape.html.j2"

    @property
    def animations(self) -> list[tuple[Markup, str]]:
        """The animations in the folder, and their captions."""
        files = {self.run.folder / name: text for name, text in _ANIMATIONS.items()}
        return [(Markup(data_uri(f.read_bytes(), f.suffix)), text) for f, text in files.items() if f.is_file()]

    @property
    def lights(self) -> Iterator[tuple[records.Overlap, list[Picture]]]:
        """Each light, and the pictures of its shadow."""
        for i, light in enumerate(self.record.metrics.lights):
            notes = {"Target": "", "Before": f"IoU {light.before:.4f}", "After": f"IoU {light.map:.4f}"}
            images = [np.clip(self.run.arrays[name][i], 0, 1) for name in ("reference", "before", "after")]
            yield (
                light,
                [
                    picture(f"{title}, {light.light}", image, note, title=title)
                    for (title, note), image in zip(notes.items(), images, strict=True)
                ],
            )


_VIEWS: dict[str, type[View[Any]]] = {
    "fit": FitView,
    "render": RenderView,
    "picture": PictureView,
    "shape": ShapeView,
}
