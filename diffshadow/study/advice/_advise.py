"""Runs a recommendation: fits techniques, times them, and recommends one."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
from pydantic import ValidationError
from rich.console import Console
from rich.table import Table

from ... import io
from ..._words import counted
from ...config import RECOMMENDED_FILE as RECOMMENDED
from ...config import Advice, Config, fit_units, with_fitted
from ...console import print_table
from ...settings.fit import Loss
from ..pages import _table as table
from ..record import _sweeps as record
from ..record._files import json_of, read_json, write_record
from ..record._folder import folder_of
from ..record._sweeps import AdviseRecord, Candidate, LeastBias, Measurements, Times
from ..runs._progress import counting
from ..runs._write import versions, yaml_of
from ..sweeps._pace import Pace, saying_how_long
from ..sweeps._run import about, counts_of, doing, failures, print_plan
from ..sweeps._table import rows_of
from ..sweeps._work import FITTED, OK, VALIDATION
from ._candidates import front, ranked, recommended
from ._engines import code_file, engine_code, title_of
from ._large import large_biases
from ._measure import least_bias_for, measure_times, single_bias, steps_of, unexplained_by
from ._my_scene import store_pictures
from ._report import report_advice
from ._special_cases import as_special_case
from ._times import busy_remark
from ._verdict import Findings, verdict

SUFFIX = "-advise"
"""The suffix of the folder of a recommendation."""
_MEASURED = "measured.json"
_COMPILING = "compiling them once more, to time them,"


class _Fitted(NamedTuple):
    """A successful fit: the index of its technique, its row of results, and its configuration with the fitted
    values."""

    number: int
    row: Mapping[str, Any]
    config: Config


def run_advise(advice: Advice, *, console: Console, scheduler: str | None = None, workers: int | None = None) -> Path:
    """Fits every technique of `advice` that is not fitted yet, times all of them in turns, prints a ranking and a
    verdict, and writes a page and the recommended configuration. For an engine, it also prints code to paste.

    Arguments and errors of the fits are the same as in `run_sweep`. All techniques are timed in this process after the
    last fit, and the times are stored.

    **Returns** the folder, `<output>/<name>-advise`, or `<output>/<name>-advise-<engine>` for an engine.

    **Raises** `ValueError` if no technique can be fitted.
    """
    sweep = advice.sweep
    folder = folder_of(sweep.runs[0].config, _suffix(advice)).absolute()
    pace = Pace(console, "fits", "; then they are timed")
    with doing(folder, sweep, AdviseRecord, console, scheduler, workers, pace=pace) as (tables, _):
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
            measured = _measured(folder, fitted, saying_how_long(console, _COMPILING, len(fitted), progress))
        if (busy := busy_remark(measured.load)) is not None:
            problems.append(f"{busy}; to time them again, remove {folder / _MEASURED} and repeat the command")
        candidates = [_candidate(advice, each, time) for each, time in zip(fitted, measured.times, strict=True)]
        # The same for all techniques, except for the pixels that their maps cover.
        noise = fitted[0].row["reference_noise_floor"]
        chosen = recommended(candidates, advice.settings.within, noise or 0.0)
        best = next(each.config for each in fitted if each.row["id"] == chosen.id)
        with counting(console, "comparing biases", len(fitted)) as progress:
            least_biases = _least_biases(folder, measured, candidates, chosen, fitted, progress)
        large = list(large_biases(best, noise or 0.0))
        over, within = _over(fitted[0].config), advice.settings.within
        found = Findings(candidates, chosen, within, over, noise, least_biases, large)
        problems = [*unexplained_by(best), *problems]
        code = _code(folder, advice, chosen, best)
        if advice.engine is not None:
            store_pictures(folder, best)
        named = best.model_copy(update={"name": sweep.name}).named_with("-recommended")
        with io.atomic_path(folder / RECOMMENDED) as temporary:
            temporary.write_bytes(yaml_of(named))
        whole = about(sweep, AdviseRecord, counts_of(tables.results))
        if advice.engine is not None:
            whole["command"] = shlex.join([*shlex.split(whole["command"]), "--engine", advice.engine])
        said = verdict(found)
        stored = AdviseRecord(
            **whole,
            advice=record.Advice(
                engine=advice.engine,
                code=code,
                over=over,
                noise=noise,
                within=within,
                recommended=chosen.id,
                candidates=_marked(candidates),
                verdict=said,
                problems=problems,
            ),
        )
        write_record(folder, stored)
        report_advice(folder, stored)
    table.print_lines(console, problems, warn=True)
    _print(console, sweep.name, found, said)
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
    """Writes the code for the engine of the advice, if there is one. **Returns** the code for each light."""
    if advice.engine is None:
        return {}
    code = engine_code(advice.engine, best, chosen.filter)
    with io.atomic_path(folder / code_file(advice.engine)) as temporary:
        temporary.write_text("\n".join(code.values()), encoding="utf-8")
    return code


def _at_best(one: _Fitted, others: Sequence[_Fitted]) -> _Fitted:
    """`one`, or its technique with the better values of a special case. A fit may end in a local minimum."""
    loss = one.config.fit.loss
    if not isinstance(loss, Loss) or loss.over != "mean" or loss.false_shadow != loss.false_light:
        # These fits do not minimise the RMSE.
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


def _measured(folder: Path, fitted: Sequence[_Fitted], progress: Any) -> Measurements:
    """The times of all techniques, and the load of the machine. They are measured now unless they are stored in
    `folder`."""
    ids = [each.row["id"] for each in fitted]
    try:
        stored = Measurements.model_validate(read_json(folder / _MEASURED))
    except (io.FileError, ValidationError):
        stored = None
    if stored is None or stored.ids != ids:
        times, load = measure_times([each.config for each in fitted], progress)
        stored = Measurements(ids=ids, times=times, load=load, least_biases={})
        _store(folder, stored)
    return stored


def _least_biases(
    folder: Path,
    measured: Measurements,
    candidates: Sequence[Candidate],
    chosen: Candidate,
    fitted: Sequence[_Fitted],
    progress: Any,
) -> dict[str, tuple[str, LeastBias]]:
    """For each other bias with a single fitted number, with the same filter and map: the value at which it has no more
    acne than `chosen`. The value is searched for now unless it is stored in `folder`."""
    known, found = dict(measured.least_biases), {}
    for done, (each, candidate) in enumerate(zip(fitted, candidates, strict=True)):
        progress(done)
        name = single_bias(candidate.values)
        alike = (candidate.filter, candidate.resolution) == (chosen.filter, chosen.resolution)
        if not alike or name is None or candidate.bias == chosen.bias:
            continue
        key = f"{candidate.id} {chosen.id}"
        if key not in known:
            known[key] = least_bias_for(each.config, name, chosen.false_shadow)
            _store(folder, measured.model_copy(update={"least_biases": known}))
        found[candidate.bias] = candidate.units[name], known[key]
    return found


def _store(folder: Path, measured: Measurements) -> None:
    with io.atomic_path(folder / _MEASURED) as temporary:
        temporary.write_bytes(json_of(measured.model_dump(mode="json")))


def _candidate(advice: Advice, each: _Fitted, times: Times) -> Candidate:
    technique, row, values = advice.techniques[each.number], each.row, _values(each.row)
    over = f"{VALIDATION}after" if each.config.validation else "after"
    units = fit_units(each.config)
    return Candidate(
        id=row["id"],
        bias=technique.bias,
        filter=technique.filter,
        resolution=list(technique.resolution),
        values=values,
        units={name: units[name] for name in values},
        rmse=row[f"{over}.rmse"],
        false_shadow=row[f"{over}.false_shadow_rate"],
        false_light=row[f"{over}.false_light_rate"],
        fit_rmse=row["after.rmse"],
        **times.model_dump(),
    )


def _over(config: Config) -> str:
    """The images that errors are measured over, in words."""
    unseen, seen = len(config.validation), len(config.views)
    count = lambda n: counted(n, "view")
    if unseen:
        return f"{count(unseen)} for validation"
    return f"the {count(seen)} that the fit sees" if seen else "the scene"


def _marked(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates in order of error. Candidates on the front are marked."""
    kept = {each.id for each in front(candidates)}
    return [each.model_copy(update={"front": each.id in kept}) for each in ranked(candidates)]


def _of_times() -> str:
    """The meaning of the table's times."""
    processor = versions()["processor"]
    where = f"all cores of {processor}" if jax.default_backend() == "cpu" else str(jax.devices()[0].device_kind)
    return (
        f"times are for this renderer on {where}, for one view with all its lights, after compilation: they compare "
        "techniques, and do not predict the times of an engine"
    )


def _print(console: Console, name: str, found: Findings, said: Sequence[str]) -> None:
    """Prints the ranking and the verdict."""
    heads = ("bias", "filter", "map", "RMSE", "acne", "leaks", f"{jax.default_backend().upper()} ms", "× fastest")
    shown = Table(*heads, title=table.words(f"{name}: techniques by RMSE over {found.over}"), title_justify="left")
    for column in shown.columns[2:]:
        column.justify = "right"
    for each in _marked(found.candidates):
        marks = ("*" if each.front else " ") + ("←" if each.id == found.chosen.id else " ")
        rates = (table.number("_rate", rate) for rate in (each.false_shadow, each.false_light))
        numbers = (each.size, table.number("rmse", each.rmse), *rates, f"{each.ms:.1f}", f"{each.times} {marks}")
        shown.add_row(table.words(each.bias), table.words(each.filter), *numbers)
    print_table(console, shown)
    legend = "← is recommended; * marks techniques that no other beats in both RMSE and time"
    table.print_lines(console, [legend, _of_times()])
    table.print_lines(console, said)
