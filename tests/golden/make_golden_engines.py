"""Draws golden pictures with engines and stores them in the folder `engines` beside this script.

    PYTHONPATH=. python tests/golden/make_golden_engines.py [three] [babylon] [playcanvas] [godot] [bevy]

needs Node.js, its packages and Chromium; it says how to install what is missing. Per engine there is

- `<engine>.json`: by name of the picture its `settings` (the job of `experiments/engines/engines.py`, with `mesh` the
  name of the geometry), `info` (matrices and distances as the engine used them) and `arrays`, the names of its arrays
- `<engine>.npz`: the arrays, each once though several pictures may use it. `golden_engines.py` reads them: a visibility
  is a uint16 in steps of 1/65535, a half-float map a float16, other floats are differences of bits (`pack`)

and `geometry.npz` holds `<mesh>_vertices`, `<mesh>_normals` and `<mesh>_faces` for both.
"""

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "experiments"))

from _babylon_cases import babylon_cases  # noqa: E402
from _bevy_cases import bevy_cases  # noqa: E402
from _engine_scene import geometry  # noqa: E402
from _godot_cases import godot_cases  # noqa: E402
from _playcanvas_cases import playcanvas_cases  # noqa: E402
from _three_cases import three_cases  # noqa: E402
from engines import bevy_job  # noqa: E402
from engines.engines import Drawing, draw  # noqa: E402
from golden_engines import FOLDER, VISIBILITY_STEPS, pack, unpack  # noqa: E402

CASES = {
    "three": three_cases,
    "babylon": babylon_cases,
    "playcanvas": playcanvas_cases,
    "godot": godot_cases,
    "bevy": bevy_cases,
}
OUTPUTS = ["mesh", "position", "normal", "map"]


def job(settings: dict[str, Any], meshes: dict[str, dict[str, np.ndarray]]) -> dict[str, Any]:
    """The settings with arrays in place of the meshes' names."""
    filled = [{**meshes[mesh["mesh"]], **mesh} for mesh in settings["meshes"]]
    outputs = [*OUTPUTS, *(["random"] if settings.get("generator", {}).get("filter") == "PCSS" else [])]
    return {**settings, "meshes": filled, "outputs": outputs}


def stored_arrays(drawing: Drawing) -> dict[str, np.ndarray]:
    """What is stored of a drawing.

    **Raises** `ValueError` if an array cannot be restored to the last bit.
    """
    arrays = drawing.arrays
    if "visibility" not in arrays:
        # Pictures of bytes, and the map.
        return {name: array if array.dtype == np.uint8 else pack(array) for name, array in arrays.items()}
    covered = arrays["mesh"] >= 0
    found = {
        "visibility": np.round(arrays["visibility"].astype(np.float64).clip(0, 1) * VISIBILITY_STEPS).astype(np.uint16),
        "mesh": arrays["mesh"].astype(np.int8),
    }
    for name in set(arrays) - set(found):
        array = arrays[name]
        if name in ("position", "normal"):
            array = np.where(covered[..., None], array, np.float32(0))
        if name == "random":
            array = np.where(covered, array, np.float32(0))
        is_half = np.array_equal(array.astype(np.float16).astype(np.float32), array)
        found[name] = array.astype(np.float16) if is_half else pack(array)
        if not np.array_equal(unpack(found[name]).view(np.uint32), array.view(np.uint32)):
            raise ValueError(f"{name} is not the same after storing")
    return found


def store(engine: str, cases: dict[str, dict[str, Any]], drawings: list[Drawing]) -> None:
    arrays: dict[str, np.ndarray] = {}
    names: dict[str, str] = {}
    index = {}
    for (name, settings), drawing in zip(cases.items(), drawings, strict=True):
        entries = {}
        for key, array in sorted(stored_arrays(drawing).items()):
            digest = hashlib.sha256(f"{array.dtype}{array.shape}".encode() + array.tobytes()).hexdigest()
            names.setdefault(digest, f"{key}_{len(names)}")
            arrays[names[digest]], entries[key] = array, names[digest]
        info = {key: value for key, value in drawing.info.items() if key != "seconds"}
        index[name] = {"settings": settings, "info": info, "messages": drawing.messages, "arrays": entries}
    np.savez_compressed(FOLDER / f"{engine}.npz", **arrays)
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(case)}" for name, case in index.items())
    (FOLDER / f"{engine}.json").write_text(f'{{"cases": {{\n{lines}\n}}}}\n')


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    meshes = geometry()
    flat = {f"{name}_{key}": array for name, mesh in meshes.items() for key, array in mesh.items()}
    np.savez_compressed(FOLDER / "geometry.npz", **flat)
    # Bevy has to be built first.
    for engine in sys.argv[1:] or [name for name in CASES if name != "bevy" or bevy_job.missing() is None]:
        cases = CASES[engine]()
        drawings = (bevy_job.draw if engine == "bevy" else draw)([job(settings, meshes) for settings in cases.values()])
        store(engine, cases, drawings)
        size = sum(path.stat().st_size for path in FOLDER.glob(f"{engine}.*"))
        print(f"{engine} {drawings[0].info['version']}: {len(cases)} pictures, {size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
