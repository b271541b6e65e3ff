"""The results of finished runs as configurations."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic_core import from_json

from .._errors import ConfigError, Location, Mistake, Origin
from ..sections._config import Config
from ._draft import Draft
from ._dump import data_of
from ._load import checked
from ._overrides import write_value

CONFIG_FILE = "config.yaml"
"""The name of the configuration in a run's folder."""
RESULT_FILE = "result.json"
"""The name of the numbers in a run's folder."""
FITTED_FILE = "fitted.yaml"
"""The name of the configuration with the fitted values, in the folder of a fit."""
RECOMMENDED_FILE = "recommended.yaml"
"""The name of the recommended configuration, in the folder of a recommendation."""
# Significant digits of a fitted value: as many as float32 has.
_DIGITS = 8
_COPY = "copy config.yaml to another folder, set the values of result.json in it, and give that file"


class SettingsFile(NamedTuple):
    """A configuration's file.

    - `origin`: the source of the configuration's values, as a part of a sentence.
    """

    path: Path
    origin: str


def settings_file(path: str | os.PathLike[str], *, sweep: bool = False) -> SettingsFile:
    """The configuration with the values that a run found.

    **Arguments:**

    - `path`: a run's folder, its `config.yaml`, or any other configuration.
    - `sweep`: whether to accept the folder of a sweep, and return the sweep's configuration.

    **Returns** `fitted.yaml` of a fit, `recommended.yaml` of a recommendation, `config.yaml` of a render, and otherwise
    `path`.

    **Raises** `ConfigError` for a folder without a run, a sweep, a failed run, and a fit without `fitted.yaml`.
    """
    given = Path(path)
    # No system accepts a path with a null character. Reading it reports that.
    is_folder = "\0" not in str(given) and given.is_dir()
    folder = given if is_folder else given.parent
    if not is_folder and (given.name != CONFIG_FILE or not (folder / RESULT_FILE).is_file()):
        return SettingsFile(given, str(given))
    result = _result(folder, str(given))
    if result.get("kind") == "fit" and not (folder / CONFIG_FILE).is_file():
        what = "holds a fit that was made in Python, which has no configuration"
        raise _mistake(str(given), f"{what}; expected a run of the command; write the values of result.json into one")
    if sweep and result.get("kind") == "sweep":
        name, origin = CONFIG_FILE, "the sweep"
    else:
        name, origin = _found(result, str(given))
    if not (folder / name).is_file():
        mend = "run it again, because earlier versions did not write it" if name == FITTED_FILE else "run it again"
        raise _mistake(str(given), f"holds an incomplete run: it has no {name}; expected that file; {mend}")
    return SettingsFile(folder / name, f"{origin}, {folder / name}")


def with_fitted(config: Config, values: Mapping[str, float], source: str = "the fitted configuration") -> Config:
    """`config` with these numbers, by key, as its values and as the start of its fit. It has the layout of the fit.

    `source` is the name of the configuration in errors.

    **Raises** `ConfigError` if a value is out of range.
    """
    data, place = data_of(config.with_layout_of_fit()), Location(source)
    for name, value in values.items():
        bounds = config.fit.parameters[name]
        # Rounding may move the value out of its bounds.
        inside = min(max(float(f"{value:.{_DIGITS}g}"), bounds.lower), bounds.upper)
        limits = {"lower": bounds.lower, "upper": bounds.upper}
        write_value(data, {}, name.split("."), inside, place)
        write_value(data, {}, ["fit", "parameters", *name.split(".")], limits, place)
    return checked(Draft(data, Origin(source), Path(), []), fitting=True)


def _found(result: Mapping[str, Any], path: str) -> tuple[str, str]:
    """The name of the file with a run's result, and the source of its values."""
    kind, metrics = result.get("kind"), result.get("metrics")
    if result.get("status") == "failed":
        raise _mistake(path, "holds a run that failed; expected a finished one; read the error in result.json")
    if kind == "sweep":
        raise _mistake(path, "holds a sweep; expected a single run; give one of the folders in runs/")
    if kind == "advise":
        return RECOMMENDED_FILE, "the recommended technique"
    # The records of a sweep's runs have no kind.
    is_fit = kind == "fit" or (isinstance(metrics, Mapping) and any(key.startswith("fitted.") for key in metrics))
    if is_fit and any(name.startswith("scene.") for name in _names(result)):
        what = "holds a fit of lights or meshes, and no configuration in the folder has the fitted values"
        raise _mistake(path, f"{what}; expected a fit of the technique alone; {_COPY}")
    return (FITTED_FILE, "the fit") if is_fit else (CONFIG_FILE, "the run")


def _names(result: Mapping[str, Any]) -> list[str]:
    """The names of the numbers that a run fitted."""
    fitted, metrics = result.get("fitted"), result.get("metrics")
    if isinstance(fitted, Mapping):
        return list(fitted)
    return [key.removeprefix("fitted.") for key in metrics] if isinstance(metrics, Mapping) else []


def _result(folder: Path, path: str) -> Mapping[str, Any]:
    """The content of `result.json`."""
    expected = "expected a configuration in YAML, or the folder of a finished run"
    # Reading anything else, such as a pipe, could block forever.
    if not (folder / RESULT_FILE).is_file():
        raise _mistake(path, f"is a folder without {RESULT_FILE}; {expected}; check the path")
    try:
        result = from_json((folder / RESULT_FILE).read_bytes())
    except OSError as error:
        raise _mistake(path, f"cannot be read ({error.strerror}); {expected}; check its permissions") from error
    except ValueError:
        result = None
    if not isinstance(result, Mapping):
        raise _mistake(path, f"holds a damaged {RESULT_FILE}; {expected}; run it again")
    return result


def _mistake(path: str, what: str) -> ConfigError:
    return ConfigError([Mistake(Location(path), "", what)])
