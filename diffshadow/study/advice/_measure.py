"""Measurements of fitted techniques: their times, and the bias at which they have no more acne than another."""

import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from ... import fit, raster
from ..._arithmetic import as_float
from ...config import Config, build_technique, fit_paths
from ...shadow import ENGINE_TECHNIQUES
from .._drawn import Drawn
from ..record._sweeps import LeastBias, Load, Times
from ..remarks._verdict import unexplained_verdict
from ..runs._explained import fitted_images, unexplained
from ..runs._measure import combined, measured
from ..runs._progress import Progress
from ..runs._setup import load, visibility_of
from ..runs._views import Views, draw_views
from ._times import Watch, times_of, unevenness_of

# Every technique is timed once in each round, so a slow phase of the machine affects all of them.
_ROUNDS = 15
# The biases of engines' techniques.
_OF_ENGINES = {f"technique.{key}" for each in ENGINE_TECHNIQUES.values() for key in each.settings.biases}
# A bias is searched for at this many equal steps, and then by bisection of the step that contains it. The final
# accuracy is a thousandth.
_STEPS, _HALVINGS = 8, 7


def measure_times(
    configs: Sequence[Config], progress: Callable[[int], None] = lambda done: None
) -> tuple[list[Times], Load]:
    """Times the techniques of `configs`, which differ in nothing else, on the first view, after compilation.

    They are timed one after another in rounds. Every second round runs backwards. The camera's surface, which is the
    same for all, is not counted. `progress` is called with the number of finished steps, of `steps_of(configs)`.

    **Returns** the times, and the load of the machine.
    """
    first = configs[0].views[0].config if configs[0].views else configs[0]
    scene = load(first, Progress.quiet()).scene
    surface = jax.block_until_ready(raster.draw_surface(scene.mesh, scene.camera))
    lit = [scene.lit_by(i) for i in range(len(scene.lights))]

    def once(technique: Any) -> tuple[float, float]:
        started = time.perf_counter()
        states = jax.block_until_ready([technique.prepare(each, surface) for each in lit])
        drawn = time.perf_counter()
        jax.block_until_ready([technique.visibility(state, surface) for state in states])
        return drawn - started, time.perf_counter() - drawn

    techniques = []
    for done, config in enumerate(configs, start=1):
        techniques.append(build_technique(config, fitting=False))
        once(techniques[-1])
        progress(done)
    rounds, watch = np.empty((_ROUNDS, len(techniques), 2)), Watch()
    for done in range(_ROUNDS):
        order = range(len(techniques)) if done % 2 == 0 else reversed(range(len(techniques)))
        for i in order:
            rounds[done, i] = once(techniques[i])
        progress(len(configs) + done + 1)
    times = times_of(rounds, [_program_of(technique) for technique in techniques])
    return times, Load(others=watch.others(), unevenness=unevenness_of(rounds))


def steps_of(configs: Sequence[Config]) -> int:
    """The number of steps of `measure_times`."""
    return len(configs) + _ROUNDS


def _program_of(technique: Any) -> Hashable:
    """The part of a technique that its compiled programs depend on: everything except its numbers."""
    return jax.tree.structure(technique), tuple((leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(technique))


def judged(config: Config) -> tuple[Any, list[Drawn]]:
    """The technique of a fitted `config`, and its test scenes: the validation views, or all views if there are none."""
    technique, views = _drawn(config)
    return technique, [each for view in views.validation or views.fitted for each in view.drawn]


def _drawn(config: Config) -> tuple[Any, Views]:
    progress, technique = Progress.quiet(), build_technique(config, fitting=False)
    return technique, draw_views(config, load(config, progress), technique, progress)


def unexplained_by(config: Config) -> list[str]:
    """The first sentence about a fitted technique that does not explain its references, or an empty text."""
    technique, views = _drawn(config)
    drawn = views.drawn[: views.seen]
    found = unexplained(fitted_images(views, drawn, [visibility_of(technique, each) for each in drawn], drawn))
    if found is None:
        return []
    said = unexplained_verdict(config, found, starts=config.fit.multistart, moves=config.moves)
    return [said.sentence, *said.remedies]


def least_bias_for(config: Config, name: str, most: float) -> LeastBias:
    """The smallest value of the bias `name` with a rate of false shadow of at most `most`, up to its bound.

    The search starts at the value in `config` and moves away from 0, first by steps and then by bisection. All other
    numbers stay the same. The rate may rise again, because a large normal offset causes false shadow. Errors are over
    the validation, or over the fitted views if there is none.

    **Arguments:**

    - `config`: the configuration of the fitted technique.
    - `name`: a number of the bias, such as `"bias.constant"`.
    """
    technique, drawn = judged(config)
    bounds = config.fit.parameters[name]
    # three.js' bias is negative.
    path, low, high = fit_paths(config)[name], config.initial(name), bounds.upper if bounds.upper > 0 else bounds.lower

    def at(value: float) -> LeastBias:
        changed: Any = fit.with_values(technique, [path], as_float([value]))  # type: ignore[arg-type]
        errors = combined([measured(visibility_of(changed, each), each) for each in drawn], drawn)
        dark, light = errors["false_shadow_rate"], errors["false_light_rate"]
        return LeastBias(value=value, false_shadow=dark, false_light=light)

    tried = []
    for value in np.linspace(low, high, _STEPS + 1):
        tried.append(at(float(value)))
        if tried[-1].false_shadow <= most:
            break
    else:
        return min(tried, key=lambda each: each.false_shadow)
    found = tried.pop()
    if not tried:
        return found
    low = tried[-1].value
    for _ in range(_HALVINGS):
        middle = at((low + found.value) / 2)
        if middle.false_shadow <= most:
            found = middle
        else:
            low = middle.value
    return found


def single_bias(values: Mapping[str, float]) -> str | None:
    """The only number of a bias among fitted `values`, or `None` if there are several or none."""
    names = [name for name in values if name.startswith("bias.") or name in _OF_ENGINES]
    return names[0] if len(names) == 1 else None
