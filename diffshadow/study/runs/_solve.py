"""Plans and runs a fit, and shows how far it is."""

from collections.abc import Callable, Sequence

import jax

from ... import fit, geometry
from ...config import Config, ConfigError, FitPlan, Mistake, build_fit
from ._progress import Stages


def check_processes(config: Config) -> None:
    """**Raises** `ConfigError` where JAX has several processes, and these cannot share the fit of `config`."""
    processes = jax.process_count()
    if processes == 1:
        return
    if config.moves or config.fit.shape is not None or config.reference.type == "picture":
        place, said = ("fit",), "expected one: they can share only the fit of a technique to images of its shadows"
    elif config.fit.devices == 1:
        place, said = ("fit", "devices"), "expected devices: 0, so that all of them share the fit"
    else:
        return
    message = f"JAX has {processes} processes; {said}"
    raise ConfigError([Mistake(config.origin.place(place), ".".join(place), message)])


def plan_fit(config: Config, scene: geometry.Scene) -> FitPlan:
    """The fit of `config`, whose scene is `scene`.

    **Raises** `ConfigError` as `build_fit` does, and for more devices than there are or than the fit can use.
    """
    plan = build_fit(config, scene)
    try:
        fit.devices_of(plan.search.devices, moves=config.moves)
    except ValueError as error:
        raise ConfigError([Mistake(config.origin.place(("fit", "devices")), "fit.devices", str(error))]) from error
    return plan


def solve(
    problems: Sequence[fit.AbstractProblem],
    plan: FitPlan,
    stages: Stages,
    on_step: Callable[[fit.Step], None] | None = None,
) -> fit.FitResult:
    """Fits the parameters of `plan`; `on_step` as in `fit.fit`. Its times are added to `stages`."""
    stages.show("compiling")
    result = fit.fit(
        problems,
        plan.parameters,
        solver=plan.solver,
        anneal=plan.anneal,
        loss=plan.loss,
        search=plan.search,
        sureness=plan.sureness,
        on_step=on_step,
        progress=lambda detail, done: stages.show("fitting", detail, done),
    )
    stages.seconds |= {"compiling": result.seconds_compiling, "fitting": result.seconds_running}
    return result
