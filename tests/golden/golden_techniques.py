"""Shadow factors that OpenGL drew, as tests want them; `golden/README.md` says how they were made."""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np

FOLDER = Path(__file__).parent / "techniques"
TAPS = {"nearest": 1, "bilinear": 1, "four_tap": 4, "box": 25, "random_disk": 32}
DEPTH_STEP = np.float32(1 / ((1 << 24) - 1))


class GoldenView(NamedTuple):
    """A projection: `world_to_eye` and `eye_to_clip` (4, 4), float32; distances of window depth 0 and 1."""

    world_to_eye: np.ndarray
    eye_to_clip: np.ndarray
    near: float
    far: float

    @property
    def is_perspective(self) -> bool:
        return bool(self.eye_to_clip[3, 2] != 0)

    @property
    def eye(self) -> np.ndarray:
        """(3,), where it stands, in world units."""
        return -self.world_to_eye[:3, :3].T @ self.world_to_eye[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """(3,), the unit vector along which it looks."""
        return -self.world_to_eye[2, :3]

    def window(self, points: np.ndarray, resolution: tuple[int, int]) -> np.ndarray:
        """Where world `points` (n, 3) fall in an image, (n, 2), pixels, in float64; they must lie before the eye."""
        matrix = self.eye_to_clip.astype(np.float64) @ self.world_to_eye.astype(np.float64)
        clip = points.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
        return (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * resolution[::-1]


class GoldenMap(NamedTuple):
    """A shadow map: `depth` (h, w), float32; `bits` 32 or 24; what was culled, and polygon offset."""

    depth: np.ndarray
    bits: int
    cull: str
    offset: tuple[float, float]


class GoldenFactor(NamedTuple):
    """What a technique made of a map: `visibility` (h, w), before averted faces are dark.

    `technique` is one of `TAPS`; `map`, `bias` and `compare` are names, the last `"less"` or `"less_equal"`.
    """

    technique: str
    map: str
    bias: str
    compare: str
    visibility: np.ndarray

    @property
    def name(self) -> str:
        return "-".join((self.technique, self.map, self.bias, self.compare))


class GoldenScene(NamedTuple):
    """What all lights share.

    - `vertices` (v, 3), float32; `faces` (f, 3); `face` (h, w), what the camera sees, -1 for none.
    - `offsets` (n, p, p, 2), the random disk's table, and `radius`, its scale in texels.
    - `biases`: by name (constant, slope, least), in texels' widths: `max(slope (1 - n·l), least) + constant`.
    """

    vertices: np.ndarray
    faces: np.ndarray
    face: np.ndarray
    camera: GoldenView
    offsets: np.ndarray
    radius: float
    biases: dict[str, np.ndarray]


class GoldenLight(NamedTuple):
    """A light and what OpenGL drew under it.

    - `at` (4,): the point it shines from with w = 1, the way to it with w = 0.
    - `coordinate` (h, w, 3), float32, the shadow coordinate that the shader computed; 0 where there is no surface.
    - `references`: by bias (h, w), float32, the window depth it compared with the map's.
    - `facing` (h, w), whether the surface is turned to the light.
    """

    view: GoldenView
    at: np.ndarray
    coordinate: np.ndarray
    references: dict[str, np.ndarray]
    facing: np.ndarray
    maps: dict[str, GoldenMap]
    factors: list[GoldenFactor]


def golden_lights() -> list[str]:
    """The lights' names."""
    return sorted(path.stem for path in FOLDER.glob("*.npz") if path.stem != "scene")


@functools.cache
def golden_scene() -> GoldenScene:
    with np.load(FOLDER / "scene.npz") as stored:
        return GoldenScene(
            vertices=stored["vertices"],
            faces=stored["faces"].astype(np.int32),
            face=stored["face"].astype(np.int32),
            camera=_view(stored),
            offsets=stored["offsets"],
            radius=float(stored["radius"]),
            biases=_named(stored, "bias_"),
        )


@functools.cache
def golden_light(name: str) -> GoldenLight:
    """The light called `name`."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        return GoldenLight(
            view=_view(stored),
            at=stored["at"],
            coordinate=stored["coordinate"],
            references=_named(stored, "reference_"),
            facing=stored["facing"],
            maps={key: _map(stored, key) for key in _named(stored, "map_")},
            factors=[_factor(key, taps) for key, taps in _named(stored, "taps-").items()],
        )


def _named(stored, prefix: str) -> dict[str, np.ndarray]:
    return {key.removeprefix(prefix): stored[key] for key in stored if key.startswith(prefix)}


def _view(stored) -> GoldenView:
    near, far = stored["near_far"]
    return GoldenView(stored["world_to_eye"], stored["eye_to_clip"], float(near), float(far))


def _map(stored, name: str) -> GoldenMap:
    factor, units = stored[f"offset_{name}"]
    depth = stored[f"map_{name}"]
    if depth.dtype == np.float32:
        return GoldenMap(depth, 32, str(stored[f"cull_{name}"]), (float(factor), float(units)))
    # As a look-up reads it.
    texels = depth.astype(np.float32) * DEPTH_STEP
    return GoldenMap(texels, 24, str(stored[f"cull_{name}"]), (float(factor), float(units)))


def _factor(key: str, taps: np.ndarray) -> GoldenFactor:
    technique, map_name, bias, compare = key.split("-")
    return GoldenFactor(technique, map_name, bias, compare, taps.astype(np.float32) / np.float32(TAPS[technique]))
