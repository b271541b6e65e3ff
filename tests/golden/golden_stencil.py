"""OpenGL's stencil counts of shadow volumes, as tests want them; `golden/make_golden_stencil.py` made them."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

FOLDER = Path(__file__).parent / "stencil"


class StencilCase(NamedTuple):
    """A scene and its shadow volumes, and what OpenGL counted of them; row 0 is the bottom row.

    - `clip`: (v, 4), float32, clip coordinates with the far plane at infinity.
    - `faces`: (f, 3), what is seen; `volume_faces`: (t, 3), those of the volumes, and `weights`: (t,), how often each
        counts, negative for those that count turned over.
    - `passing`, `failing`: (h, w), front less back faces of the volumes that passed, or failed, the depth test
        `GL_LESS` against what is seen, in a 32-bit float depth buffer.
    """

    name: str
    clip: np.ndarray
    faces: np.ndarray
    volume_faces: np.ndarray
    weights: np.ndarray
    passing: np.ndarray
    failing: np.ndarray

    @property
    def resolution(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        height, width = self.passing.shape
        return height, width

    def near_outlines(self, pixel: np.ndarray) -> tuple[float, float]:
        """How close `pixel` (row, column) is to a miscount.

        **Returns:** the distance in pixels of its centre from the nearest outline of a face of a volume or of the
        scene, each cut by the near plane, and the least difference of window depth there between a face of a volume
        and one of the scene, caps apart. In float64.
        """
        outline, scene_depths = _at_centre(self.clip[self.faces], pixel, self.resolution)
        # Caps have the very depths of the faces that they repeat.
        caps = (self.volume_faces[:, None] == self.faces).all(axis=-1).any(axis=1)
        counted = self.volume_faces[(self.weights != 0) & ~caps]
        volume_outline, depths = _at_centre(self.clip[counted], pixel, self.resolution)
        gaps = np.abs(depths[:, None] - scene_depths) if len(depths) and len(scene_depths) else np.array([np.inf])
        return min(outline, volume_outline), float(gaps.min())


def stencil_names() -> list[str]:
    """The scenes' names, in alphabetical order."""
    return sorted(path.stem for path in FOLDER.glob("*.npz"))


def stencil_case(name: str) -> StencilCase:
    """The scene called `name`."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        small = {key: stored[key].astype(np.int32) for key in StencilCase._fields if key not in ("name", "clip")}
        return StencilCase(name=name, clip=stored["clip"], **small)


def _at_centre(corners: np.ndarray, pixel: np.ndarray, resolution: tuple[int, int]) -> tuple[float, np.ndarray]:
    """The distance in pixels from a pixel's centre to the nearest outline of triangles (n, 3, 4), and the window depths
    (m,) of those that cover it or nearly so."""
    height, width = resolution
    x, y, z, w = np.moveaxis(corners.astype(np.float64), -1, 0)
    rows = np.stack([(x + w) / 2 * width, (y + w) / 2 * height, w], axis=-1)
    lines = np.cross(np.roll(rows, -1, axis=1), np.roll(rows, -2, axis=1))
    area = np.sum(rows[:, 0] * lines[:, 0], axis=-1)
    centre = np.array([pixel[1] + 0.5, pixel[0] + 0.5, 1])
    distance = lines @ centre / np.maximum(np.hypot(lines[..., 0], lines[..., 1]), 1e-300) * np.sign(area)[:, None]
    share = lines @ centre / np.where(area == 0, 1, area)[:, None]
    # z / w is linear in the window, w positive where the shares are.
    depth = np.sum(share * z, axis=1) * 0.5 + 0.5
    nearly = (area != 0) & (distance.min(axis=1) > -0.05) & (depth > -1e-6)
    inside = nearly & (depth >= 0)
    # An outline matters where the centre is near it and inside, or nearly inside, of the other two lines.
    margin = np.abs(distance.min(axis=1))[nearly]
    return float(margin.min(initial=np.inf)), depth[inside]
