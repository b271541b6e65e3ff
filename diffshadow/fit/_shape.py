"""Shapes from shadows: fits all vertices of a mesh to images of its shadows.

A phase descends with large steps and Adam. The smoothing λ falls from phase to phase. Strong smoothing finds the rough
shape, and weak smoothing lets thin parts and details grow. Between phases, triangles can be split, so that a coarse
mesh finds the rough shape.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from .._types import HostArray
from ..geometry import Mesh, split_in_four
from ..settings.fit import widest_blur
from ._hull import shadow_size
from ._large_steps import LargeSteps
from ._regularizers import Regularizers
from ._shape_program import Level, ShapeProgram
from ._shape_steps import PHASES, FittedShape, ShapePhase, ShapeState, ShapeStep
from ._untangle import untangled
from .problems import ShapeProblem
from .problems._shape import Evaluation, casts_shadow, crossings_for

# Adam's decays of the means of gradients and of their squares (Kingma & Ba 2015).
_DECAY, _DECAY_OF_SQUARES = 0.9, 0.999
# The rate at a phase's end, as a fraction of the rate at its start.
_LAST_RATE = 0.05
# Self-intersections are removed after this many steps, and at the end of a phase.
_UNTANGLED = 5
# A view whose image has no pixel darker than this sees no shadow.
_UNSHADOWED = 0.999


def fit_shape(
    problem: ShapeProblem,
    phases: Sequence[ShapePhase] = PHASES,
    *,
    on_step: Callable[[ShapeStep], bool | None] | None = None,
    resume: ShapeState | None = None,
) -> FittedShape:
    """Fits the free vertices of a mesh to bring its shadows close to the references.

    Gradient descent in reverse mode, through silhouettes, minimises the mean square error of all views. The ends of
    phases are judged without a blur, and the best is the result.

    **Arguments:**

    - `phases`: the phases in order; λ should fall.
    - `on_step`: called after each step; the fit stops if it returns `True`.
    - `resume`: a state of an earlier fit of the same problem and phases. The fit continues from it. On a CPU, the
      result has the same bits as without the interruption.

    **Raises** `ValueError` for no phase, a blur too wide for an image, a light that reaches no pixel that counts, a
    start that casts no shadow in a view, or a state of another fit.
    """
    fit = _begun(problem, phases)
    return fit.run(fit.begin() if resume is None else fit.checked(resume), on_step)


def check_shape(problem: ShapeProblem, phases: Sequence[ShapePhase] = PHASES) -> None:
    """Makes the checks of `fit_shape` before its first step. It only compiles the program of a step if necessary.

    **Raises** the errors of these checks.
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


def _means(
    mean: Float[HostArray, "*n"], square: Float[HostArray, "*n"], gradient: Float[HostArray, "*n"]
) -> tuple[Float[HostArray, "*n"], Float[HostArray, "*n"]]:
    """Adam's means of gradients and of their squares after one more step."""
    square = _DECAY_OF_SQUARES * square + (1 - _DECAY_OF_SQUARES) * gradient * gradient
    return _DECAY * mean + (1 - _DECAY) * gradient, square


class _Fit:
    """A problem and its phases."""

    def __init__(self, problem: ShapeProblem, phases: tuple[ShapePhase, ...]):
        self.problem, self.phases = problem, phases
        self.program = ShapeProgram(problem, sum(phase.subdivisions for phase in phases))
        middle = np.asarray(problem.mesh.vertices, np.float64)[np.asarray(problem.free)].mean(axis=0)
        self.size = shadow_size(problem.views, middle)

    def check(self) -> None:
        """**Raises** the errors of `begin`."""
        sights = self.program.found_sights()
        # Rays find the shadow of any start except a very thin one.
        if not all(map(casts_shadow, [self.problem.mesh] * len(sights), self.problem.views, sights)):
            self.begin()

    def begin(self) -> ShapeState:
        """The state before the first step.

        **Raises** `ValueError` for a light that reaches no pixel, or a start without a shadow.
        """
        problem = self.problem
        self.program.found_sights()
        vertices, faces = np.asarray(problem.mesh.vertices, np.float64), np.asarray(problem.mesh.faces)
        level = self.program.level(vertices, faces, np.asarray(problem.free))
        lights, most = self.program.lights.start, crossings_for(problem.technique.map.resolution)
        found, crossings = self.program.evaluate(level, vertices, lights, 0.0, most)
        for number, (image, view) in enumerate(zip(self.program.images(found), problem.views, strict=True)):
            if not (image[np.asarray(view.weight) > 0] < _UNSHADOWED).any():
                raise ValueError(
                    f"the start casts no shadow in view {number}, so its vertices have no gradient there; expected a "
                    "shadow in each view: move or enlarge the start"
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
        """Continues from a state to the end, or until `on_step` stops the fit."""
        while state.phase < len(self.phases):
            state, stopped = self._phase(state, on_step)
            if stopped:
                break
        self.program.join()
        losses = state.losses
        chosen = int(np.argmin(losses))
        start = np.asarray(self.problem.mesh.vertices, np.float64), np.asarray(self.problem.mesh.faces)
        best = state.best_vertices, state.best_faces
        return FittedShape(
            mesh=Mesh(*best),
            lights=self.program.lit(state.best_lights),
            initial_loss=losses[0],
            loss=losses[chosen],
            losses=list(losses[1:]),
            chosen=chosen - 1,
            history=list(state.history),
            initial_images=self.program.seen(*start, self.program.lights.start, state.crossings),
            images=self.program.seen(*best, state.best_lights, state.crossings),
            state=state,
        )

    def _phase(self, state: ShapeState, on_step: Callable[[ShapeStep], bool | None] | None) -> tuple[ShapeState, bool]:
        """The state after the current phase, or at the step where `on_step` stopped."""
        phase = self.phases[state.phase]
        vertices, faces, free = state.vertices, state.faces, state.free
        if state.step == 0:
            for _ in range(phase.subdivisions):
                vertices, faces, ends = split_in_four(vertices, faces)
                free = np.concatenate([free, free[ends].any(axis=1)])
        level = self.program.level(vertices, faces, free)
        large = LargeSteps(vertices, faces, level.free, phase.strength)
        penalties = Regularizers(vertices, faces, phase.normal_consistency, phase.edge_length)
        if state.step == 0:
            u = large.u_of(vertices)
            state = state._replace(
                vertices=vertices, faces=faces, free=level.free, u=u, mean=np.zeros_like(u), square=np.zeros_like(u)
            )
            still = np.zeros_like(state.lights)
            state = state._replace(light_mean=still, light_square=still)
        present = self.program.mirrored(level, large.vertices_of(state.u))
        while state.step < phase.steps:
            found, crossings = self.program.evaluate(level, present, state.lights, phase.blur, state.crossings)
            loss = float(found.loss)
            state = self._stepped(state, level, large, found, penalties(present)[1])
            state = state._replace(crossings=crossings, history=(*state.history, (state.phase, loss)))
            before, present = present, self.program.mirrored(level, large.vertices_of(state.u))
            if state.step % _UNTANGLED == 0 or state.step == phase.steps:
                apart = untangled(present, faces, level.free)
                if apart is not present:
                    state = state._replace(u=large.u_of(apart))
                    present = self.program.mirrored(level, large.vertices_of(state.u))
            if on_step is not None:
                step = ShapeStep(state.phase, state.step - 1, loss, self.program.images(found), state, before, faces)
                if on_step(step):
                    return state, True
        found, crossings = self.program.evaluate(level, present, state.lights, 0.0, state.crossings)
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

    def _stepped(
        self,
        state: ShapeState,
        level: Level,
        large: LargeSteps,
        found: Evaluation,
        by_penalties: Float[HostArray, "v 3"],
    ) -> ShapeState:
        """One step of Adam with one scale for all vertices (Nicolet et al. 2021), so that gradients keep their relative
        lengths. Each light has its own scale."""
        phase, step = self.phases[state.phase], state.step + 1
        gradient = np.asarray(found.gradient, np.float64)[: len(level.start)] + by_penalties
        g = large.gradient_of(self.program.mirrored_gradient(level, gradient))
        mean, square = _means(state.mean, state.square, g)
        falling = (_LAST_RATE + (1 - _LAST_RATE) * (1 + np.cos(np.pi * step / phase.steps)) / 2) / (1 - _DECAY**step)
        # 1 if nothing has moved yet, because the mean is 0 there.
        scale_of = lambda greatest: np.where(greatest > 0, np.sqrt(greatest / (1 - _DECAY_OF_SQUARES**step)), 1)
        u = state.u - phase.rate * self.size * falling * mean / scale_of(square.max())
        state = state._replace(step=step, u=u, mean=mean, square=square)
        if found.by_lights is None:
            return state
        mean, square = _means(state.light_mean, state.light_square, self.program.lights.in_degrees(found.by_lights))
        degrees = -phase.light_rate * falling * mean / scale_of(self.program.lights.greatest(square))
        return state._replace(
            lights=self.program.lights.moved(state.lights, degrees), light_mean=mean, light_square=square
        )
