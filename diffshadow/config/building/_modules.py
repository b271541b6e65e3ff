"""Builds the fit of a configuration. Other modules of this folder build its scene and its technique."""

import dataclasses
import inspect
from typing import Any

from ... import fit, geometry, shadow
from ..._checks import text_within
from ...settings.engines import Engine
from ...settings.reference import PictureReference
from ...settings.techniques import Mapped, OwnTechnique
from .._errors import ConfigError, Mistake
from ..framing._meshes import build_mesh as build_mesh
from ..reading._mistakes import mistakes_at
from ..sections._config import Config
from ..sections._fit import FitParameterConfig, preferences
from ..sections._fitted import fit_units, fittable_of, is_pose
from ._scene import BuiltMeshes as BuiltMeshes
from ._scene import at, blame, build_scene
from ._scene import build_camera as build_camera
from ._scene import build_lights as build_lights
from ._scene import build_meshes as build_meshes
from ._shape import Screen as Screen
from ._shape import ShapePlan as ShapePlan
from ._shape import build_free as build_free
from ._shape import build_shape as build_shape
from ._technique import build_fittable as build_fittable
from ._technique import build_shading, build_shadow_mapping, module_of, values_of
from ._technique import build_technique as build_technique


@dataclasses.dataclass(frozen=True, kw_only=True)
class FitPlan:
    """The parameters and the settings of a fit.

    - `solver`, `anneal`, `search`, `sureness`: as for `fit.fit`.
    - `loss`: a `fit.Loss` of the errors of all views and lights, or a user's loss.
    - `arrangement`: technique, lights and meshes of the scene; `None` if no lights or meshes are fitted.
    - `truth`: the scene's own values of fitted poses, by name, if the reference is traced.
    - `points`: as for `fit.PoseProblem.of`.
    """

    parameters: list[fit.Parameter]
    solver: fit.Solver
    anneal: fit.Anneal
    loss: Any
    search: fit.Search
    sureness: fit.Sureness
    arrangement: fit.Arrangement | None
    truth: dict[str, float]
    points: int | None


def build_fit(config: Config, scene: geometry.Scene | None = None) -> FitPlan:
    """The parameters to fit, the solver and the annealing of `config`.

    **Arguments:**

    - `scene`: the scene of `config`, if it is already built. Only a fit of lights or meshes needs it.

    **Raises** `ConfigError` if one of them cannot be built, or if the technique cannot be fitted.
    """
    if not _can_be_fitted(config):
        raise ConfigError([Mistake(*at(config, ("technique", "type")), _no_gradient(config.technique.type))])
    if mistakes := mistakes_at(config.fit_faults(), config.origin):
        raise ConfigError(mistakes)
    solver, anneal = config.fit.solver, config.fit.anneal
    with blame(config, ("fit", "solver")):
        built_solver = fit.Solver(solver.type, **values_of(solver))
    with blame(config, ("fit", "anneal")):
        built_anneal = fit.Anneal(**values_of(anneal))
    arrangement = None
    if config.moves:
        scene = build_scene(config) if scene is None else scene
        arrangement = build_arrangement(config, scene)
    parameters, truth, units = [], {}, fit_units(config)
    origin = geometry.WORLD if scene is None else scene.origin
    for name, bounds in config.fit.parameters.items():
        with blame(config, ("fit", "parameters", name)):
            path, start, offset = _start(config, name, arrangement, origin)
            start, limits = _within(start, bounds, units[name]), (bounds.lower, bounds.upper)
            if is_pose(name) and is_truth(config):
                truth[name] = _reachable(start, bounds)
            start = start if bounds.initial is None else bounds.initial
            parameters.append(fit.Parameter(name, start, *limits, units[name], path, offset))
    section = config.fit
    prefer: dict[str, fit.Bound] = {name: _towards_zero(section.parameters[name]) for name in preferences(section)}
    return FitPlan(
        parameters=parameters,
        solver=built_solver,
        anneal=built_anneal,
        loss=_loss(config, built_solver),
        search=fit.Search(
            starts=section.multistart,
            seed=config.seed,
            blurs=section.blurs,
            evaluations=section.evaluations,
            pixels=section.pixels,
            devices=section.devices,
        ),
        sureness=fit.Sureness(section.intervals, tuple(prefer.items()), section.tolerance, section.front),
        arrangement=arrangement,
        truth=truth,
        points=section.points,
    )


def is_truth(config: Config) -> bool:
    """Whether the reference shows the unchanged scene."""
    reference = config.reference
    return reference.type == "traced" or (isinstance(reference, PictureReference) and reference.path is None)


def build_arrangement(config: Config, scene: geometry.Scene) -> fit.Arrangement:
    """The technique of `config`, with its lights and meshes in their initial poses. For a fit to a picture, also its
    camera and shading.

    **Raises** `ConfigError` if a vertex to fit does not exist in its mesh.
    """
    poses, origin = [], scene.origin
    for i, (mesh, section) in enumerate(zip(scene.meshes, config.scene.meshes, strict=True)):
        vertices = {}
        for name in config.fit.parameters:
            number = fittable_of(config, name)
            if number is not None and number.vertex is not None and number.vertex[0] == i:
                vertices[number.vertex[1]] = name
        for vertex, name in vertices.items():
            with blame(config, ("fit", "parameters", name)):
                fit.MeshPose.of(mesh, (vertex,))
        home = tuple(x - _offset(x, at) for x, at in zip(section.translate, origin, strict=True))
        coloured = config.reference.type == "picture"
        poses.append(fit.MeshPose.of(mesh, tuple(vertices), home, coloured=coloured))
    arrangement = fit.Arrangement.of(build_shadow_mapping(config), scene.lights, poses)
    if not isinstance(config.reference, PictureReference):
        return arrangement
    return arrangement.pictured(scene, build_shading(config), config.reference.exposure)


def _can_be_fitted(config: Config) -> bool:
    section = config.technique
    if isinstance(section, OwnTechnique):
        return issubclass(section.plugin, shadow.AbstractTechnique) and _is_fittable(section.plugin)
    return isinstance(section, Mapped | Engine)


def _is_fittable(kind: type[shadow.AbstractTechnique]) -> bool:
    """Whether a class of techniques has a compare, which may be a field, and a method `lays_out`."""
    fields = {field.name for field in dataclasses.fields(kind)}
    return hasattr(kind, "lays_out") and ("compare" in fields or hasattr(kind, "compare"))


def _loss(config: Config, solver: fit.Solver) -> Any:
    """The loss of a fit, which may be a user's loss."""
    section = config.fit.loss
    if section.plugin is None:
        return fit.Loss(**values_of(section))
    with blame(config, ("fit", "loss")):
        kind = type(section).plugin
        loss = module_of(section)(**values_of(section)) if inspect.isclass(kind) else kind
        try:
            fit.check_loss(loss, solver, config.scene.camera.resolution)
        except TypeError as error:
            raise ValueError(str(error)) from error
    return loss


def _start(
    config: Config, name: str, arrangement: fit.Arrangement | None, origin: geometry.Origin
) -> tuple[str, float, float]:
    """The path of the parameter `name` in the fitted module, its value in the configuration, and the origin of the
    module's number."""
    number = fittable_of(config, name)
    assert number is not None
    if not is_pose(name):
        path = number.path if arrangement is None else f"technique.{number.path}"
        return path, config.initial(name), 0.0
    offset = 0.0
    if number.axis is not None:
        offset = origin[number.axis]
        if ".translate." in name:
            offset = _offset(config.scene.meshes[int(name.split(".")[2])].translate[number.axis], offset)
    return number.path, offset + float(fit.resolve(arrangement, number.path)), offset


def _offset(translation: float, origin: float) -> float:
    """The origin of a mesh's translation along an axis: the scene's origin, unless its file is placed there."""
    return origin if abs(translation - origin) < abs(translation) else 0.0


def _towards_zero(bounds: FitParameterConfig) -> fit.Bound:
    """The bound that is closer to 0."""
    return "lower" if abs(bounds.lower) <= abs(bounds.upper) else "upper"


def _within(value: float, bounds: FitParameterConfig, unit: str) -> float:
    """Wraps an angle by full turns into its bounds, if possible."""
    wrapped = bounds.lower + (value - bounds.lower) % 360
    return wrapped if unit == "degrees" and wrapped <= bounds.upper else value


def _reachable(truth: float, bounds: FitParameterConfig) -> float:
    """`truth`, if it is within the bounds.

    **Raises** `ValueError` if it is not.
    """
    if not bounds.lower <= truth <= bounds.upper:
        given, lower, upper = (
            text_within(value, bounds.lower, bounds.upper, 6) for value in (truth, bounds.lower, bounds.upper)
        )
        raise ValueError(
            f"is {given} in the scene, from which the reference is traced; expected a value within the fit's bounds, "
            f"lower = {lower} to upper = {upper}; widen the bounds, or move it in the scene"
        )
    return truth


def _no_gradient(kind: str) -> str:
    why = {
        "shadow_volumes": "whose visibility has no gradient",
        "irregular_z_buffer": "whose visibility has no gradient",
        "projective_texture": "which has neither a bias nor a filter to fit",
    }.get(kind, "which has no compare and lays_out, as shadow.FittableTechnique has")
    return (
        f"is {kind}, {why}; expected a technique that can be fitted, such as shadow_map: change it, or render instead"
    )
