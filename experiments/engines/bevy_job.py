"""Draws shadows with the real Bevy, without a window.

Bevy is a Rust library, so its program is built first, which takes minutes:

    cargo build --manifest-path experiments/engines/bevy/Cargo.toml
    apt-get install mesa-vulkan-drivers

`VK_ICD_FILENAMES` may name the driver, such as lavapipe's lvp_icd.x86_64.json, which draws on the CPU; and `BEVY_DRAW`
the program, if it lies elsewhere.

A job is as in `engines.py`, with `engine` "bevy". Its light has a `type` ("directional" or "spot"), `direction`, and
the engine's own settings by their own names: `shadow_depth_bias`, `shadow_normal_bias`; of a spot light `position`,
`range`, `outer_angle` (radians) and `shadow_map_near_z`, of a directional one the fields of
`CascadeShadowConfigBuilder`. Besides, `mapSize` and `filter`, a `ShadowFilteringMethod`. Both sides of faces cast.
"""

import os
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .engines import Drawing, EngineError

HERE = Path(__file__).parent / "bevy"
PROGRAM = Path(os.environ.get("BEVY_DRAW", HERE / "target" / "debug" / "draw"))
VERSION = "0.19.1"
# The outputs of `probe.wgsl`: the first of three numbers of a position and of a normal.
_VISIBILITY, _POSITION, _NORMAL, _MAP = 0, 1, 4, 7
# Seconds for one output.
_LONGEST = 120
_SUN = ("num_cascades", "minimum_distance", "maximum_distance", "first_cascade_far_bound", "overlap_proportion")
_SPOT = ("range", "outer_angle", "shadow_map_near_z")


def missing() -> str | None:
    """What has to be built to draw, in one sentence; None if nothing has."""
    if PROGRAM.is_file():
        return None
    return f"drawing with Bevy needs {PROGRAM}; run `cargo build --manifest-path {HERE / 'Cargo.toml'}`"


def draw(jobs: Sequence[Mapping[str, Any]]) -> list[Drawing]:
    """Draws each job, with the outputs of PlayCanvas' ones but the depth; cascades are one above the other, (k n, n).

    **Raises** `EngineError` if the program is missing or fails.
    """
    if (lack := missing()) is not None:
        raise EngineError(lack)
    # What the camera sees is the same for all lights.
    seen: dict[str, dict[str, np.ndarray]] = {}
    return [_drawn(job, seen) for job in jobs]


def _drawn(job: Mapping[str, Any], seen: dict[str, dict[str, np.ndarray]]) -> Drawing:
    with tempfile.TemporaryDirectory(prefix="bevy-") as name:
        file = Path(name) / "job.txt"
        file.write_text("\n".join(_words(job)))
        output = lambda number, layer=0: _output(file, number, layer, job)
        first = output(_VISIBILITY).astype(np.float32)
        arrays = {"visibility": np.where(first[..., 3] == 1, first[..., 0], 1).astype(np.float32)}
        arrays["mesh"] = np.where(first[..., 3] == 1, first[..., 1] - 1, -1).astype(np.int32)
        key = repr((job["camera"], [id(mesh["vertices"]) for mesh in job["meshes"]]))
        if key not in seen:
            of = lambda start: np.stack([_floats(output(start + k)) for k in range(3)], axis=-1)
            seen[key] = {"position": of(_POSITION), "normal": of(_NORMAL)}
        size, light = job["mapSize"], job["light"]
        layers = light["num_cascades"] if light["type"] == "directional" else 1
        maps = [_floats(output(_MAP, layer))[:, :size] for layer in range(layers)]
        # Its rows begin at the top, and so the map's first row is the picture's last.
        maps = [texels[-size:] for texels in maps]
        arrays |= {**seen[key], "map": np.concatenate(maps)}
    return Drawing(arrays, {"version": VERSION, "engine": "bevy"}, [])


def _words(job: Mapping[str, Any]) -> Iterator[str]:
    camera, light = job["camera"], job["light"]
    text = lambda *values: " ".join(f"{float(value):.9g}" for value in values)
    yield text(job["mapSize"], job["width"], job["height"])
    yield text(*camera["position"], *camera["target"], camera["fov"], camera["near"], camera["far"])
    yield f"{job['filter']} {light['type']} {text(light['shadow_depth_bias'], light['shadow_normal_bias'])}"
    if light["type"] == "spot":
        yield text(*light["position"], *light["direction"], *(light[name] for name in _SPOT))
    else:
        yield text(*light["direction"], *(light[name] for name in _SUN))
    yield str(len(job["meshes"]))
    for mesh in job["meshes"]:
        yield text(mesh.get("casts", True), len(mesh["vertices"]), len(mesh["faces"]))
        for triples in (mesh["vertices"], mesh["normals"], mesh["faces"]):
            yield text(*np.asarray(triples, np.float64).ravel())


def _output(file: Path, number: int, layer: int, job: Mapping[str, Any]) -> np.ndarray:
    """Half floats (h, w, 4), with the bottom row first."""
    drawn = file.with_suffix(".bin")
    command = [str(PROGRAM), str(file), str(number), str(layer), str(drawn)]
    given = {**os.environ, "ASSETS": str(HERE / "assets")}
    done = subprocess.run(command, env=given, capture_output=True, text=True, timeout=_LONGEST, check=False)
    if done.returncode or not drawn.is_file():
        raise EngineError(f"Bevy failed: {done.stderr.strip()[-500:]}")
    picture = np.frombuffer(drawn.read_bytes(), np.float16).reshape(job["height"], job["width"], 4)
    drawn.unlink()
    return picture[::-1]


def _floats(bytes_of: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(bytes_of.round().astype(np.uint8)).view(np.float32)[..., 0]
