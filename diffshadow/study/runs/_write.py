"""Writes the folder of a finished run."""

import importlib.metadata
import os
import platform
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np

from ...config import CONFIG_FILE, FITTED_FILE, Config, dump_resolved, with_fitted
from ..record._files import RESULT, content_of
from ..record._folder import write_whole
from ..record._runs import FolderRecord
from ..record._stored import ARRAYS, StoredRun, stored

_PACKAGES = ("diffshadow", "jax", "jaxlib", "equinox", "optimistix", "numpy")


class Finished(Protocol):
    """A run with its measurements and remarks: its images, and what is known about them."""

    @property
    def config(self) -> Config | None:
        """None for a fit that was made in Python."""
        ...

    @property
    def stored_configs(self) -> Mapping[str, Config]:
        """The configurations that its folder holds, by the names of their files."""
        ...

    def record(self, **about: Any) -> FolderRecord:
        """Its record; `about` has times, versions, and the command that repeats the run."""
        ...

    def arrays(self) -> Mapping[str, Any]:
        """The content of `arrays.npz`."""
        ...

    def write(self, draft: Path, run: StoredRun[Any]) -> None:
        """Writes its pictures and other files to `draft`."""
        ...


def write_run(folder: Path, finished: Finished, seconds: Mapping[str, float], verb: str = "fit") -> FolderRecord:
    """Writes the folder of a run: all of its files, or none. **Returns** its record.

    **Arguments:** `seconds`: the times of its stages; `verb`: the name of the command that repeats it.
    """
    config = finished.config
    about: dict[str, Any] = {"seconds": {name: round(s, 3) for name, s in seconds.items()}, "versions": versions()}
    if config is not None:
        about |= {"seed": config.seed, "command": shlex.join(["diffshadow", verb, str(folder / CONFIG_FILE)])}
    record, arrays = finished.record(**about), finished.arrays()

    def write(draft: Path) -> None:
        # Imported here, since only a run that gets this far needs Matplotlib.
        from ..pages._report import write_report

        run = stored(draft, record, arrays, config)
        for name, each in finished.stored_configs.items():
            (draft / name).write_bytes(yaml_of(each))
        np.savez_compressed(draft / ARRAYS, allow_pickle=False, **run.arrays)
        finished.write(draft, run)
        write_report(run)
        # Last, since it lists all other files.
        (draft / RESULT).write_bytes(content_of(record, (entry.name for entry in draft.iterdir())))

    write_whole(folder, write)
    return record


def versions() -> dict[str, str]:
    """The software and hardware that a run was computed with."""
    device = jax.devices()[0]
    return {
        **{name: importlib.metadata.version(name) for name in _PACKAGES},
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "device": f"{device.platform} ({device.device_kind})",
        "processor": _processor(),
    }


def _processor() -> str:
    """The processor's model, if the system reports it, and its number of cores."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.processor() or platform.machine()}, {os.cpu_count()} cores"


def configs_of_fit(config: Config, values: Mapping[str, float]) -> dict[str, Config]:
    """The configurations that the folder of a fit of `config` holds: with the layout that it was drawn with, and with
    the `values` that were fitted. No keys can state where lights and meshes moved, so a fit of lights or meshes has no
    `fitted.yaml`.
    """
    found = {CONFIG_FILE: config.with_layout_of_fit()}
    if values and not config.moves:
        found[FITTED_FILE] = with_fitted(config.named_with("-fitted"), values)
    return found


def yaml_of(config: Config) -> bytes:
    """The content of a YAML file with all of `config`."""
    return dump_resolved(config).encode("utf-8", errors="backslashreplace")
