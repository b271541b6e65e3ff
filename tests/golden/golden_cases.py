"""The scenes that OpenGL drew, as tests want them; `golden/README.md` says how they were made."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

FOLDER = Path(__file__).parent
# OpenGL moves the corners it clips to the frustum onto its grid of 1/256 pixel; along the edges they bound, a triangle
# that is not clipped, or clipped otherwise, may gain or lose the centres that lie this near.
NEAR_EDGE = 1 / 64


class GoldenCase(NamedTuple):
    """A drawing by OpenGL; row 0 is the bottom row.

    - `clip`: (v, 4), float32, clip coordinates; `faces`: (f, 3), int32.
    - `depth_function`: `<` or `<=`; `cull`: `none`, `back` or `front`; `offset`: `glPolygonOffset`'s factor and units.
    - `winner`: (h, w), int32, the face seen, -1 for none; `depth`: (h, w), float32 window depth, 1 for none. Drawn
      with a 32-bit float depth buffer.
    - `winner_24`, `depth_24`: the same with a 24-bit buffer, whose depth is a uint32 in [0, 2²⁴ - 1].
    """

    name: str
    clip: np.ndarray
    faces: np.ndarray
    depth_function: str
    cull: str
    offset: tuple[float, float]
    winner: np.ndarray
    depth: np.ndarray
    winner_24: np.ndarray
    depth_24: np.ndarray

    @property
    def resolution(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        height, width = self.winner.shape
        return height, width

    def is_clipped(self) -> np.ndarray:
        """(f,), whether a corner of the face lies outside of the frustum, so that OpenGL clipped it."""
        x, y, z, w = self.clip[self.faces].transpose(2, 0, 1)
        return ~((np.abs(x) <= w) & (np.abs(y) <= w) & (np.abs(z) <= w)).all(axis=1)

    def near_clipped_edges(self, distance: float = NEAR_EDGE) -> np.ndarray:
        """(h, w), whether a pixel centre lies within `distance` pixels of a clipped face's outline.

        Of the outline without its part along the image's border; its cuts by the near and far plane belong to it.
        """
        near = np.zeros(self.resolution, bool)
        for corners in self.clip[self.faces[self.is_clipped()]].astype(np.float64):
            x, y, z, w = corners.T
            flat = np.stack([x, y, w], axis=1)
            # Lines in the plane of the image: a x + b y + c = 0 in normalised device coordinates.
            lines = [np.cross(flat[k], flat[(k + 1) % 3]) for k in range(3)]
            if abs(np.linalg.det(flat)) > 1e-12:
                lines += [np.linalg.solve(flat, z + w), np.linalg.solve(flat, z - w)]
            for line in lines:
                near |= self._distance(line) < distance
        return near

    def _distance(self, line: np.ndarray) -> np.ndarray:
        """(h, w), distance in pixels of each centre from `line` (3,)."""
        height, width = self.resolution
        rows, columns = np.mgrid[0:height, 0:width]
        a, b, c = line[0] * 2 / width, line[1] * 2 / height, line[2] - line[0] - line[1]
        slope = np.hypot(a, b)
        if slope == 0:
            return np.full(self.resolution, np.inf)
        return np.abs(a * (columns + 0.5) + b * (rows + 0.5) + c) / slope


def golden_names() -> list[str]:
    """The scenes' names, in alphabetical order."""
    return sorted(path.stem for path in FOLDER.glob("*.npz") if path.stem != "lookup")


def golden_case(name: str) -> GoldenCase:
    """The scene called `name`."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        return GoldenCase(
            name=name,
            clip=stored["clip"],
            faces=stored["faces"],
            depth_function=str(stored["depth_function"]),
            cull=str(stored["cull"]),
            offset=(float(stored["offset"][0]), float(stored["offset"][1])),
            winner=stored["winner"].astype(np.int32),
            depth=stored["depth"],
            winner_24=stored["winner_24"].astype(np.int32),
            depth_24=stored["depth_24"],
        )
