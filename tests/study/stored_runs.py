"""A fit that takes seconds, and folders of finished runs and sweeps, made without doing them."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
from scenes import fit_section

from diffshadow import metrics
from diffshadow.config import Config, dump_resolved, parse_config

TINY = """
name: tiny
scene:
  meshes:
    - {path: builtin:box, size: 0.6, drop_to_ground: true, translate: [0, 0.2, 0]}
    - {path: builtin:plane, options: {size: 3}}
  camera: {resolution: [64, 64], orbit: {distance: 3}}
  light: {angular_radius: 1.5}
shadow_map: {resolution: [64, 64]}
filter: {samples: 4, radius: 1}
bias: {constant: 0.1}
reference: {samples: 8}
output: runs
"""
# With the solver of the tests of fits, whose program it then shares.
TINY += fit_section(bias=10, radius=8, max_steps=60, anneal="{phases: 2}").replace("60", "60, rtol: 1e-4, atol: 1e-7")

SCENE = "scene: {meshes: [{path: 'builtin:torus'}, {path: 'builtin:plane'}], camera: {resolution: [24, 32]}, LIGHT}"
FIT = "{parameters: {bias.constant: {lower: 0, upper: 10}, filter.radius: {lower: 0, upper: 8}}}"
STEPS = 12


def errors(image: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    return metrics.measure_errors(image, truth, mask).as_dict()


def write_fit(folder: Path, name: str = "tiny", *, lights: int = 1, shift: int = 1, settings: str = "") -> Path:
    """A fit's folder, made without a fit: a square shadow, `shift` pixels off before and less after."""
    folder.mkdir(parents=True)
    scene = SCENE.replace("LIGHT", "light: {}" if lights == 1 else f"lights: [{', '.join(['{}'] * lights)}]")
    config = parse_config(f"name: {name}\nfit: {FIT}\n{scene}\n{settings}\n", source="tiny.yaml", folder=folder)
    (folder / "config.yaml").write_text(dump_resolved(config))
    truth, mask = np.ones((24, 32), np.float32), np.ones((24, 32), bool)
    truth[8:16, 10:22] = 0
    mask[-4:] = False
    before, after = np.roll(truth, shift, axis=1), np.clip(truth + 0.04, 0, 1)
    measured = {"before": errors(before, truth, mask), "after": errors(after, truth, mask)}
    phase = np.repeat([0, 1], STEPS // 2)
    arrays = {"reference": truth, "before": before, "after": after, "mask": mask}
    arrays = {key: np.stack([image] * lights) if lights > 1 else image for key, image in arrays.items()}
    arrays |= {f"shaded_{key}": np.full((24, 32, 3), 99, np.uint8) for key in ("reference", "before", "after")}
    values = np.linspace([0.1, 1.0], [2.5, 3.5], STEPS)
    history = {"loss": np.geomspace(0.1, 1e-3, STEPS), "values": values}
    np.savez(
        folder / "arrays.npz",
        **arrays,
        history_phase=phase,
        **{f"history_{key}": value.astype(np.float32) for key, value in history.items()},
    )
    ends = [{"bias.constant": 1.2, "filter.radius": 2.2}, {"bias.constant": 2.5, "filter.radius": 3.5}]
    phases = [
        {"width": width, "steps": 6, "result": "successful", "gradient_norm": 1e-4, "hard_loss": loss, "values": end}
        for width, loss, end in zip((2.0, 0.1), (0.02, 0.0025), ends, strict=True)
    ]
    each = [{"light": f"scene.lights.{i}" if lights > 1 else "scene.light", **measured} for i in range(lights)]
    bounds = {"bias.constant": (0.0, 10.0), "filter.radius": (0.0, 8.0)}
    result = {
        "schema_version": 1,
        "name": name,
        "kind": "fit",
        "warnings": ["the <i>solver</i> gave up"],
        "initial": {"bias.constant": 0.1, "filter.radius": 1.0},
        "fitted": ends[1],
        "bounds": {key: {"lower": low, "upper": high, "unit": "texels"} for key, (low, high) in bounds.items()},
        "metrics": {
            "compare": "hard",
            **measured,
            "reference_noise_floor": 0.0123,
            "pixels": 640 * lights,
            "lights": each,
        },
        "solver": {"name": "dogleg", "steps": 12, "chosen_phase": 1, "phases": phases},
        "seconds": {"fitting": 1.5},
        "versions": {"jax": "0.0"},
        "seed": 0,
        "command": "diffshadow fit it.yaml",
        "files": ["result.json", "config.yaml", "arrays.npz"],
    }
    (folder / "result.json").write_text(json.dumps(result))
    return folder


def write_sweep(folder: Path) -> Path:
    """A sweep's folder: two radii and two seeds, and a run that failed."""
    folder.mkdir(parents=True)
    rows = {
        "run": range(6),
        "id": [f"{i:016x}" for i in range(6)],
        "status": ["ok"] * 4 + ["failed", "missing"],
        "error": [None] * 4 + ["ValueError: <nothing> was seen", None],
        "filter.radius": [1.0, 1.0, 2.0, 2.0, 4.0, 4.0],
        "seed": [0, 1, 0, 1, 0, 1],
        "rmse": [0.10, 0.12, 0.30, 0.30, None, None],
    }
    pa.parquet.write_table(pa.table({key: list(value) for key, value in rows.items()}), folder / "results.parquet")
    settings = {
        "run": "render",
        "grid": {"filter.radius": [1, 2, 4]},
        "plot": {"x": "filter.radius", "y": "rmse", "log": False},
    }
    record = {"kind": "sweep", "name": "radii", "settings": settings, "command": "diffshadow sweep radii.yaml"}
    (folder / "result.json").write_text(json.dumps(record))
    return folder


def write_render(folder: Path, config: Config) -> Path:
    """The folder of a render of `config`, made without one: all is lit, and the reference too."""
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(dump_resolved(config))
    keys = [".".join(map(str, ("scene", *key))) for key in config.scene.each_light]
    shape = config.scene.camera.resolution
    lit = np.ones(shape if len(keys) == 1 else (len(keys), *shape), np.float32)
    np.savez(folder / "arrays.npz", reference=lit, visibility=lit, mask=np.ones(lit.shape, bool))
    none = {**dict.fromkeys(("rmse", "mae", "false_shadow_rate", "false_light_rate"), 0.0), "ssim": 1.0}
    result = {
        "name": config.name,
        "kind": "render",
        "metrics": {
            "compare": "hard",
            "errors": none,
            "reference_noise_floor": None,
            "pixels": lit.size,
            "lights": [{"light": key, "errors": none} for key in keys],
        },
        "seconds": {"drawing": 0.5},
        "versions": {"jax": "0.0"},
        "seed": 0,
        "command": "diffshadow render it.yaml",
        "files": ["arrays.npz", "config.yaml", "result.json"],
    }
    (folder / "result.json").write_text(json.dumps(result))
    return folder
