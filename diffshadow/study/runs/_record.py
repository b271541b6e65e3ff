"""Records of a run: `result.json`, `config.yaml` and the arrays."""

import dataclasses
import importlib.metadata
import math
import os
import platform
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ... import metrics, shadow
from ...config import CONFIG_FILE, FITTED_FILE, Config, dump_resolved, with_fitted
from .._drawn import Drawn
from ..files._run_folder import RESULT
from ..files._schema import as_stored, json_of
from ..files._stored import ARRAYS

SCHEMA_VERSION = 1
_PACKAGES = ("diffshadow", "jax", "jaxlib", "equinox", "optimistix", "numpy")


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


def command(verb: str, folder: Path) -> str:
    """The shell command that repeats the run of `folder`."""
    return shlex.join(["diffshadow", verb, str(folder / CONFIG_FILE)])


def measured(image: Any, drawn: Drawn) -> dict[str, float]:
    """The errors of `image` (h, w) by name; NaN if no pixel counts."""
    if not drawn.pixels:
        return {field.name: math.nan for field in dataclasses.fields(metrics.ShadowErrors)}
    return metrics.measure_errors(image, drawn.reference.visibility, drawn.mask).as_dict()


def combined(errors: Sequence[Mapping[str, float]], drawn: Sequence[Drawn]) -> dict[str, float]:
    """The errors of all lights together: means weighted by the number of pixels that count; RMSEs by their squares."""
    pixels = np.asarray([each.pixels for each in drawn], np.float64)
    weights = pixels / pixels.sum()
    return {
        name: math.sqrt(_mean([one[name] ** 2 for one in errors], weights))
        if name == "rmse"
        else _mean([one[name] for one in errors], weights)
        for name in errors[0]
    }


def aliasing(technique: shadow.AbstractTechnique, drawn: Drawn) -> dict[str, dict[str, float]] | None:
    """Figures of how large the technique's texels are on the screen, and of the part due to perspective; none without
    a shadow map, or if no surface lies in it and faces the light."""
    if not isinstance(technique, shadow.ShadowMapping):
        return None
    found = technique.aliasing(drawn.state, drawn.surface, drawn.scene.camera)
    if not np.asarray(found.mask).any():
        return None
    extents = {"extent": found.extent, "perspective": found.perspective_extent}
    return {name: metrics.measure_aliasing(extent, found.mask).as_dict() for name, extent in extents.items()}


def _mean(values: Sequence[float], weights: np.ndarray) -> float:
    # A light without pixels that count has weight 0, and its errors are NaN.
    return float(sum(value * weight for value, weight in zip(values, weights, strict=True) if weight > 0))


def noise(drawn: Sequence[Drawn]) -> float | None:
    """The reference's own error over all lights; `None` if it is unknown."""
    floors = [each.noise_floor for each in drawn]
    if any(floor is None for floor in floors):
        return None
    return combined([{"rmse": floor} for floor in floors if floor is not None], drawn)["rmse"]


def suffix(index: int, drawn: Sequence[Drawn]) -> str:
    """Suffix of the files of the light at `index`; empty if there is only one light."""
    return "" if len(drawn) == 1 else f"_{index}"


def stacked(images: Sequence[Any]) -> np.ndarray:
    """One image (h, w), or the images of several lights (l, h, w)."""
    return np.asarray(images[0]) if len(images) == 1 else np.stack([np.asarray(image) for image in images])


def light_arrays(drawn: Sequence[Drawn]) -> dict[str, Any]:
    """The maps that the technique drew from each light, by name."""
    names = {
        shadow.ShadowMap: ("shadow_map_depth", "depth"),
        shadow.EngineMap: ("shadow_map_depth", "depth"),
        shadow.ProjectiveTexture: ("texture_coverage", "coverage"),
    }
    kind = type(drawn[0].state)
    if kind not in names:
        return {}
    name, field = names[kind]
    return {f"{name}{suffix(i, drawn)}": getattr(each.state, field) for i, each in enumerate(drawn)}


def write_config(folder: Path, config: Config) -> None:
    """Writes `config.yaml`, including all defaults."""
    write_yaml(folder / CONFIG_FILE, config)


def write_fitted(folder: Path, config: Config, values: Mapping[str, float]) -> None:
    """Writes `fitted.yaml`, if the fit has such a file."""
    fitted = fitted_config(config, values)
    if fitted is not None:
        write_yaml(folder / FITTED_FILE, fitted)


def fitted_config(config: Config, values: Mapping[str, float]) -> Config | None:
    """The content of `fitted.yaml`: `config` with the numbers that were fitted. No keys state where lights and meshes
    moved, so a fit of these has no such file."""
    return None if config.moves else with_fitted(config.named_with("-fitted"), values)


def write_yaml(file: Path, config: Config) -> None:
    """Writes `config` with all defaults."""
    file.write_bytes(yaml_of(config))


def yaml_of(config: Config) -> bytes:
    """The content of a YAML file with all of `config`."""
    return dump_resolved(config).encode("utf-8", errors="backslashreplace")


def write_arrays(folder: Path, arrays: Mapping[str, Any]) -> None:
    """Writes `arrays.npz`."""
    np.savez_compressed(folder / ARRAYS, allow_pickle=False, **{k: np.asarray(a) for k, a in arrays.items()})


def write_result(folder: Path, record: Mapping[str, Any]) -> None:
    """Writes `result.json`. Call it last, since it lists all other files."""
    (folder / RESULT).write_bytes(result_of(record, (entry.name for entry in folder.iterdir())))


def result_of(record: Mapping[str, Any], others: Iterable[str]) -> bytes:
    """The content of `result.json`. It lists itself and the names of the `others` in its folder."""
    files = sorted([*others, RESULT])
    return json_of(as_stored({"schema_version": SCHEMA_VERSION, **record, "files": files}))
