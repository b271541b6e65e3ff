"""Writes the folder of a fit that was made in Python."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from ... import fit, reference
from ..._checks import check_instance
from ..._words import counted
from .._drawn import Drawn
from ..record._folder import checked_folder
from ._picture import FittedPicture
from ._progress import Progress
from ._views import DrawnView, Views
from ._visibility import FittedRun, states_of
from ._write import Finished, write_run


def save_fit(result: fit.FitResult, folder: str | os.PathLike[str], *, names: Sequence[str] | None = None) -> Path:
    """Writes a fit that was made in Python: the folder and the report of `diffshadow fit`.

    The folder has `result.json`, `arrays.npz`, pictures and `report.html`. `diffshadow report` and `diffshadow compare`
    read it like the folder of any run. A fit from Python has no configuration, so the folder has no `config.yaml`, and
    the report has no table of settings, no command to repeat it and no engine's code. Settings and remarks use the
    names of Python. The shaded pictures need the scene, which `TechniqueProblem.of` keeps.

    **Arguments:**

    - `result`: what `fit.fit` returned.
    - `folder`: such as `"runs/mine"`. Its last part is the run's name. An earlier run there is replaced once everything
        is written.
    - `names`: names of the problems, in their order, for tables and captions; `image 0`, `image 1` and so on if left
        out.

    **Returns** the folder.

    **Raises** `FileError` if the folder cannot be written, or holds something other than a run; `ValueError` if the
    problems have images of several sizes, or unless there is a different name for each problem; and `TypeError` for
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
    progress, name = Progress.quiet(), into.resolve().name
    progress.seconds |= {"compiling": result.seconds_compiling, "fitting": result.seconds_running}
    with progress.stage("measuring"):
        if kinds is fit.PictureProblem:
            run: Finished = FittedPicture.of(name, None, result, {}, [])
        else:
            run = _measured(name, result, _names(result, names), progress)
    write_run(into, run, progress.seconds)
    return into


def _names(result: fit.FitResult, names: Sequence[str] | None) -> list[str]:
    count = len(result.problems)
    if names is None:
        return ["image"] if count == 1 else [f"image {i}" for i in range(count)]
    named = [names] if isinstance(names, str) else list(map(str, names))
    if len(set(named)) != count or not all(named):
        raise ValueError(f"the names are {', '.join(named) or 'none'}; expected {count} different ones, one a problem")
    return named


def _measured(name: str, result: fit.FitResult, keys: Sequence[str], progress: Progress) -> FittedRun:
    """The fit as it is written."""
    drawn = [_drawn(problem, key, result) for problem, key in zip(result.problems, keys, strict=True)]
    states = states_of(result, result.problems, drawn, progress)
    if result.arrangement is not None:
        # Where lights and meshes truly are is not known, so the reference is shown where the fit leaves them.
        drawn = states[1].drawn
    # Which problems are lights of one image is not known: each is shown alone.
    views = Views([DrawnView(each.key, None, None, [each]) for each in drawn], [])
    return FittedRun(name, None, result, {}, views, drawn, *states)


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
    # A technique's problem may lack the scene. Only pictures need it.
    return Drawn(key, cast(Any, problem.scene), state, surface, truth, mask)
