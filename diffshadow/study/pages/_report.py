"""The report of a fit or a render: one self-contained page."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..._checks import text_within
from ..files._stored import REPORT, LightImages, StoredRun
from ._next import after_run
from ._table import ERRORS, LIGHT_ERRORS, UNEXPLAINED, UNITS, interval_text, knee_text, noise_text, number, within_text

# Figures in the folder that the page draws itself.
_SHOWN = ("profiles", "front", "comparison", "shaded", "loss", "parameters", "visibility", "reference", "difference")
# Techniques whose name alone does not say what is drawn.
_FILTERED = ("shadow_map", "cascades", "perspective_warp", "resolution_matched")
_HEADINGS = {
    "paths": "How lights and meshes moved",
    "landscape": "Error landscape",
    "animation": "How the fit went",
    "shadow_map": "View from the light",
    "texture": "View from the light",
    "debug": "Intermediate results",
}


def write_report(run: StoredRun) -> Path:
    """Writes the page of `run` to its folder. **Returns** the page."""
    # Imported here, since they load Matplotlib.
    from .. import style
    from . import _figures as figures
    from ._page import difference_scale, file_pictures, lines_of, write_page

    result, is_fit = run.result, run.kind == "fit"
    limit, extend = figures.difference_limit(run.shown)
    lights = [_light(light, limit, many=len(run.lights) > 1) for light in run.shown]
    shaded = _shaded(run)
    write_page(
        run.folder / REPORT,
        "report.html.j2",
        run=run,
        summary=_fit_summary(result) if is_fit else [_render_summary(run)],
        is_explained=not is_fit or (result.get("verdict") or {}).get("kind") != UNEXPLAINED,
        states=[title for title, _ in run.errors] if is_fit else ["error"],
        fitted=_fitted(result) if is_fit else [],
        errors=_errors(run),
        noise=noise_text(result["metrics"]["reference_noise_floor"]),
        perceived=run.errors[-1][1].get("flip") is not None,
        labels=list(LIGHT_ERRORS.values()),
        validation=_validation(result) if is_fit else [],
        by_light=_by_light(run),
        has_views="shown" in result["metrics"],
        aliasing=_aliasing(run),
        slides=[p.name for p in (shaded or lights[0]["visibility"])[-2:]],
        lights=lights,
        scale=difference_scale(limit, extend == "both"),
        shaded=shaded,
        widths=list(map(within_text, figures.widths(result))) if is_fit else [],
        profiles=style.inline_svg(figures.profiles(result), "profiles") if is_fit and result.get("profiles") else "",
        front=_front(result) if is_fit else [],
        knee=knee_text([(point.get("rmse"), point["is_knee"]) for point in result.get("front", ())]),
        front_chart=style.inline_svg(figures.front(result), "front") if is_fit and result.get("front") else "",
        curves=_curves(run) if is_fit else [],
        is_wide=is_fit and len(result["fitted"]) > figures.FEW_PARAMETERS,
        phases=_phases(result) if is_fit else [],
        starts=_starts(result) if is_fit else [],
        code={key: lines_of(text) for key, text in result.get("code", {}).items()} if is_fit else {},
        commands=after_run(run.folder, result, {row.key: row.value for row in run.settings}.get("technique.type")),
        files={heading: file_pictures(paths) for heading, paths in _files(run.folder).items()},
        loss=_loss_heads(result) if is_fit else {},
        environment=[
            *((name, value, "") for name, value in result["versions"].items()),
            *([] if result.get("seed") is None else [("seed", result["seed"], "")]),
        ],
        seconds=[(name, f"{value:.2f}", "s") for name, value in result["seconds"].items()],
    )
    return run.folder / REPORT


def _fit_summary(result: Mapping[str, Any]) -> list[str]:
    """The verdict on the fit, sentence by sentence; of an older run that has none, the errors."""
    from ._page import sentences_of

    if found := sentences_of(result):
        return found
    before, after = (result["metrics"][when]["rmse"] for when in ("before", "after"))
    return [f"The fit changed the shadow's error from {number('rmse', before)} to {number('rmse', after)} RMSE."]


def _render_summary(run: StoredRun) -> str:
    (_, errors) = run.errors[-1]
    settings = {row.key: row.value for row in run.settings}
    technique = settings["technique.type"]
    name = f"{technique} with filter {settings['filter.type']}" if technique in _FILTERED else technique
    # The names of engines are written as they are.
    name = name if "." in technique else name.replace("_", " ").capitalize()
    return f"{name}: the shadow's error is {number('rmse', errors['rmse'])} RMSE."


def _fitted(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Each parameter before and after the fit; for poses also the truth and the standard deviation."""
    poses = result.get("poses") or {}
    truth, deviations = poses.get("truth", {}), (poses.get("precision") or {}).get("deviations", {})
    rows = []
    for name, value in result["fitted"].items():
        bounds = result["bounds"][name]
        lower, upper = bounds["lower"], bounds["upper"]
        rows.append(
            {
                "name": name,
                "initial": text_within(result["initial"][name], lower, upper),
                "fitted": text_within(value, lower, upper, 5 if truth else 4),
                "deviation": "" if deviations.get(name) is None else f"± {deviations[name]:.1g}",
                "truth": "" if truth.get(name) is None else text_within(truth[name], lower, upper, 5),
                "unit": bounds["unit"],
                **_sureness(result.get("profiles", {}).get(name)),
                "lower": text_within(lower, lower, upper, 6),
                "upper": text_within(upper, lower, upper, 6),
            }
        )
    return rows


def _front(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The settings of the front of false shadow against false light."""
    return [
        {
            "errors": [number("rmse", point.get(name)) for name in ("false_shadow", "false_light", "rmse")],
            "numbers": [f"{value:.4g}" for value in point["values"].values()],
            "is_knee": point["is_knee"],
        }
        for point in result.get("front", ())
    ]


def _sureness(profile: Mapping[str, Any] | None) -> dict[str, Any]:
    """Where a parameter's error is least, and where it is close to that."""
    if profile is None:
        return {"best": "", "intervals": []}
    ends = [
        [(each[end]["value"], each[end]["is_bound"]) for end in ("lower", "upper")] for each in profile["intervals"]
    ]
    return {"best": f"{profile['best']['value']:.4g}", "intervals": [interval_text(*both) for both in ends]}


def _errors(run: StoredRun) -> list[dict[str, Any]]:
    """Each error of every state, and of the reference itself."""
    own = {"rmse": run.result["metrics"]["reference_noise_floor"]}
    return [
        {
            "label": label,
            "numbers": [number(name, errors.get(name)) for _, errors in run.errors],
            "reference": number(name, own.get(name)),
            "unit": UNITS[name],
        }
        for name, label in ERRORS.items()
    ]


def _aliasing(run: StoredRun) -> list[dict[str, Any]]:
    """Figures of how large texels are on the screen, for each light that has any."""
    measured = [(light["light"], light.get("aliasing")) for light in run.result["metrics"]["lights"]]
    return [
        {
            "key": key,
            "name": {"extent": "longest extent", "perspective": "due to perspective"}[part],
            "numbers": [
                f"{extents['worst']:.3g}",
                f"{extents['percentile_99']:.3g}",
                f"{2 ** extents['mean_log2']:.3g}",
                f"{extents['undersampled']:.1%}",
            ],
        }
        for key, parts in measured
        for part, extents in (parts or {}).items()
    ]


def _validation(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Each error before and after the fit over the views that it has not seen."""
    measured = result["metrics"].get("validation")
    if measured is None:
        return []
    return [
        {
            "label": label,
            "numbers": [number(name, measured[state].get(name)) for state in ("before", "after")],
            "unit": UNITS[name],
        }
        for name, label in ERRORS.items()
    ]


def _by_light(run: StoredRun) -> list[dict[str, Any]]:
    """The errors of each light or view; for views before and after the fit, the worst first."""
    unseen = [light.get("validation", False) for light in run.result["metrics"]["lights"]]
    rows = [
        {
            "key": each.key,
            "before": number("rmse", each.errors[0].get("rmse")),
            "numbers": [number(e, each.errors[-1].get(e)) for e in LIGHT_ERRORS],
            "unseen": unseen[i],
            "order": -(each.errors[-1].get("rmse") or 0),
        }
        for i, each in enumerate(run.lights)
    ]
    return sorted(rows, key=lambda row: row["order"]) if "shown" in run.result["metrics"] else rows


def _light(light: LightImages, limit: float, *, many: bool) -> dict[str, Any]:
    """The pictures of one light or view, with names that are unique on the page."""
    from .. import style
    from ._page import picture

    end = f", {light.key}" if many else ""
    counted = lambda image: np.where(light.mask, image, np.nan)
    visibility = [picture(f"Reference{end}", counted(light.reference), title="Reference")]
    differences = []
    for (title, image), errors in zip(light.images, light.errors, strict=True):
        note = f"RMSE {number('rmse', errors.get('rmse'))}"
        visibility.append(picture(f"{title}{end}", counted(image), note, title=title))
        name, off = f"{title} − reference", counted(image - light.reference)
        differences.append(picture(f"{name}{end}", off, title=name, colours=style.DIFFERENCE, limit=limit))
    return {"key": light.key, "visibility": visibility, "differences": differences}


def _shaded(run: StoredRun) -> list[Any]:
    from ._page import picture

    return [picture(f"{title}, shaded", image, title=title) for title, image in run.shaded]


def _curves(run: StoredRun) -> list[tuple[str, str]]:
    """The curves of a fit as SVG, each with its caption."""
    from .. import style
    from . import _figures as figures

    return [
        (
            style.inline_svg(figures.loss(run), "loss"),
            "The error over the fit. The label of each phase is the width of its soft compare in texels, the blur of "
            "its images in pixels, hard, or search. The result is chosen by the hard compare.",
        ),
        (
            style.inline_svg(figures.parameters(run.result, run.arrays), "parameters"),
            "The parameters over the fit. Dashed lines are bounds, if they are near; dotted lines are the truth, if it "
            "is known. Diamonds mark the result.",
        ),
    ]


def _phases(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    numbers = _numbers_of(result)
    return [
        {
            "compare": _compare(phase),
            "blur": f"{phase.get('blur', 0):.3g}",
            "steps": phase["steps"],
            "error": _error(result, phase["hard_loss"]),
            "gradient": "–" if phase["gradient_norm"] is None else f"{phase['gradient_norm']:.2g}",
            "numbers": numbers(phase["values"]),
            "ended": phase["result"],
            "chosen": i == result["solver"]["chosen_phase"],
        }
        for i, phase in enumerate(result["solver"]["phases"])
    ]


def _error(result: Mapping[str, Any], loss: float | None) -> str:
    """The root of a mean square error, or a user's loss."""
    from . import _figures as figures

    if loss is not None and figures.is_own_loss(result):
        return f"{loss:.4g}"
    return number("rmse", None if loss is None else loss**0.5)


def _loss_heads(result: Mapping[str, Any]) -> dict[str, str]:
    """What tables call the errors of phases and of starts."""
    from . import _figures as figures

    name = "loss" if figures.is_own_loss(result) else "RMSE"
    return {"phases": f"hard {name}", "starts": f"{name} after the first phases, blurred"}


def _numbers_of(result: Mapping[str, Any]) -> Callable[[Mapping[str, float]], list[str]]:
    """Texts of values of the parameters, by name."""
    ends = {name: (bounds["lower"], bounds["upper"]) for name, bounds in result["bounds"].items()}
    return lambda values: [text_within(value, *ends[name]) for name, value in values.items()]


def _compare(phase: Mapping[str, Any]) -> str:
    if phase.get("searched", 0):
        return "hard, by search"
    return "hard" if not phase["width"] else f"{phase['width']:.3g}"


def _starts(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The initial values and the final error of each of several starts, best first."""
    starts, numbers = (result.get("poses") or {}).get("starts") or [], _numbers_of(result)
    return [
        {"error": _error(result, start["loss"]), "numbers": numbers(start["initial"])}
        for start in sorted(starts, key=lambda start: start["loss"])
    ]


def _files(folder: Path) -> dict[str, list[Path]]:
    """The folder's other pictures, by heading. If a picture exists as SVG and PNG, the SVG is used."""
    found: dict[str, list[Path]] = {}
    for suffix in (".svg", ".png", ".webp"):
        for path in sorted(folder.glob(f"*{suffix}"), key=lambda path: (len(path.stem), path.stem)):
            if (
                not path.is_file()
                or path.stem.startswith(_SHOWN)
                or (suffix == ".png" and path.with_suffix(".svg").exists())
            ):
                continue
            heading = next((text for start, text in _HEADINGS.items() if path.stem.startswith(start)), "Other pictures")
            found.setdefault(heading, []).append(path)
    return found
