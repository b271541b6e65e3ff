"""Writes the folder of a fit that was made in Python."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from rich.console import Console

from ... import fit, reference
from ..._checks import check_instance
from ..._words import counted
from ...config import FitPlan
from .._drawn import Drawn
from ..files._run_folder import checked_folder
from ..remarks._fit import remarks
from ..remarks._layout import layout_remarks
from ..remarks._verdict import verdict
from . import _record as record
from ._explained import fitted_images, unexplained
from ._fitted import FittedRun, Images, States, states_of
from ._picture import save_picture
from ._progress import Stages
from ._views import DrawnView, Views
from ._write_fit import write_fit


def save_fit(result: fit.FitResult, folder: str | os.PathLike[str], *, names: Sequence[str] | None = None) -> Path:
    """Writes a fit that was made in Python: the folder and the report of `diffshadow fit`.

    It holds `result.json`, `arrays.npz`, pictures and `report.html`, which `diffshadow report` and `diffshadow compare`
    read as any other run's. It has no configuration, so there are no `config.yaml`, no table of settings, no command
    that repeats it and no engine's code. What the fit says of its settings and remarks is in the words of Python. The
    shaded pictures need the scene, which `TechniqueProblem.of` keeps.

    **Arguments:**

    - `result`: what `fit.fit` returned.
    - `folder`: such as `"runs/mine"`. Its last part is the run's name. An earlier run there is replaced once everything
        is written.
    - `names`: of the problems, in their order, for tables and captions; `image 0`, `image 1` and so on if left out.

    **Returns** the folder.

    **Raises** `FileError` if the folder cannot be written, or holds something other than a run; `ValueError` if the
    problems have images of several sizes, or there are not as many different names as problems; and `TypeError` for
    problems of a user's own kind.
    """
    check_instance("what to save", result, fit.FitResult, "a FitResult, which fit.fit returns")
    into = checked_folder(folder)
    kinds: Any = fit.TechniqueProblem
    if result.arrangement is not None:
        kinds = fit.PictureProblem if isinstance(result.problems[0], fit.PictureProblem) else fit.PoseProblem
    for problem in result.problems:
        check_instance("a problem of the fit", problem, kinds, f"a {kinds.__name__}")
    shapes = list(dict.fromkeys(tuple(problem.shape) for problem in result.problems))
    if len(shapes) != 1 or not result.parameters:
        listed = " and ".join(f"{height} x {width}" for height, width in shapes) or "no"
        raise ValueError(
            f"the fit has images of {listed} pixels, (height x width), and "
            f"{counted(len(result.parameters), 'parameter')}; expected images of one size, "
            "and what fit.fit returned: save one fit for each size"
        )
    stages = Stages(Console(quiet=True))
    stages.seconds |= {"compiling": result.seconds_compiling, "fitting": result.seconds_running}
    if kinds is fit.PictureProblem:
        save_picture(result, _plan(result), into, into.resolve().name, stages.seconds)
        return into
    with stages.stage("measuring"):
        fitted = _fitted(result, into.resolve().name, _names(result, names), stages)
    write_fit(into, fitted, stages.seconds)
    return into


def _names(result: fit.FitResult, names: Sequence[str] | None) -> list[str]:
    count = len(result.problems)
    if names is None:
        return ["image"] if count == 1 else [f"image {i}" for i in range(count)]
    named = [names] if isinstance(names, str) else list(map(str, names))
    if len(set(named)) != count or not all(named):
        raise ValueError(f"the names are {', '.join(named) or 'none'}; expected {count} different ones, one a problem")
    return named


def _fitted(result: fit.FitResult, name: str, keys: Sequence[str], stages: Stages) -> FittedRun:
    """The fit as it is written."""
    plan = _plan(result)
    drawn = [_drawn(problem, key, result) for problem, key in zip(result.problems, keys, strict=True)]
    images, seen = states_of(plan, result, result.problems, drawn, stages)
    if result.arrangement is not None:
        # Where lights and meshes truly are is not known, so the reference is shown where the fit leaves them.
        drawn = seen[1]
    return _measured(plan, result, name, _views(drawn), images, seen)


def _measured(
    plan: FitPlan, result: fit.FitResult, name: str, views: Views, images: tuple[Images, Images], seen: States
) -> FittedRun:
    drawn, (before, after) = views.drawn, images
    errors_before, errors_after = (list(map(record.measured, each, drawn)) for each in images)
    left = unexplained(fitted_images(views, drawn, after, seen[1], result))
    at_first, at_last = (record.combined(errors, drawn)["rmse"] for errors in (errors_before, errors_after))
    said = verdict(None, result, at_first, at_last, left)
    of_layout = layout_remarks(result.technique, [each.key for each in drawn], [each.state for each in drawn])
    messages = [*of_layout, *remarks(None, result, said.kind)]
    errors = errors_before, errors_after
    has_scene = all(each.scene is not None for each in drawn)
    return FittedRun(name, None, plan, views, drawn, result, before, after, *errors, messages, seen, said, has_scene)


def _views(drawn: Sequence[Drawn]) -> Views:
    # Which problems are lights of one image is not known: each is shown alone.
    return Views([DrawnView(each.key, None, None, [each]) for each in drawn], [])


def _plan(result: fit.FitResult) -> FitPlan:
    """What a configuration says of a fit, as far as it is known."""
    moving: Any = result.problems[0] if result.arrangement is not None else None
    return FitPlan(
        parameters=list(result.parameters),
        solver=result.solver,
        anneal=fit.Anneal(),
        loss=None,
        search=result.search,
        sureness=result.sureness,
        arrangement=None if moving is None else moving.arrangement,
        truth={},
    )


def _drawn(problem: Any, key: str, result: fit.FitResult) -> Drawn:
    """The scene of a problem, and its reference."""
    if result.arrangement is None:
        state, surface, mask = problem.shadow_map, problem.surface, problem.mask
    else:
        (state, surface), mask = problem.draw(result.arrangement), problem.weight > 0
    visibility, mask = np.asarray(problem.reference, np.float32), np.asarray(mask)
    # A problem keeps no more of its reference, and not how it was found.
    truth = reference.Reference(
        visibility=visibility,
        mask=mask,
        position=np.asarray(surface.position, np.float32),
        normal=np.asarray(surface.normal, np.float32),
        face=np.asarray(surface.face, np.int32),
        samples=0,
        standard_error=np.zeros_like(visibility),
    )
    # A technique's problem may lack the scene. Only pictures need it, and `has_pictures` says so.
    return Drawn(key, cast(Any, problem.scene), state, surface, truth, mask)
