"""The schema of `result.json`, checked as strictly as a configuration, so that readers can rely on it.

Unknown keys are ignored, since a later version or a user may have added them.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import from_json

from ... import io
from ._schema_of_runs import Fit, Picture, Render, Shape
from ._schema_of_sweeps import Advise, Measurements, Outcome, Sweep
from ._schema_parts import DISAGREES, Part, short

# Far more than any run writes.
_MAX_BYTES = 64 << 20
_PYDANTIC = "Input should be "
# Plain words for pydantic's messages, which name Python's types.
_EXPECTED = {
    "model_type": "a section with keys",
    "dict_type": "a section with keys",
    "list_type": "a list",
    "string_type": "text",
    "int_type": "a whole number",
    "float_type": "a number",
    "greater_than_equal": "at least {ge:g}",
    "less_than_equal": "at most {le:g}",
}
_KINDS: Mapping[str, type[Part]] = {
    "render": Render,
    "fit": Fit,
    "shape": Shape,
    "picture": Picture,
    "sweep": Sweep,
    "advise": Advise,
}


def read_json(file: Path) -> Any:
    """The content of a JSON file.

    **Raises** `FileError` if it cannot be read, is not JSON, or is far larger than any run's.
    """
    try:
        # Reading anything else, such as a pipe, could block forever.
        if not file.is_file():
            raise io.FileError(f"there is no file {file}; expected what a run wrote: run it again")
        if file.stat().st_size > _MAX_BYTES:
            raise io.FileError(
                f"{file} has {file.stat().st_size:,} bytes; expected at most {_MAX_BYTES:,}: run it again"
            )
        return from_json(file.read_bytes(), allow_inf_nan=False)
    except io.FileError:
        raise
    except (OSError, ValueError) as error:
        raise io.FileError(f"{file} is damaged ({error}); expected what a run wrote: run it again") from error


def write_json(file: Path, value: Any) -> None:
    """Writes `value` to a JSON file, as `read_json` reads it."""
    file.write_bytes(json_of(_plain(value)))


def json_of(stored: Any) -> bytes:
    """The content of a JSON file with what `as_stored` returned."""
    return (json.dumps(stored, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _plain(value: Any) -> Any:
    """`value` in a form that JSON can hold: non-finite numbers become null, and lone surrogates are escaped."""
    if isinstance(value, Mapping):
        return {_plain(str(key)): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, str):
        # Python uses lone surrogates for bytes of paths that are not UTF-8.
        return value.encode("utf-8", "backslashreplace").decode("utf-8")
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def as_stored(result: Mapping[str, Any]) -> dict[str, Any]:
    """What `result.json` holds of a run, a sweep or a recommendation: the keys of the schema, and no other.

    **Raises** `ValidationError` for a key or a value that readers would not take.
    """
    kind = _KINDS.get(result.get("kind", ""), Outcome)
    stored = kind.model_validate(_plain(result), extra="forbid").model_dump(mode="json", exclude_unset=True)
    # In the order that they were given in, so that a fit's verdict comes first.
    return {key: stored[key] for key in result}


def checked_result(result: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """The known keys of the result of a fit, a render, a sweep or a recommendation. `file` is where it came from.

    **Raises** `FileError` that names the first invalid key.
    """
    try:
        return _KINDS[result["kind"]].model_validate(result).model_dump(exclude_unset=True)
    except ValidationError as error:
        raise io.FileError(f"{file} is damaged: {_first(error)}: run it again") from error


def is_outcome(stored: Any, id: str, kinds: Mapping[str, type], others: tuple[str, ...]) -> bool:
    """Whether `stored` is a valid outcome of the run `id` of a sweep.

    **Arguments:**

    - `stored`: the content of the run's `result.json`.
    - `kinds`: the types of the metrics of a successful run, by name.
    - `others`: the prefixes of the names of further metrics; if empty, there are none.
    """
    try:
        outcome = Outcome.model_validate(stored)
    except ValidationError:
        return False
    if outcome.id != id or (outcome.status == "ok") != (outcome.error is None):
        return False
    if outcome.status == "failed":
        return not outcome.metrics
    further = outcome.metrics.keys() - kinds.keys()
    return (
        kinds.keys() <= outcome.metrics.keys()
        and all(outcome.metrics[name] is None or isinstance(outcome.metrics[name], kinds[name]) for name in kinds)
        and all(name.startswith(others) for name in further)
    )


def are_measurements(stored: Any) -> bool:
    """Whether `stored` is what a recommendation keeps of its measurements."""
    try:
        found = Measurements.model_validate(stored)
    except ValidationError:
        return False
    return len(found.ids) == len(found.times)


def _first(error: ValidationError) -> str:
    """The first fault in words, and the number of further ones."""
    details = error.errors(include_url=False)
    first, more = details[0], f", and {len(details) - 1} more such faults" if len(details) > 1 else ""
    key, message = ".".join(map(str, first["loc"])), first["msg"]
    if first["type"] == DISAGREES:
        return f"{message}{more}"
    if first["type"] == "missing":
        return f"{key} is missing; expected what a run wrote{more}"
    expected = _EXPECTED.get(first["type"])
    if expected is not None:
        expected = expected.format(**first.get("ctx", {}))
    elif message.startswith(_PYDANTIC):
        expected = message.removeprefix(_PYDANTIC)
    else:
        # A fault of a section of the configuration, whose message says what was expected.
        return f"{key}: {message}{more}"
    return f"{key} is {short(json.dumps(first['input'], default=str))}; expected {expected}{more}"
