"""Writes and reads records (`result.json`). Both are checked as strictly as a configuration, so that readers can rely
on them."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import from_json

from ... import io
from ...config import RESULT_FILE as RESULT
from ._parts import DISAGREES, Part, plain, short
from ._runs import FitRecord, FolderRecord, PictureRecord, RenderRecord, ShapeRecord
from ._sweeps import AdviseRecord, SweepRecord

SCHEMA_VERSION = 1
Record = FolderRecord | SweepRecord | AdviseRecord
"""The content of a folder's `result.json`."""
_KINDS: Mapping[str, type[Record]] = {
    each.model_fields["kind"].default: each
    for each in (RenderRecord, FitRecord, PictureRecord, ShapeRecord, SweepRecord, AdviseRecord)
}
# Far more than any run writes.
_MAX_BYTES = 64 << 20
# Keys that come before and after all others, so that readers see a fit's verdict first.
_FIRST, _LAST = ("schema_version", "verdict", "name", "kind"), ("warnings", "seconds", "versions", "seed", "command")
_PYDANTIC = "Input should be "
# Plain words for pydantic's messages, which name Python types.
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


def read_json(file: Path) -> Any:
    """The content of a JSON file.

    **Raises** `FileError` if it cannot be read, is not JSON, or is far larger than any run's.
    """
    try:
        # Reading anything else, such as a pipe, could block forever.
        if not file.is_file():
            raise io.FileError(f"there is no file {file}; expected a file of a run: run it again")
        if file.stat().st_size > _MAX_BYTES:
            raise io.FileError(
                f"{file} has {file.stat().st_size:,} bytes; expected at most {_MAX_BYTES:,}: run it again"
            )
        return from_json(file.read_bytes(), allow_inf_nan=False)
    except io.FileError:
        raise
    except (OSError, ValueError) as error:
        raise io.FileError(f"{file} is damaged ({error}); expected a file of a run: run it again") from error


def json_of(stored: Any) -> bytes:
    """The content of a JSON file that stores `stored`."""
    return (json.dumps(plain(stored), indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def content_of(record: Part, others: Iterable[str] = ()) -> bytes:
    """The content of `result.json`. It lists itself and the names of the `others` in its folder, if there are any."""
    found = record.model_dump(mode="json") | {"schema_version": SCHEMA_VERSION}
    last = (*_LAST, "files")
    inner = [key for key in found if key not in (*_FIRST, *last)]
    if names := list(others):
        found["files"] = sorted([*names, RESULT])
    return json_of({key: found[key] for key in (*_FIRST, *inner, *last) if key in found})


def write_record(folder: Path, record: Record) -> None:
    """Writes `result.json` atomically."""
    with io.atomic_path(folder / RESULT) as temporary:
        temporary.write_bytes(content_of(record))


def read_record(folder: Path) -> Record:
    """The record in `folder`.

    **Raises** `FileError` if there is no such file, if it is damaged (the message names its first invalid key), or if
    it is not the record of a fit, a render, a sweep or a recommendation.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise io.FileError(f"{folder} {what}; expected the folder of a finished run, such as runs/quickstart")
    file = folder / RESULT
    if not file.is_file():
        raise io.FileError(f"{folder} holds no run: it has no {RESULT}; expected the folder of a finished run")
    found = read_json(file)
    kind = found.get("kind") if isinstance(found, dict) else None
    if not isinstance(kind, str) or kind not in _KINDS:
        raise io.FileError(
            f"{file} is not the record of a fit, render, sweep or recommendation; expected one of these: runs inside "
            "a sweep store only numbers, unless sweep.figures is true"
        )
    try:
        return _KINDS[kind].model_validate(found)
    except ValidationError as error:
        raise io.FileError(f"{file} is damaged: {_first(error)}: run it again") from error


def add_files(folder: Path, names: Sequence[str]) -> None:
    """Adds `names` to the files listed in the record in `folder`, so that the next run there replaces them too."""
    result = read_json(folder / RESULT)
    result["files"] = sorted({*result.get("files", ()), *names})
    with io.atomic_path(folder / RESULT) as temporary:
        temporary.write_bytes(json_of(result))


def _first(error: ValidationError) -> str:
    """The first fault in words, and the number of further ones."""
    details = error.errors(include_url=False)
    first, more = details[0], f", and {len(details) - 1} more such faults" if len(details) > 1 else ""
    key, message = ".".join(map(str, first["loc"])), first["msg"]
    if first["type"] == DISAGREES:
        return f"{message}{more}"
    if first["type"] == "missing":
        return f"{key} is missing; expected a file of a run{more}"
    expected = _EXPECTED.get(first["type"])
    if expected is not None:
        expected = expected.format(**first.get("ctx", {}))
    elif message.startswith(_PYDANTIC):
        expected = message.removeprefix(_PYDANTIC)
    else:
        # A fault of a configuration's section. Its message says what was expected.
        return f"{key}: {message}{more}"
    return f"{key} is {short(json.dumps(first['input'], default=str))}; expected {expected}{more}"
