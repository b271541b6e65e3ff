"""What a run writes down: `result.json`, `config.yaml` and the arrays."""

import importlib.metadata
import json
import math
import platform
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from .. import metrics
from ..config import Config, dump_resolved

SCHEMA_VERSION = 1
_PACKAGES = ("diffshadow", "jax", "jaxlib", "equinox", "optimistix", "numpy")


def versions() -> dict[str, str]:
    """What the numbers of a run were computed with."""
    device = jax.devices()[0]
    return {
        **{name: importlib.metadata.version(name) for name in _PACKAGES},
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "device": f"{device.platform} ({device.device_kind})",
    }


def command(verb: str, folder: Path) -> str:
    """What to type to have the run of `folder` once more."""
    return shlex.join(["diffshadow", verb, str(folder / "config.yaml")])


def measured(image: Any, reference: Any, mask: Any) -> dict[str, float]:
    """The errors of `image` (h, w) by name."""
    return metrics.measure_errors(image, reference, mask).as_dict()


def write_config(folder: Path, config: Config) -> None:
    """Writes `config.yaml`, with every default spelt out."""
    (folder / "config.yaml").write_text(dump_resolved(config), encoding="utf-8")


def write_arrays(folder: Path, arrays: Mapping[str, Any]) -> None:
    """Writes `arrays.npz`."""
    np.savez_compressed(folder / "arrays.npz", allow_pickle=False, **{k: np.asarray(a) for k, a in arrays.items()})


def write_result(folder: Path, record: Mapping[str, Any]) -> None:
    """Writes `result.json`, last, for it names all other files."""
    files = sorted([*(entry.name for entry in folder.iterdir()), "result.json"])
    whole = _plain({"schema_version": SCHEMA_VERSION, **record, "files": files})
    text = json.dumps(whole, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "result.json").write_text(text + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """`value` with numbers that JSON can hold; one that is not finite becomes null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
