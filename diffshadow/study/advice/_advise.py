"""Runs a recommendation: fits techniques, times them, and recommends one."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
from rich.console import Console
from rich.table import Table

from ... import io
from ..._words import counted
from ...config import RECOMMENDED_FILE as RECOMMENDED
from ...config import Advice, Config, fit_units, with_fitted
from ...settings.fit import Loss
from ..files._run_folder import folder_of
from ..files._schema import are_measurements, read_json, write_json
from ..files._stored import ADVISE
from ..pages import _table as table
from ..runs._progress import counting
from ..runs._record import versions, write_yaml
from ..sweeps._pace import Pace, saying_how_long
from ..sweeps._run import counts_of, doing, failures, print_plan, record_of, write_record
from ..sweeps._table import rows_of
from ..sweeps._work import FITTED, OK, VALIDATION
from ._candidates import Candidate, front, ranked, recommended
from ._engines import code_file, engine_code, title_of
from ._large import large_biases
from ._measure import LeastBias, least_bias_for, measure_times, single_bias, steps_of, unexplained_by
from ._report import report_advice
from ._special_cases import as_special_case
from ._times import Load, Times
from ._verdict import Findings, verdict

SUFFIX = "-advise"
"""The suffix of the folder of a recommendation."""
_MEASURED = "measured.json"
_COMPILING = "compiling them once more, to time them,"


class _Fitted(NamedTuple):
    """A fit that succeeded: its place among the techniques, its row of results, and its configuration with what was
    fitted."""

    number: int
    row: Mapping[str, Any]
    config: Config


def run_advise(advice: Advice, *, console: Console, scheduler: str | None = None, workers: int | None = None) -> Path:
    """Fits every technique of `advice` that is not fitted yet, times all of them in turns, prints a ranking and a
    verdict, and writes a page and the recommended configuration. For an engine, it ends with the code to paste.

    Fits are done as in `run_sweep`, whose arguments and errors these are. Techniques are timed once all are fitted, in
    this process; what was measured is kept.

    **Returns** the folder, `<output>/<name>-advise`, for an engine `<output>/<name>-advise-<engine>`.

    **Raises** `ValueError` if no technique can be fitted.
    """
    sweep = advice.sweep
    folder = folder_of(sweep.runs[0].config, _suffix(advice)).absolute()
    pace = Pace(console, "fits", "; then they are timed")
    with doing(folder, sweep, ADVISE, console, scheduler, workers, pace=pace) as (tables, _):
        problems = list(failures(tables.results))
        fitted = [
            _Fitted(i, row, with_fitted(sweep.runs[i].config, _values(row)))
            for i, row in enumerate(rows_of(tables.results))
            if row["status"] == OK
        ]
        fitted = [_at_best(each, fitted) for each in fitted]
        if not fitted:
            raise ValueError(f"no technique could be fitted, so none can be recommended: {'; '.join(problems)}")
        steps = steps_of([each.config for each in fitted])
        with counting(console, "timing", steps) as progress:
            times, load = _times(folder, fitted, saying_how_long(console, _COMPILING, len(fitted), progress))
        if load.remark is not None:
            problems.append(f"{load.remark}; to time them again, remove {folder / _MEASURED} and repeat the command")
        candidates = [_candidate(advice, each, time) for each, time in zip(fitted, times, strict=True)]
        noise = _noise(fitted)
        chosen = recommended(candidates, advice.settings.within, noise or 0.0)
        best = next(each.config for each in fitted if each.row["id"] == chosen.id)
        with counting(console, "comparing biases", len(fitted)) as progress:
            least_biases = _least_biases(folder, candidates, chosen, fitted, progress)
        large = list(large_biases(best, noise or 0.0))
        over, within = _over(fitted[0].config), advice.settings.within
        found = Findings(candidates, chosen, within, over, noise, least_biases, large)
        problems = [*unexplained_by(best), *problems]
        code = _code(folder, advice, chosen, best)
        named = best.model_copy(update={"name": sweep.name}).named_with("-recommended")
        with io.atomic_path(folder / RECOMMENDED) as temporary:
            write_yaml(temporary, named)
        whole = record_of(sweep, ADVISE, counts_of(tables.results))
        if advice.engine is not None:
            whole |= {"command": shlex.join([*shlex.split(whole["command"]), "--engine", advice.engine])}
        write_record(folder, whole | {"advice": _record(found, problems) | {"engine": advice.engine, "code": code}})
        report_advice(folder)
    table.print_lines(console, problems, warn=True)
    _print(console, sweep.name, found)
    table.print_lines(console, [f"the recommended configuration is in {RECOMMENDED}"])
    for key, text in code.items():
        assert advice.engine is not None
        table.print_code(console, f"{title_of(advice.engine)}, {key}:", text)
    return folder


def print_advise_plan(console: Console, advice: Advice) -> None:
    """Prints which fits `run_advise` would do. Writes no files."""
    print_plan(console, advice.sweep, suffix=_suffix(advice))


def _suffix(advice: Advice) -> str:
    return SUFFIX if advice.engine is None else f"{SUFFIX}-{advice.engine}"


def _code(folder: Path, advice: Advice, chosen: Candidate, best: Config) -> dict[str, str]:
    """Writes the code for the engine that the advice is for, if it is for one. **Returns** it for each light."""
    if advice.engine is None:
        return {}
    code = engine_code(advice.engine, best, chosen.filter)
    with io.atomic_path(folder / code_file(advice.engine)) as temporary:
        temporary.write_text("\n".join(code.values()), encoding="utf-8")
    return code


def _at_best(one: _Fitted, others: Sequence[_Fitted]) -> _Fitted:
    """`one`, or its technique at a special case's values that were fitted better: a fit may end in a local minimum."""
    loss = one.config.fit.loss
    if not isinstance(loss, Loss) or loss.over != "mean" or loss.false_shadow != loss.false_light:
        # Fits were not made for the least RMSE.
        return one
    error, best = "after.rmse", one
    for other in others:
        if other.row[error] < best.row[error] and (values := as_special_case(one.config, other.config)) is not None:
            row = {name: value for name, value in other.row.items() if not name.startswith(FITTED)}
            row |= {"id": one.row["id"], **{f"{FITTED}{name}": value for name, value in values.items()}}
            best = _Fitted(one.number, row, with_fitted(one.config, values))
    return best


def _values(row: Mapping[str, Any]) -> dict[str, float]:
    """The fitted numbers of a run."""
    found = {name.removeprefix(FITTED): value for name, value in row.items() if name.startswith(FITTED)}
    return {name: value for name, value in found.items() if value is not None}


def _times(folder: Path, fitted: Sequence[_Fitted], progress: Any) -> tuple[list[Times], Load]:
    """The times of all techniques, and how busy the machine was, measured now unless they are stored in `folder`."""
    ids = [each.row["id"] for each in fitted]
    stored = _stored(folder)
    if stored.get("ids") != ids:
        times, load = measure_times([each.config for each in fitted], progress)
        stored = {
            "ids": ids,
            "times": [time._asdict() for time in times],
            "load": load._asdict(),
            "least_biases": {},
        }
        _store(folder, stored)
    return [Times(**time) for time in stored["times"]], Load(**stored["load"])


def _least_biases(
    folder: Path, candidates: Sequence[Candidate], chosen: Candidate, fitted: Sequence[_Fitted], progress: Any
) -> dict[str, tuple[str, LeastBias]]:
    """For each other bias with a single fitted number, with the same filter and map: how large it has to be for no more
    acne than `chosen` has. It is searched for now unless it is stored in `folder`."""
    stored, found = _stored(folder), {}
    for done, (each, candidate) in enumerate(zip(fitted, candidates, strict=True)):
        progress(done)
        name = single_bias(candidate.values)
        alike = (candidate.filter, candidate.resolution) == (chosen.filter, chosen.resolution)
        if not alike or name is None or candidate.bias == chosen.bias:
            continue
        key = f"{candidate.id} {chosen.id}"
        if key not in stored["least_biases"]:
            stored["least_biases"][key] = least_bias_for(each.config, name, chosen.false_shadow)._asdict()
            _store(folder, stored)
        found[candidate.bias] = candidate.units[name], LeastBias(**stored["least_biases"][key])
    return found


def _stored(folder: Path) -> dict[str, Any]:
    """The measurements stored in `folder`; empty if there are none, or they are damaged."""
    try:
        stored = read_json(folder / _MEASURED)
    except io.FileError:
        return {}
    return stored if are_measurements(stored) else {}


def _store(folder: Path, measured: Mapping[str, Any]) -> None:
    with io.atomic_path(folder / _MEASURED) as temporary:
        write_json(temporary, measured)


def _candidate(advice: Advice, each: _Fitted, times: Times) -> Candidate:
    technique, row, values = advice.techniques[each.number], each.row, _values(each.row)
    over = f"{VALIDATION}after" if each.config.validation else "after"
    units = fit_units(each.config)
    return Candidate(
        id=row["id"],
        bias=technique.bias,
        filter=technique.filter,
        resolution=technique.resolution,
        values=values,
        units={name: units[name] for name in values},
        rmse=row[f"{over}.rmse"],
        false_shadow=row[f"{over}.false_shadow_rate"],
        false_light=row[f"{over}.false_light_rate"],
        fit_rmse=row["after.rmse"],
        **times._asdict(),
    )


def _over(config: Config) -> str:
    """What errors are measured over, in words."""
    unseen, seen = len(config.validation), len(config.views)
    count = lambda n: counted(n, "view")
    if unseen:
        return f"{count(unseen)} for validation"
    return f"the {count(seen)} that the fit sees" if seen else "the scene"


def _noise(fitted: Sequence[_Fitted]) -> float | None:
    """The noise floor of the references, the same for all techniques up to the pixels that their maps cover."""
    return fitted[0].row["reference_noise_floor"]


def _record(found: Findings, problems: Sequence[str]) -> dict[str, Any]:
    """The section `advice` of `result.json`."""
    kept = {each.id for each in front(found.candidates)}
    return {
        "over": found.over,
        "noise": found.noise,
        "within": found.within,
        "recommended": found.chosen.id,
        "candidates": [{**each._asdict(), "front": each.id in kept} for each in ranked(found.candidates)],
        "verdict": verdict(found),
        "problems": list(problems),
    }


def _of_times() -> str:
    """What times in the table are of."""
    processor = versions()["processor"]
    where = f"all cores of {processor}" if jax.default_backend() == "cpu" else str(jax.devices()[0].device_kind)
    return (
        f"times are of this renderer on {where}, of one view with all its lights, after compiling: they compare "
        "techniques with each other, and are no times of an engine"
    )


def _print(console: Console, name: str, found: Findings) -> None:
    """Prints the ranking and the verdict."""
    heads = ("bias", "filter", "map", "RMSE", "acne", "leaks", f"{jax.default_backend().upper()} ms", "× fastest")
    shown = Table(*heads, title=table.words(f"{name}: techniques by RMSE over {found.over}"), title_justify="left")
    for column in shown.columns[2:]:
        column.justify = "right"
    kept = {each.id for each in front(found.candidates)}
    for each in ranked(found.candidates):
        marks = ("*" if each.id in kept else " ") + ("←" if each.id == found.chosen.id else " ")
        rates = (table.number("_rate", rate) for rate in (each.false_shadow, each.false_light))
        numbers = (each.size, table.number("rmse", each.rmse), *rates, f"{each.ms:.1f}", f"{each.times} {marks}")
        shown.add_row(table.words(each.bias), table.words(each.filter), *numbers)
    console.print(shown)
    legend = "← is recommended; * marks techniques that no other beats in both RMSE and time"
    table.print_lines(console, [legend, _of_times()])
    table.print_lines(console, verdict(found))
