"""From a configuration to the modules that do the work.

Only this file of the room loads JAX, so that the faults of a configuration are told at once.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import fit, geometry, io, shadow
from .._types import HostArray, Scalar, Vec3
from ._errors import ConfigError, KeyPath, Problem, dotted
from ._scene import (
    DirectionalLightConfig,
    MeshConfig,
    OrthographicCameraConfig,
    PinholeCameraConfig,
    SpotLightConfig,
)
from ._schema import Config
from ._technique import (
    BilinearConfig,
    FourTapConfig,
    HardCompareConfig,
    NearestConfig,
    PercentageCloserConfig,
    RandomDiskConfig,
    SoftCompareConfig,
)

# Room left round the scene along the view axis, as a share of its depth.
_MARGIN = 0.01
# Nearer than this share of `far`, a perspective depth has little precision left for the rest.
_LEAST_NEAR = 1e-3


class FitPlan(NamedTuple):
    """What is fitted, by which solver, and how the compare's width shrinks meanwhile."""

    parameters: list[fit.Parameter]
    solver: fit.Solver
    anneal: fit.Anneal


def build_scene(config: Config) -> geometry.Scene:
    """The scene of `config`: its meshes as one, its camera and its light.

    **Raises** `ConfigError` for each mesh, camera or light that cannot be made, with the key it comes from.
    """
    meshes, problems = [], []
    for i, mesh in enumerate(config.scene.meshes):
        try:
            with _blame(config, ("scene", "meshes", i)):
                meshes.append(build_mesh(mesh))
        except ConfigError as error:
            problems += error.problems
    if problems:
        raise ConfigError(problems)
    whole = geometry.merge(meshes)
    stage = _stage(whole, meshes[0])
    with _blame(config, ("scene", "camera")):
        camera = _camera(config.scene.camera, stage)
    with _blame(config, ("scene", "light")):
        light = _light(config.scene.light, stage)
    return geometry.Scene(whole, camera, light)


def build_mesh(config: MeshConfig) -> geometry.Mesh:
    """One mesh, at its place in the scene.

    **Raises** `ValueError` if its file cannot be used, or its options do not suit it.
    """
    if config.builtin is not None:
        mesh = geometry.library_mesh(config.builtin, **config.options)
    else:
        mesh = io.load_mesh(config.path, config.crease_angle)
    if config.size is not None:
        mesh = geometry.fit_to_size(mesh, config.size)
    if config.drop_to_ground:
        mesh = geometry.drop_to_ground(mesh)
    mesh = geometry.Mesh(mesh.vertices, mesh.faces, mesh.corner_normals, config.albedo)
    return _placed(mesh, *map(jnp.asarray, (config.scale, config.rotate, config.translate)))


def build_technique(config: Config, *, fitting: bool = True) -> shadow.ShadowMapping:
    """The shadow-mapping technique of `config`.

    **Arguments:**

    - `fitting`: whether the filter's radius may later be set to any value within the bounds of its fit. Without this a
        box filter takes only the taps that the radius of `config` needs.

    **Raises** `ConfigError` if its parts cannot be made.
    """
    with _blame(config, ("bias",)):
        bias = shadow.Bias(
            constant=config.bias.constant, slope=config.bias.slope, normal_offset=config.bias.normal_offset
        )
    with _blame(config, ("compare",)):
        compare = _compare(config.compare)
    with _blame(config, ("filter",)):
        kernel = _filter(config, fitting)
    return shadow.ShadowMapping(bias=bias, filter=kernel, compare=compare)


def build_fit(config: Config) -> FitPlan:
    """The parameters to fit, the solver and the annealing of `config`.

    **Raises** `ConfigError` if one of them cannot be made.
    """
    parameters = []
    for name, bounds in config.fit.parameters.items():
        with _blame(config, ("fit", "parameters", name)):
            parameters.append(fit.Parameter(name, config.initial(name), bounds.lower, bounds.upper))
    solver, anneal = config.fit.solver, config.fit.anneal
    with _blame(config, ("fit", "solver")):
        built_solver = fit.Solver(solver.type, solver.max_steps, solver.rtol, solver.atol)
    with _blame(config, ("fit", "anneal")):
        built_anneal = fit.Anneal(anneal.start, anneal.end, anneal.phases, anneal.kernel)
    return FitPlan(parameters, built_solver, built_anneal)


@contextmanager
def _blame(config: Config, path: KeyPath) -> Iterator[None]:
    """Lays errors of what is built inside to the key at `path`."""
    try:
        yield
    except ConfigError:
        raise
    except (ValueError, OSError) as error:
        raise ConfigError([Problem(config.origin.place(path), dotted(path), str(error))]) from error


class _Stage(NamedTuple):
    """What cameras and lights are placed by: all points (n, 3), and the first mesh's middle and radius."""

    points: Float[HostArray, "n 3"]
    middle: Float[HostArray, "3"]
    radius: float

    def around(self, azimuth: float, elevation: float, distance: float) -> Vec3:
        """The point at `distance` radii from the middle, at the angles in degrees."""
        return geometry.orbit_eye(jnp.asarray(self.middle), distance * self.radius, azimuth, elevation)


def _stage(whole: geometry.Mesh, first: geometry.Mesh) -> _Stage:
    corners = np.asarray(first.vertices)[np.unique(first.faces)]
    middle = np.asarray(first.bounds).mean(axis=0)
    radius = float(np.linalg.norm(corners - middle, axis=-1).max())
    return _Stage(np.asarray(whole.vertices)[np.unique(whole.faces)], middle, radius)


# Compiled as one, since a mesh's first dozens of single operations would take longer than all the rest.
@eqx.filter_jit
def _placed(mesh: geometry.Mesh, scale: Scalar, rotate: Vec3, translate: Vec3) -> geometry.Mesh:
    """The mesh scaled, turned about x, y and z in turn by `rotate` degrees, then moved."""
    # Some devices multiply matrices in half the digits unless told not to.
    with jax.default_matmul_precision("highest"):
        x, y, z = (geometry.rotation(axis, jnp.deg2rad(turn)) for axis, turn in zip(jnp.eye(3), rotate, strict=True))
        return mesh.transformed(geometry.translation(translate) @ z @ y @ x @ geometry.scaling(scale))


def _camera(config: PinholeCameraConfig | OrthographicCameraConfig, stage: _Stage) -> geometry.AbstractCamera:
    target = jnp.asarray(stage.middle if config.target is None else config.target)
    if config.eye is not None:
        eye = jnp.asarray(config.eye)
    else:
        assert config.orbit is not None
        eye = stage.around(config.orbit.azimuth, config.orbit.elevation, config.orbit.distance)
    if bool((eye == target).all()):
        raise ValueError(f"the camera's eye and target are both {eye.tolist()}; expected two points: move one of them")
    up = jnp.asarray(config.up)
    # What the scene spans across the view, and along it.
    view = np.asarray(geometry.look_at(eye, target - eye, up), np.float64)
    across, upwards, backward = (stage.points @ view[:3, :3].T + view[:3, 3]).T
    near, far = _depth_range(-backward, perspective=isinstance(config, PinholeCameraConfig))
    near = near if config.near is None else config.near
    far = far if config.far is None else config.far
    if isinstance(config, PinholeCameraConfig):
        return geometry.PinholeCamera(
            eye, target, up, fov_y=jnp.asarray(config.fov_y), near=near, far=far, resolution=config.resolution
        )
    rows, columns = config.resolution
    needed = 2 * max(np.abs(upwards).max(), np.abs(across).max() * rows / columns) * (1 + _MARGIN)
    height = float(needed) if config.height is None else config.height
    return geometry.OrthographicCamera(eye, target, up, height=height, near=near, far=far, resolution=config.resolution)


def _depth_range(depth: Float[HostArray, "n"], *, perspective: bool) -> tuple[float, float]:
    """Near and far that hold the points at `depth` (n,) along the view axis, tightly; all in world units.

    **Raises** `ValueError` if `perspective` and all points lie behind the eye.
    """
    low, high = float(depth.min()), float(depth.max())
    if perspective and high <= 0:
        raise ValueError(
            f"the whole scene lies behind the camera (its depth is {low:.4g} to {high:.4g} world units); "
            "expected some of it in front: turn the camera round by its eye or target"
        )
    # A scene that is flat seen from the camera still needs a range.
    margin = max(_MARGIN * (high - low), _LEAST_NEAR * max(abs(low), abs(high)))
    near, far = low - margin, high + margin
    return (max(near, _LEAST_NEAR * far) if perspective else near), far


def _light(config: DirectionalLightConfig | SpotLightConfig, stage: _Stage) -> geometry.AbstractLight:
    points = jnp.asarray(stage.points)
    if isinstance(config, DirectionalLightConfig):
        if config.direction is not None:
            direction = jnp.asarray(config.direction)
        else:
            assert config.azimuth is not None
            assert config.elevation is not None
            direction = -geometry.orbit_eye(jnp.zeros(3), 1.0, config.azimuth, config.elevation)
        return geometry.DirectionalLight.around(direction, points, config.angular_radius)
    if config.position is not None:
        position = jnp.asarray(config.position)
    else:
        assert config.orbit is not None
        position = stage.around(config.orbit.azimuth, config.orbit.elevation, config.orbit.distance)
    target = None if config.target is None else jnp.asarray(config.target)
    tight = geometry.SpotLight.around(
        position, points, target=target, outer_angle=config.outer_angle, radius=config.radius
    )
    near = tight.near if config.near is None else config.near
    far = tight.far if config.far is None else config.far
    return geometry.SpotLight(tight.position, tight.direction, tight.outer_angle, near, far, tight.radius)


def _compare(config: HardCompareConfig | SoftCompareConfig) -> shadow.AbstractCompare:
    if isinstance(config, SoftCompareConfig):
        return shadow.SoftCompare(width=config.width, kernel=config.kernel)
    return shadow.HardCompare(operator=config.operator)


def _filter(config: Config, fitting: bool) -> shadow.AbstractFilter:
    match config.filter:
        case NearestConfig():
            return shadow.Nearest()
        case BilinearConfig():
            return shadow.Bilinear()
        case FourTapConfig(radius=radius):
            return shadow.FourTap(radius=radius)
        case PercentageCloserConfig(radius=radius):
            bounds = config.fit.parameters.get("filter.radius") if fitting else None
            return shadow.PercentageCloser(radius=radius, max_radius=max(radius, bounds.upper) if bounds else None)
        case RandomDiskConfig() as disk:
            return shadow.RandomDisk(
                radius=disk.radius,
                samples=disk.grid,
                pattern_size=disk.pattern_size,
                lookup=disk.lookup,
                early_out=disk.early_out,
                seed=config.seed,
            )
