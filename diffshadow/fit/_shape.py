"""Shapes from shadows: fits all vertices of a mesh to images of its shadows.

A phase descends with large steps and Adam. The smoothing λ falls from phase to phase: a strong one finds the rough
shape, and a weak one lets thin parts and details grow. Between phases, triangles can be split, so that a coarse mesh
finds the rough shape. Each step runs one compiled program, whose data are arguments: meshes are padded to the size
of the finest, so that all phases, and all meshes of like size, share it.
"""

import dataclasses
import threading
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, ClassVar, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from .._arithmetic import as_array, as_float
from .._checks import check_settings
from .._padding import shared_mesh_size, shared_size
from .._types import HostArray
from ..geometry import AbstractLight, Edges, Mesh, split_in_four
from ..settings.fit import PHASES as DEFAULT_PHASES
from ..settings.fit import ShapePhase as PhaseSettings
from ..settings.fit import widest_blur
from ._large_steps import LargeSteps
from ._moving_lights import MovingLights
from ._programs import compiled
from .problems import ShapeProblem, ShapeView, of_one_structure, together
from .problems._aligned import are_aligned, may_be_aligned
from .problems._shape import Evaluation, Sight, casts_shadow, crossings_for, evaluate, mirror_partners, mirrored, sights

# Adam's decays of the means of gradients and of their squares (Kingma & Ba 2015).
_DECAY, _DECAY_OF_SQUARES = 0.9, 0.999
# The rate at a phase's end, as a fraction of the rate at its start.
_LAST_RATE = 0.05
# Once so large a fraction of the memory for crossings is used, a program for more is compiled beside the fit.
_NEARLY_FULL = 0.85
# A view in whose image no pixel is darker than this sees no shadow.
_UNSHADOWED = 0.999


@dataclasses.dataclass(frozen=True)
class ShapePhase:
    """A phase of a fit of a shape.

    - `strength`: λ, how strongly the steps of neighbouring vertices are smoothed. It is counted in edges: where
        triangles are split in four, four times as much smooths as far.
    - `rate`: length of the first steps, as a fraction of the longest side of the start. It falls along half a cosine.
    - `steps`: how many.
    - `blur`: standard deviation, in pixels, of the Gaussian under which images are compared.
    - `subdivisions`: how often each triangle is split in four before the phase.
    - `light_rate`: length of the first steps of lights that move, in degrees as the shape sees them. It falls likewise.

    **Raises** `ValueError` for a value that is not allowed.
    """

    settings: ClassVar = PhaseSettings

    strength: float = PhaseSettings.strength
    rate: float = PhaseSettings.rate
    steps: int = PhaseSettings.steps
    blur: float = PhaseSettings.blur
    subdivisions: int = PhaseSettings.subdivisions
    light_rate: float = PhaseSettings.light_rate

    def __post_init__(self):
        check_settings(self)


PHASES = tuple(ShapePhase(**phase) for phase in DEFAULT_PHASES)
"""Phases for a start of about 2,500 vertices."""


class ShapeState(NamedTuple):
    """Where a fit stands before a step: all that it needs to go on, on a CPU to the same bits. Arrays never change.

    - `phase`, `step`: of the next step, from 0; `crossings`: for how many there is memory.
    - `vertices`, `faces`, `free`: of the mesh at the start of the phase; `u`, `mean`, `square`: of Adam, (n, 3).
    - `best_vertices`, `best_faces`: of the best end of a phase so far, or of the start.
    - `lights`, `light_mean`, `light_square`: the numbers of all lights' poses, and of Adam; empty if none moves;
        `best_lights`: those of the best end of a phase.
    - `losses`: under the judge, of the start and of the ends of phases; `history`: (s, 2), phase and loss of each step.
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

    - `phase`, `step`: from 0; `loss`: the mean square error before the step, under the phase's blur.
    - `images`: (h, w) of each view, its visibility before the step.
    - `state`: from where the fit can go on after the step.
    - `vertices`, `faces`: of the mesh before the step.
    """

    phase: int
    step: int
    loss: float
    images: list[Float[HostArray, "h w"]]
    state: ShapeState
    vertices: Float[HostArray, "v 3"]
    faces: Int[HostArray, "f 3"]


class FittedShape(NamedTuple):
    """What a fit of a shape found.

    - `mesh`: the best end of a phase under the judge, or the start if that is best.
    - `lights`: of each view, as they were then.
    - `initial_loss`, `loss`: the judge's, before and after: the mean square error without a blur.
    - `losses`: the judge's at the end of each phase; `chosen`: which of them is the result, -1 for the start.
    - `history`: phase and loss of each step, under the phase's blur.
    - `initial_images`, `images`: (h, w) of each view, its visibility at the start and at the end.
    - `state`: where the fit ended or was stopped.
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


def fit_shape(
    problem: ShapeProblem,
    phases: Sequence[ShapePhase] = PHASES,
    *,
    on_step: Callable[[ShapeStep], bool | None] | None = None,
    resume: ShapeState | None = None,
) -> FittedShape:
    """Fits the free vertices of a mesh, so that its shadows become like the references.

    It minimises the mean square error of all views by gradient descent in reverse mode, through silhouettes. The ends
    of phases are judged without a blur, and the best is the result.

    **Arguments:**

    - `phases`: in their order; λ should fall.
    - `on_step`: called after each step; the fit stops if it returns `True`.
    - `resume`: a state of an earlier fit of the same problem and phases, to go on from there. On a CPU the result
        has the same bits as without the interruption.

    **Raises** `ValueError` for no phase, a blur too wide for an image, a light that reaches no pixel that counts, a
    start that casts no shadow in a view, or a state of another fit.
    """
    fit = _begun(problem, phases)
    return fit.run(fit.begin() if resume is None else fit.checked(resume), on_step)


def check_shape(problem: ShapeProblem, phases: Sequence[ShapePhase] = PHASES) -> None:
    """Checks what `fit_shape` checks before its first step, and compiles the program of a step only if it must.

    **Raises** what that raises.
    """
    _begun(problem, phases).check()


def _begun(problem: ShapeProblem, phases: Sequence[ShapePhase]) -> "_Fit":
    if not phases:
        raise ValueError("got no phase; expected one or more, such as fit.ShapePhase(strength=20, rate=0.1, steps=150)")
    _check_blurs(problem, phases)
    return _Fit(problem, tuple(phases))


def _check_blurs(problem: ShapeProblem, phases: Sequence[ShapePhase]) -> None:
    for view in problem.views:
        most = widest_blur(*view.reference.shape)
        for phase in phases:
            if phase.blur > most:
                raise ValueError(
                    f"a phase's blur is {phase.blur:g} pixels, and an image has a side of {min(view.reference.shape)}; "
                    f"expected {most:g} or less, an eighth of it: make the blur narrower, or the images larger"
                )


class _Level(NamedTuple):
    """A mesh at the size that all of a fit's have; `faces` and `edges` are padded, `own_faces` are not."""

    start: Float[HostArray, "v 3"]
    own_faces: Int[HostArray, "f 3"]
    free: Bool[HostArray, " v"]
    faces: Any
    edges: Edges
    partner: Int[HostArray, " v"] | None


def _means(
    mean: Float[HostArray, "*n"], square: Float[HostArray, "*n"], gradient: Float[HostArray, "*n"]
) -> tuple[Float[HostArray, "*n"], Float[HostArray, "*n"]]:
    """Adam's means of gradients and of their squares after one more."""
    square = _DECAY_OF_SQUARES * square + (1 - _DECAY_OF_SQUARES) * gradient * gradient
    return _DECAY * mean + (1 - _DECAY) * gradient, square


class _Fit:
    """A fit's views, and the program that evaluates them."""

    def __init__(self, problem: ShapeProblem, phases: tuple[ShapePhase, ...]):
        self.problem, self.phases = problem, phases
        groups = of_one_structure(problem.views)
        self.groups: list[ShapeView] = [together(group) for group in groups]
        order = {id(view): number for number, view in enumerate(problem.views)}
        self.order = np.argsort([order[id(view)] for group in groups for view in group])
        vertices = np.asarray(problem.mesh.vertices, np.float64)
        self.size = float(np.ptp(vertices[np.asarray(problem.free)], axis=0).max())
        # All meshes are padded to the size of the finest.
        splits = sum(phase.subdivisions for phase in phases)
        edges = len(Edges.of(problem.mesh).vertices)
        count, faces = len(vertices), len(problem.mesh.faces)
        for _ in range(splits):
            count, edges, faces = count + edges, 2 * edges + 3 * faces, 4 * faces
        self.padding = shared_mesh_size(faces, count), shared_size(edges)
        self.more: threading.Thread | None = None
        self.lights = MovingLights.of(self.groups, vertices[np.asarray(problem.free)].mean(axis=0))
        self.sights = sights(self.groups)
        fixed = not self.lights.move and may_be_aligned(problem.technique)
        self.receivers = [
            sight.receivers if fixed and are_aligned(sight.receivers, problem.technique) else None
            for sight in self.sights
        ]

    def check(self) -> None:
        """**Raises** what `begin` raises."""
        sights = self._sights()
        # Rays find the shadow of any start but a very thin one.
        if not all(map(casts_shadow, [self.problem.mesh] * len(sights), self.problem.views, sights)):
            self.begin()

    def _sights(self) -> list[Sight]:
        """What each view's light sees of its screen.

        **Raises** `ValueError` for a light that reaches no pixel.
        """
        numbers = self._of_views([[(sight, i) for i in range(len(sight.reached))] for sight in self.sights])
        found = [jax.tree.map(lambda leaf, i=i: np.asarray(leaf)[i], sight) for sight, i in numbers]
        reached = [bool(sight.reached.any()) for sight in found]
        if not all(reached):
            raise ValueError(
                f"the light of view {reached.index(False)} reaches none of the pixels that count; expected a surface "
                "that lies in the light's shadow map and faces the light: move the light or the surface, or make the "
                "map's extent larger"
            )
        return found

    def begin(self) -> ShapeState:
        """The state before the first step.

        **Raises** `ValueError` for a light that reaches no pixel, or a start without a shadow.
        """
        problem = self.problem
        self._sights()
        vertices, faces = np.asarray(problem.mesh.vertices, np.float64), np.asarray(problem.mesh.faces)
        level = self._level(vertices, faces, np.asarray(problem.free))
        lights, most = self.lights.start, crossings_for(problem.technique.map.resolution)
        found, crossings = self._evaluate(level, vertices, lights, 0.0, most)
        for number, (image, view) in enumerate(zip(self._images(found), problem.views, strict=True)):
            if not (image[np.asarray(view.weight) > 0] < _UNSHADOWED).any():
                raise ValueError(
                    f"the start casts no shadow in view {number}, so that its vertices have no gradient there; "
                    "expected some shadow in each view: move or enlarge the start"
                )
        none = np.zeros((0, 3))
        best = vertices, faces
        still = np.zeros_like(lights)
        shape = *best, level.free, none, none, none, *best
        return ShapeState(0, 0, crossings, *shape, lights, still, still, lights, (float(found.loss),), ())

    def checked(self, state: ShapeState) -> ShapeState:
        """**Raises** `ValueError` for the state of another fit."""
        ends = state.phase < len(self.phases) and state.step > self.phases[state.phase].steps
        faces, splits = len(self.problem.mesh.faces), sum(p.subdivisions for p in self.phases[: state.phase + 1])
        begun = state.step > 0
        known = {faces * 4**splits} if begun else {faces * 4**splits, faces * 4 ** (splits - self._splits(state.phase))}
        if state.phase > len(self.phases) or ends or len(state.faces) not in known:
            raise ValueError(
                f"the state to resume from is in phase {state.phase}, at step {state.step}, with {len(state.faces)} "
                "faces; expected a state of a fit with the same mesh and phases"
            )
        return state

    def _splits(self, phase: int) -> int:
        return self.phases[phase].subdivisions if phase < len(self.phases) else 0

    def run(self, state: ShapeState, on_step: Callable[[ShapeStep], bool | None] | None) -> FittedShape:
        """Goes on from a state to the end, or until `on_step` stops it."""
        while state.phase < len(self.phases):
            state, stopped = self._phase(state, on_step)
            if stopped:
                break
        if self.more is not None:
            self.more.join()
        losses = state.losses
        chosen = int(np.argmin(losses))
        start = np.asarray(self.problem.mesh.vertices, np.float64), np.asarray(self.problem.mesh.faces)
        best = state.best_vertices, state.best_faces
        return FittedShape(
            mesh=Mesh(*best),
            lights=self._lights(state.best_lights),
            initial_loss=losses[0],
            loss=losses[chosen],
            losses=list(losses[1:]),
            chosen=chosen - 1,
            history=list(state.history),
            initial_images=self._seen(*start, self.lights.start, state.crossings),
            images=self._seen(*best, state.best_lights, state.crossings),
            state=state,
        )

    def _seen(
        self,
        vertices: Float[HostArray, "v 3"],
        faces: Int[HostArray, "f 3"],
        lights: Float[HostArray, " l"],
        crossings: int,
    ) -> list[Float[HostArray, "h w"]]:
        """The visibility that each view has of a mesh."""
        level = self._level(vertices, faces, np.ones(len(vertices), bool))
        return self._images(self._evaluate(level, vertices, lights, 0.0, crossings)[0])

    def _phase(self, state: ShapeState, on_step: Callable[[ShapeStep], bool | None] | None) -> tuple[ShapeState, bool]:
        """The state after the present phase, or where `on_step` stopped it."""
        phase = self.phases[state.phase]
        vertices, faces, free = state.vertices, state.faces, state.free
        if state.step == 0:
            for _ in range(phase.subdivisions):
                vertices, faces, ends = split_in_four(vertices, faces)
                free = np.concatenate([free, free[ends].any(axis=1)])
        level = self._level(vertices, faces, free)
        large = LargeSteps(vertices, faces, level.free, phase.strength)
        if state.step == 0:
            u = large.u_of(vertices)
            state = state._replace(
                vertices=vertices, faces=faces, free=level.free, u=u, mean=np.zeros_like(u), square=np.zeros_like(u)
            )
            still = np.zeros_like(state.lights)
            state = state._replace(light_mean=still, light_square=still)
        present = self._mirrored(level, large.vertices_of(state.u))
        while state.step < phase.steps:
            found, crossings = self._evaluate(level, present, state.lights, phase.blur, state.crossings)
            loss = float(found.loss)
            state = self._stepped(state, level, large, found)
            state = state._replace(crossings=crossings, history=(*state.history, (state.phase, loss)))
            if on_step is not None:
                step = ShapeStep(state.phase, state.step - 1, loss, self._images(found), state, present, faces)
                if on_step(step):
                    return state, True
            present = self._mirrored(level, large.vertices_of(state.u))
        found, crossings = self._evaluate(level, present, state.lights, 0.0, state.crossings)
        loss, is_best = float(found.loss), float(found.loss) < min(state.losses)
        none = np.zeros((0, 3))
        state = state._replace(
            phase=state.phase + 1,
            step=0,
            crossings=crossings,
            vertices=present,
            u=none,
            mean=none,
            square=none,
            losses=(*state.losses, loss),
        )
        best = {"best_vertices": present, "best_faces": faces, "best_lights": state.lights}
        return (state._replace(**best) if is_best else state), False

    def _stepped(self, state: ShapeState, level: _Level, large: LargeSteps, found: Evaluation) -> ShapeState:
        """One step of Adam with one scale for all vertices (Nicolet et al. 2021): their gradients keep their relative
        lengths. Each light has a scale of its own."""
        phase, step = self.phases[state.phase], state.step + 1
        gradient = np.asarray(found.gradient, np.float64)[: len(level.start)]
        g = large.gradient_of(self._mirrored_gradient(level, gradient))
        mean, square = _means(state.mean, state.square, g)
        falling = (_LAST_RATE + (1 - _LAST_RATE) * (1 + np.cos(np.pi * step / phase.steps)) / 2) / (1 - _DECAY**step)
        # 1 where nothing has moved yet: the mean is 0 there.
        scale_of = lambda greatest: np.where(greatest > 0, np.sqrt(greatest / (1 - _DECAY_OF_SQUARES**step)), 1)
        u = state.u - phase.rate * self.size * falling * mean / scale_of(square.max())
        state = state._replace(step=step, u=u, mean=mean, square=square)
        if found.by_lights is None:
            return state
        mean, square = _means(state.light_mean, state.light_square, self.lights.in_degrees(found.by_lights))
        degrees = -phase.light_rate * falling * mean / scale_of(self.lights.greatest(square))
        return state._replace(lights=self.lights.moved(state.lights, degrees), light_mean=mean, light_square=square)

    def _level(
        self, vertices: Float[HostArray, "v 3"], faces: Int[HostArray, "f 3"], free: Bool[HostArray, " v"]
    ) -> _Level:
        mesh, symmetry = Mesh(vertices, faces), self.problem.symmetry
        (count, _), rows = self.padding
        edges = dataclasses.replace(Edges.of(mesh).padded(count, rows), is_closed=True)
        partner = None if symmetry is None else mirror_partners(vertices, symmetry)
        free = free if partner is None else free & free[partner]
        return _Level(vertices, faces, free, mesh.padded(self.padding[0]).faces, edges, partner)

    def _mirrored(self, level: _Level, vertices: Float[HostArray, "v 3"]) -> Float[HostArray, "v 3"]:
        """The vertices, or the mean of them and their mirror image."""
        if level.partner is None or self.problem.symmetry is None:
            return vertices
        return (vertices + mirrored(vertices, self.problem.symmetry)[level.partner]) / 2

    def _mirrored_gradient(self, level: _Level, gradient: Float[HostArray, "v 3"]) -> Float[HostArray, "v 3"]:
        if level.partner is None or self.problem.symmetry is None:
            return gradient
        *normal, _ = self.problem.symmetry
        return (gradient + mirrored(gradient, (*normal, 0.0))[level.partner]) / 2

    def _evaluate(
        self,
        level: _Level,
        vertices: Float[HostArray, "v 3"],
        lights: Float[HostArray, " l"],
        blur: float,
        crossings: int,
    ) -> tuple[Evaluation, int]:
        """The loss, and for how many crossings there is memory now.

        Memory is doubled when it is full. Before, while the fit goes on, a thread compiles the program for that.
        """
        while True:
            found = self._program(level, vertices, lights, blur, crossings)
            needed = int(found.crossings)
            if needed > _NEARLY_FULL * crossings and self.more is None:
                given = level, vertices, lights, blur, 2 * crossings
                self.more = threading.Thread(target=self._program, args=given, daemon=True)
                self.more.start()
            if needed <= crossings:
                return found, crossings
            if self.more is not None:
                self.more.join()
            self.more, crossings = None, 2 * crossings

    def _program(
        self,
        level: _Level,
        vertices: Float[HostArray, "v 3"],
        lights: Float[HostArray, " l"],
        blur: float,
        crossings: int,
    ) -> Evaluation:
        (_, count), _ = self.padding
        padded = np.concatenate([vertices, np.broadcast_to(vertices[:1], (count - len(vertices), 3))])
        views = self.groups, self.receivers, self.lights.poses(lights)
        given = as_float(padded), level.faces, level.edges, *views, self.problem.technique, as_float(blur)
        return compiled(evaluate, (*given, crossings))(*given, crossings)

    def _lights(self, numbers: Float[HostArray, " l"]) -> list[AbstractLight]:
        """The light of each view."""
        groups = self.lights.lights(numbers)
        each = lambda lights, i: jax.tree.map(lambda leaf: as_array(np.asarray(leaf)[i]), lights)
        counts = [len(group.reference) for group in self.groups]
        return self._of_views(
            [[each(*at) for at in product([g], range(n))] for g, n in zip(groups, counts, strict=True)]
        )

    def _images(self, found: Evaluation) -> list[Float[HostArray, "h w"]]:
        return self._of_views([np.asarray(image) for image in found.images])

    def _of_views(self, groups: Sequence[Any]) -> list[Any]:
        """What each group has along its first axis, in the order of the problem's views."""
        every = [one for group in groups for one in group]
        return [every[number] for number in self.order]
