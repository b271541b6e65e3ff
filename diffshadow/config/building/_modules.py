"""Builds the scene, the technique, the shading and the fit of a configuration."""

import dataclasses
import inspect
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from ... import fit, geometry, shading, shadow
from ..._checks import text_within
from ...settings.engines import Engine
from ...settings.reference import PictureReference
from ...settings.shading import INTENSITY, ModulatedShadow
from ...settings.techniques import Mapped, OwnTechnique
from .._errors import ConfigError, KeyPath, Location, Mistake, dotted
from ..framing._meshes import Placed, place_mesh
from ..framing._meshes import build_mesh as build_mesh
from ..reading._dump import fit_units
from ..reading._mistakes import mistakes_at
from ..sections._fit import FitParameterConfig
from ..sections._fitted import fit_paths
from ..sections._poses import fits_each_intensity, is_pose, pose_of
from ..whole._preferences import preferences
from ..whole._schema import Config
from ._scene import Stage, camera_on, light_on, stage_of
from ._shape import Screen as Screen
from ._shape import ShapePlan as ShapePlan
from ._shape import plan_shape
from ._technique import build_bias, build_compare, build_filter, build_layout, module_of

# 120 bytes per triangle, with normals, colours and indices.
_MAX_TRIANGLES = 1 << 25


@dataclasses.dataclass(frozen=True, kw_only=True)
class FitPlan:
    """What is fitted, and how.

    - `solver`, `anneal`, `search`, `sureness`: as for `fit.fit`.
    - `loss`: of the errors of all views and lights, a `fit.Loss` or a user's.
    - `arrangement`: technique, lights and meshes of the scene if lights or meshes are fitted; otherwise none.
    - `truth`: the scene's own values of fitted poses, by name, if the reference is traced.
    """

    parameters: list[fit.Parameter]
    solver: fit.Solver
    anneal: fit.Anneal
    loss: Any
    search: fit.Search
    sureness: fit.Sureness
    arrangement: fit.Arrangement | None
    truth: dict[str, float]


def build_scene(config: Config, staged: "StagedMeshes | None" = None) -> geometry.Scene:
    """The scene of `config`: its meshes, its camera and its lights, all counted from the scene's origin.

    **Arguments:** `staged`: the meshes of `config`, if `build_meshes` has made them before.

    Warns with `io.MeshWarning` about contents of mesh files other than triangles.

    **Raises** `ConfigError` for each mesh, camera or light that cannot be made, with its key, and for an open mesh that
    casts if only back faces cast.

    !!! Example

        ```python
        settings = config.parse_config("scene: {meshes: [{path: builtin:torus}], camera: {resolution: [32, 32]}}")
        config.build_scene(settings).camera.resolution  # (32, 32)
        ```
    """
    staged = build_meshes(config) if staged is None else staged
    return staged.scene(config, build_camera(config, staged), build_lights(config, staged))


def build_meshes(config: Config) -> "StagedMeshes":
    """The meshes of `config`, and what its camera and its lights are placed relative to.

    **Raises** `ConfigError` as `build_scene` does.
    """
    placed = _meshes_of(config)
    origin = geometry.origin_of(np.concatenate([mesh.bounds for mesh in placed]))
    meshes = [mesh.counted_from(origin) for mesh in placed]
    _check_closed(config, meshes)
    casts = [mesh.casts for mesh in config.scene.meshes]
    casters = geometry.merge([mesh for mesh, does in zip(meshes, casts, strict=True) if does])
    return StagedMeshes(meshes, stage_of(geometry.merge(meshes), casters, meshes[0], origin))


class StagedMeshes(NamedTuple):
    """The meshes of a configuration, and the stage that its camera and its lights are placed on."""

    meshes: list[geometry.Mesh]
    stage: Stage

    def scene(
        self, config: Config, camera: geometry.AbstractCamera, lights: Sequence[geometry.AbstractLight]
    ) -> geometry.Scene:
        """The scene of `config` with this `camera` and these `lights`."""
        casts = tuple(mesh.casts for mesh in config.scene.meshes)
        receives = tuple(mesh.receives for mesh in config.scene.meshes)
        return geometry.Scene(self.meshes, camera, lights, casts, receives, self.stage.origin)


def build_camera(config: Config, staged: StagedMeshes) -> geometry.AbstractCamera:
    """The camera of `config`.

    **Raises** `ConfigError` if it cannot be made.
    """
    with _blame(config, ("scene", "camera"), staged.stage.origin):
        return camera_on(config.scene.camera, staged.stage)


def build_lights(config: Config, staged: StagedMeshes) -> list[geometry.AbstractLight]:
    """The lights of `config`.

    **Raises** `ConfigError` if one cannot be made.
    """
    lights = []
    for key, light in config.scene.each_light.items():
        with _blame(config, ("scene", *key), staged.stage.origin):
            lights.append(light_on(light, staged.stage))
    return lights


def _meshes_of(config: Config) -> list[Placed]:
    """The scene's meshes, in the world.

    **Raises** `ConfigError` with a mistake for each mesh that cannot be made.
    """
    meshes, mistakes, triangles = [], [], 0
    for i, section in enumerate(config.scene.meshes):
        try:
            with _blame(config, ("scene", "meshes", i)):
                mesh = place_mesh(section)
                triangles += mesh.faces.shape[0]
                if triangles > _MAX_TRIANGLES:
                    raise ValueError(
                        f"brings the scene to {triangles:,} triangles; expected at most {_MAX_TRIANGLES:,}, which "
                        "take 4 GB; simplify it, or leave meshes out"
                    )
                meshes.append(mesh)
        except ConfigError as error:
            mistakes += error.mistakes
            if triangles > _MAX_TRIANGLES:
                break
    if mistakes:
        raise ConfigError(mistakes)
    return meshes


def build_technique(config: Config, *, fitting: bool = True) -> shadow.AbstractTechnique:
    """The technique of `config`.

    **Arguments:**

    - `fitting`: whether its numbers may later be set to any value within the bounds of their fit. Otherwise the section
        `fit` is ignored: a box filter takes only the taps that the radius of `config` needs.

    **Raises** `ConfigError` if its parts cannot be made.
    """
    if isinstance(config.technique, Mapped | Engine):
        return build_fittable(config, fitting=fitting)
    with _blame(config, ("technique",)):
        return module_of(config.technique)(**_values(config.technique))


def build_shadow_mapping(config: Config, *, fitting: bool = True) -> shadow.ShadowMapping:
    """The shadow mapping of `config`, even if its technique is another one; otherwise as `build_technique`."""
    with _blame(config, ("bias",)):
        bias = build_bias(config, fitting=fitting)
    with _blame(config, ("compare",)):
        compare = build_compare(config.compare)
    with _blame(config, ("filter",)):
        kernel = build_filter(config, fitting=fitting)
    settings = shadow.MapSettings(**_values(config.shadow_map))
    with _blame(config, ("technique",)):
        return shadow.ShadowMapping(kernel, bias, compare, settings, build_layout(config, fitting=fitting))


def build_fittable(config: Config, *, fitting: bool = True) -> Any:
    """The technique of `config` that a fit changes: an engine's, a user's, or shadow mapping; otherwise as
    `build_technique`."""
    section = config.technique
    if not section.is_whole:
        return build_shadow_mapping(config, fitting=fitting)
    with _blame(config, ("technique",)):
        if not isinstance(section, Engine):
            return module_of(section)(**_values(section))
        return module_of(section)(resolution=config.shadow_map.resolution, **_values(section))


def build_shading(config: Config) -> shading.AbstractShading:
    """The shading of `config`.

    **Raises** `ConfigError` if it cannot be made.
    """
    section, lights = config.shading, len(config.scene.each_light)
    intensity = INTENSITY / lights if section.intensity is None else section.intensity
    intensities = section.intensities
    if intensities is None and fits_each_intensity(config):
        intensities = (intensity,) * lights
    with _blame(config, ("shading",)):
        phong = shading.Phong(
            ambient=section.ambient,
            intensity=intensity,
            intensities=intensities,
            specular=section.specular,
            shininess=section.shininess,
            background=section.background,
            attenuation=shading.Attenuation(**_values(section.attenuation)),
            model=section.model,
        )
        return shading.ModulatedShadow(phong, section.factor) if isinstance(section, ModulatedShadow) else phong


def build_fit(config: Config, scene: geometry.Scene | None = None) -> FitPlan:
    """The parameters to fit, the solver and the annealing of `config`.

    **Arguments:**

    - `scene`: the scene of `config`, if it has been built; only a fit of lights or meshes needs it.

    **Raises** `ConfigError` if one of them cannot be made, or the technique cannot be fitted.
    """
    if not _can_be_fitted(config):
        raise ConfigError([Mistake(*_at(config, ("technique", "type")), _no_gradient(config.technique.type))])
    if mistakes := mistakes_at(config.fit_faults(), config.origin):
        raise ConfigError(mistakes)
    solver, anneal = config.fit.solver, config.fit.anneal
    with _blame(config, ("fit", "solver")):
        built_solver = fit.Solver(solver.type, **_values(solver))
    with _blame(config, ("fit", "anneal")):
        built_anneal = fit.Anneal(**_values(anneal))
    arrangement = None
    if config.moves:
        scene = build_scene(config) if scene is None else scene
        arrangement = build_arrangement(config, scene)
    parameters, truth, units = [], {}, fit_units(config)
    origin = geometry.WORLD if scene is None else scene.origin
    for name, bounds in config.fit.parameters.items():
        with _blame(config, ("fit", "parameters", name)):
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
    )


def build_shape(config: Config) -> ShapePlan:
    """The lights, screens and meshes of a fit of a shape.

    **Raises** `ConfigError` for a mesh, a light or an image that cannot be used.
    """
    return plan_shape(config, lambda path: _blame(config, path))


def is_truth(config: Config) -> bool:
    """Whether the scene as it stands is what the reference shows."""
    reference = config.reference
    return reference.type == "traced" or (isinstance(reference, PictureReference) and reference.path is None)


def build_arrangement(config: Config, scene: geometry.Scene) -> fit.Arrangement:
    """The technique of `config`, with its lights and meshes in their initial poses, and for a fit to a picture its
    camera and shading.

    **Raises** `ConfigError` if a vertex to fit does not exist in its mesh.
    """
    poses, origin = [], scene.origin
    for i, (mesh, section) in enumerate(zip(scene.meshes, config.scene.meshes, strict=True)):
        named = {name: pose_of(config, name) for name in config.fit.parameters if is_pose(name)}
        vertices = {
            pose.vertex[1]: name for name, pose in named.items() if pose and pose.vertex and pose.vertex[0] == i
        }
        for vertex, name in vertices.items():
            with _blame(config, ("fit", "parameters", name)):
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
    """Whether a class of techniques has a compare, which may be a field, and says what it lays out."""
    fields = {field.name for field in dataclasses.fields(kind)}
    return hasattr(kind, "lays_out") and ("compare" in fields or hasattr(kind, "compare"))


def _loss(config: Config, solver: fit.Solver) -> Any:
    """The loss of a fit, which may be a user's."""
    section = config.fit.loss
    if section.plugin is None:
        return fit.Loss(**_values(section))
    with _blame(config, ("fit", "loss")):
        kind = type(section).plugin
        loss = module_of(section)(**_values(section)) if inspect.isclass(kind) else kind
        try:
            fit.check_loss(loss, solver, config.scene.camera.resolution)
        except TypeError as error:
            raise ValueError(str(error)) from error
    return loss


def _values(section: Any) -> dict[str, Any]:
    """The values of a section's keys, without its type."""
    return {key: getattr(section, key) for key in type(section).model_fields if key != "type"}


def _start(
    config: Config, name: str, arrangement: fit.Arrangement | None, origin: geometry.Origin
) -> tuple[str, float, float]:
    """The path of the parameter `name` in the fitted module, its value in the configuration, and what the module's
    number is counted from."""
    pose = pose_of(config, name) if is_pose(name) else None
    if pose is None:
        path = fit_paths(config)[name]
        return path if arrangement is None else f"technique.{path}", config.initial(name), 0.0
    offset = 0.0
    if pose.axis is not None:
        offset = origin[pose.axis]
        if ".translate." in name:
            offset = _offset(config.scene.meshes[int(name.split(".")[2])].translate[pose.axis], offset)
    return pose.path, offset + float(fit.resolve(arrangement, pose.path)), offset


def _offset(translation: float, origin: float) -> float:
    """What a mesh's translation along an axis is counted from: the scene's origin, unless its file is there."""
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


@contextmanager
def _blame(config: Config, path: KeyPath, origin: geometry.Origin = geometry.WORLD) -> Iterator[None]:
    """Reports errors raised inside as mistakes of the key at `path`. Coordinates in their texts are counted from
    `origin`."""
    try:
        yield
    except ConfigError:
        raise
    except geometry.OptionError as error:
        raise ConfigError([Mistake(*_at(config, (*path, "options", error.option)), error.what)]) from error
    except (ValueError, OSError) as error:
        where = "" if origin == geometry.WORLD else f" (coordinates are counted from the scene's origin, {[*origin]})"
        raise ConfigError([Mistake(*_at(config, path), f"{error}{where}")]) from error


def _at(config: Config, path: KeyPath) -> tuple[Location, str]:
    """Where the key at `path` was written, and its name."""
    return config.origin.place(path), dotted(path)


def _check_closed(config: Config, meshes: list[geometry.Mesh]) -> None:
    """**Raises** `ConfigError` for every open mesh that casts, if only back faces cast."""
    if not isinstance(config.technique, Mapped) or config.shadow_map.cull != "front":
        return
    what = (
        "is an open mesh that casts shadows, while shadow_map.cull is front; expected closed meshes, since only back "
        "faces cast: set casts: false if it only receives, or shadow_map.cull to none"
    )
    mistakes = [
        Mistake(*_at(config, ("scene", "meshes", i)), what)
        for i, (mesh, section) in enumerate(zip(meshes, config.scene.meshes, strict=True))
        if section.casts and not geometry.Edges.of(mesh).is_closed
    ]
    if mistakes:
        raise ConfigError(mistakes)


def _no_gradient(kind: str) -> str:
    why = {
        "shadow_volumes": "whose visibility has no gradient",
        "irregular_z_buffer": "whose visibility has no gradient",
        "projective_texture": "which has neither a bias nor a filter to fit",
    }.get(kind, "which has no compare and lays_out, as shadow.FittableTechnique has")
    return (
        f"is {kind}, {why}; expected a technique that can be fitted, such as shadow_map: change it, or render instead"
    )
