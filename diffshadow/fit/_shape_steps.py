"""The phases of a fit of a shape, its steps, and its result."""

import dataclasses
from typing import ClassVar, NamedTuple

from jaxtyping import Bool, Float, Int

from .._checks import check_settings
from .._types import HostArray
from ..geometry import AbstractLight, Mesh
from ..settings.fit import PHASES as DEFAULT_PHASES
from ..settings.fit import ShapePhase as PhaseSettings


@dataclasses.dataclass(frozen=True)
class ShapePhase:
    """A phase of a fit of a shape.

    - `strength`: λ, the strength of the smoothing between the steps of neighbouring vertices. Its unit is an edge:
      after each triangle is split in four, the same distance needs four times the strength.
    - `rate`: length of the first steps, as a fraction of the longest side of the views' shadows at the start's distance
        from the lights. The rate falls along half a cosine.
    - `steps`: the number of steps.
    - `blur`: standard deviation, in pixels, of the Gaussian under which images are compared.
    - `subdivisions`: the number of times that each triangle is split in four before the phase.
    - `light_rate`: length of the first steps of lights that move, in degrees as seen from the shape. It falls in the
      same way.
    - `normal_consistency`, `edge_length`: weights of penalties on folds and on long edges, added to the mean square
        error, for noisy images; 0 for none. The penalty on folds is the mean, over pairs of neighbouring faces, of 1
        minus the cosine between their normals. The penalty on lengths is their mean square, as a fraction of the mean
        square at the start of the phase. **Raises** `ValueError` for an invalid value.
    """

    settings: ClassVar = PhaseSettings

    strength: float = PhaseSettings.strength
    rate: float = PhaseSettings.rate
    steps: int = PhaseSettings.steps
    blur: float = PhaseSettings.blur
    subdivisions: int = PhaseSettings.subdivisions
    light_rate: float = PhaseSettings.light_rate
    normal_consistency: float = PhaseSettings.normal_consistency
    edge_length: float = PhaseSettings.edge_length

    def __post_init__(self):
        check_settings(self)


PHASES = tuple(ShapePhase(**phase) for phase in DEFAULT_PHASES)
"""Phases for a start of about 5,000 vertices within the visual hull, such as the result of `hull_start`."""


class ShapeState(NamedTuple):
    """The state of a fit before a step, with everything that it needs to continue. On a CPU, it continues to the same
    bits. Arrays never change.

    - `phase`, `step`: phase and number of the next step, from 0; `crossings`: the number of crossings for which there
        is memory.
    - `vertices`, `faces`, `free`: the mesh at the start of the phase, and its free vertices; `u`, `mean`, `square`:
        Adam's state, (n, 3).
    - `best_vertices`, `best_faces`: the mesh at the end of the best phase so far, or at the start.
    - `lights`, `light_mean`, `light_square`: the numbers of all lights' poses, and of Adam; empty if no light moves.
        `best_lights`: the poses at the best end of a phase.
    - `losses`: the judge's losses at the start and at the ends of phases; `history`: (s, 2), phase and loss of each
        step.
    """

    phase: int
    step: int
    crossings: int
    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "f 3"]
    free: Bool[HostArray, " v"]
    u: Float[HostArray, "n 3"]
    mean: Float[HostArray, "n 3"]
    square: Float[HostArray, "n 3"]
    best_vertices: Float[HostArray, "b 3"]
    best_faces: Int[HostArray, "c 3"]
    lights: Float[HostArray, " l"]
    light_mean: Float[HostArray, " l"]
    light_square: Float[HostArray, " l"]
    best_lights: Float[HostArray, " l"]
    losses: tuple[float, ...]
    history: tuple[tuple[int, float], ...]


class ShapeStep(NamedTuple):
    """A step of a fit of a shape.

    - `phase`, `step`: numbers from 0; `loss`: the mean square error before the step, under the phase's blur.
    - `images`: each view's visibility (h, w) before the step.
    - `state`: the state after the step, from which the fit can continue.
    - `vertices`, `faces`: the mesh before the step.
    """

    phase: int
    step: int
    loss: float
    images: list[Float[HostArray, "h w"]]
    state: ShapeState
    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "f 3"]


class FittedShape(NamedTuple):
    """The result of a fit of a shape.

    - `mesh`: the best mesh under the judge: the end of a phase, or the start.
    - `lights`: the light of each view, for this mesh.
    - `initial_loss`, `loss`: the judge's mean square error, without a blur, before and after the fit.
    - `losses`: the judge's error at the end of each phase; `chosen`: the phase that is the result, -1 for the start.
    - `history`: phase and loss of each step, under the phase's blur.
    - `initial_images`, `images`: each view's visibility (h, w) at the start and at the end.
    - `state`: the state at the end of the fit, or where it was stopped.
    """

    mesh: Mesh
    lights: list[AbstractLight]
    initial_loss: float
    loss: float
    losses: list[float]
    chosen: int
    history: list[tuple[int, float]]
    initial_images: list[Float[HostArray, "h w"]]
    images: list[Float[HostArray, "h w"]]
    state: ShapeState
