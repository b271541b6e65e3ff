"""Cameras: the view that an image is drawn from."""

# A matrix camera computes properties that other cameras have as fields.
# pyright: reportIncompatibleVariableOverride=false

import abc
import dataclasses
import math
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._arithmetic import array_module, as_float, as_number, concrete, safe_norm
from .._checks import CheckedModule, as_tuple, check_value, listed
from .._types import AsScalar, AsVec3, Mat3, Mat4, Resolution, Scalar, Vec3
from ..settings import scene
from ..settings.quantities import Position
from ..settings.scene import Camera
from ._camera_pose import CameraPose
from ._matrices import eye_of, matrices_of, near_far_of, view_of
from ._transforms import centred_orthographic, centred_perspective, look_at
from ._vector import Vector
from ._view import View


class AbstractCamera(CheckedModule):
    """A view of the scene and the image it is drawn to.

    - `eye`, `target`: world positions; the camera looks from `eye` to `target`.
    - `up`: a direction that points up in the image.
    - `near`, `far`: the range of visible distances along the view axis, in world units.
    - `resolution`: (height, width) in pixels.
    """

    settings: ClassVar = Camera

    eye: eqx.AbstractVar[Vec3]
    target: eqx.AbstractVar[Vec3]
    up: eqx.AbstractVar[Vec3]
    near: eqx.AbstractVar[Scalar]
    far: eqx.AbstractVar[Scalar]
    resolution: eqx.AbstractVar[Resolution]

    @abc.abstractmethod
    def projection(self) -> Mat4:
        """Clip space from eye space, (4, 4)."""

    def view(self) -> View:
        """The camera's view."""
        return View(
            world_to_eye=look_at(self.eye, self.target - self.eye, self.up),
            eye_to_clip=self.projection(),
            near=self.near,
            far=self.far,
            is_perspective=isinstance(self, PinholeCamera),
        )

    def pose(self) -> CameraPose:
        """The camera's pose."""
        return CameraPose(Vector(*self.eye), Vector())

    @abc.abstractmethod
    def at(self, pose: CameraPose) -> "AbstractCamera":
        """The same camera in another `pose`, whose `turn` is relative to this camera."""

    def _turned(self, pose: CameraPose) -> tuple[Vec3, Vec3, Vec3]:
        """Eye, target and up in a `pose`."""
        eye = pose.eye.array
        _, up, backward = pose.axes(self._axes)
        return eye, eye - safe_norm(self.target - self.eye) * backward, up

    @property
    def _axes(self) -> Mat3:
        return self.view().world_to_eye[:3, :3]

    @property
    def aspect(self) -> float:
        """Width of the image over its height."""
        height, width = self.resolution
        return width / height

    def _check_rules(self):
        check_pose("the camera", self.eye, self.target)
        check_near_far("the camera", self.near, self.far, positive=isinstance(self, PinholeCamera))


class PinholeCamera(AbstractCamera):
    """A perspective camera; `fov_y` is its full vertical field of view in degrees.

    !!! Example

        ```python
        wide = geometry.PinholeCamera((0, 1, 4), (0, 0, 0), fov_y=40, near=0.1, far=10, resolution=(32, 64))
        wide.aspect  # 2.0
        ```
    """

    settings: ClassVar = scene.PinholeCamera

    eye: AsVec3 = eqx.field(converter=as_number)
    target: AsVec3 = eqx.field(converter=as_number)
    up: AsVec3 = eqx.field(converter=as_number, default=Camera.up)
    fov_y: AsScalar = eqx.field(converter=as_number, default=scene.PinholeCamera.fov_y)
    near: AsScalar = eqx.field(converter=as_number, default=0.1)
    far: AsScalar = eqx.field(converter=as_number, default=100.0)
    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=Camera.resolution)

    def projection(self) -> Mat4:
        return centred_perspective(self.fov_y, self.near, self.far, as_float(self.aspect))

    def pose(self) -> CameraPose:
        return dataclasses.replace(super().pose(), fov_y=self.fov_y)

    def at(self, pose: CameraPose) -> "PinholeCamera":
        parts = lambda one: (one.eye, one.target, one.up, one.fov_y)
        return eqx.tree_at(parts, self, (*self._turned(pose), pose.fov_y))


class OrthographicCamera(AbstractCamera):
    """A parallel camera; `height` is the height of its view, in world units."""

    eye: AsVec3 = eqx.field(converter=as_number)
    target: AsVec3 = eqx.field(converter=as_number)
    up: AsVec3 = eqx.field(converter=as_number, default=Camera.up)
    height: AsScalar = eqx.field(converter=as_number, default=2.0)
    near: AsScalar = eqx.field(converter=as_number, default=0.1)
    far: AsScalar = eqx.field(converter=as_number, default=100.0)
    resolution: Resolution = eqx.field(static=True, converter=as_tuple, default=Camera.resolution)

    def projection(self) -> Mat4:
        return centred_orthographic(self.height * as_float([self.aspect, 1.0]), self.near, self.far)

    def pose(self) -> CameraPose:
        return dataclasses.replace(super().pose(), height=self.height)

    def at(self, pose: CameraPose) -> "OrthographicCamera":
        parts = lambda one: (one.eye, one.target, one.up, one.height)
        return eqx.tree_at(parts, self, (*self._turned(pose), pose.height))

    def _check_rules(self):
        super()._check_rules()
        height = concrete(self.height)
        if height is not None and not 0 < height < math.inf:
            raise ValueError(f"the camera's height is {height}; expected a positive size in world units")


class MatrixCamera(AbstractCamera):
    """A camera given by its matrices, for example from another program.

    - `world_to_eye`: (4, 4), rigid; the eye looks along `-z`. It acts on column vectors.
    - `eye_to_clip`: (4, 4), a projection of the form of `perspective` or `orthographic`, possibly off-centre. Depth
        in clip space is from -1 to 1, as in OpenGL.
    - `resolution`: (height, width) in pixels.
    - `is_perspective`: whether sizes shrink with distance. By default it is read from `eye_to_clip`. Required under
      `jit`.

    Near and far come from the projection, and `target` is a point on the view axis.

    **Raises** `ValueError` for matrices that are not finite or not (4, 4), a view that is not rigid, a projection of
    another form, or unless near < far (0 < near < far for a perspective projection).
    """

    world_to_eye: Mat4
    eye_to_clip: Mat4
    resolution: Resolution = eqx.field(static=True)
    is_perspective: bool = eqx.field(static=True)

    def __init__(
        self,
        world_to_eye: Any,
        eye_to_clip: Any,
        resolution: Resolution = Camera.resolution,
        is_perspective: bool | None = None,
    ):
        matrices = matrices_of("the matrix camera", world_to_eye, eye_to_clip, is_perspective)
        self.world_to_eye, self.eye_to_clip, self.is_perspective = matrices
        self.resolution = as_tuple(resolution)

    def _check_rules(self):
        check_near_far("the matrix camera", self.near, self.far, positive=self.is_perspective)

    @property
    def eye(self) -> Vec3:
        """The eye's position, (3,), world units."""
        return eye_of(self.world_to_eye)

    @property
    def target(self) -> Vec3:
        """A point on the view axis, (3,), at the larger of the near and far distances."""
        return self.eye - jnp.maximum(jnp.abs(self.near), jnp.abs(self.far)) * self.world_to_eye[2, :3]

    @property
    def up(self) -> Vec3:
        """The unit direction, (3,), that points up in the image."""
        return self.world_to_eye[1, :3]

    @property
    def near(self) -> Scalar:
        """Distance of window depth 0 along the view axis, world units."""
        return near_far_of(self.eye_to_clip, self.is_perspective)[0]

    @property
    def far(self) -> Scalar:
        """Distance of window depth 1 along the view axis, world units."""
        return near_far_of(self.eye_to_clip, self.is_perspective)[1]

    def projection(self) -> Mat4:
        return self.eye_to_clip

    def at(self, pose: CameraPose) -> "MatrixCamera":
        eye, axes = pose.eye.array, pose.axes(self._axes)
        moved = self.world_to_eye.at[:3].set(jnp.column_stack([axes, -jnp.matmul(axes, eye, precision="highest")]))
        return eqx.tree_at(lambda one: one.world_to_eye, self, moved)

    def view(self) -> View:
        return view_of(self.world_to_eye, self.eye_to_clip, self.is_perspective)


def orbit_eye(target: Vec3, distance: Scalar | float, azimuth: float, elevation: float) -> Vec3:
    """The point at `distance` world units from `target`; `azimuth` and `elevation` are in degrees.

    Azimuth 0 is on `+z` of the target, and 90 on `+x`. Elevation 90 is straight above (`+y`).
    """
    a, e = math.radians(azimuth), math.radians(elevation)
    towards = [math.cos(e) * math.sin(a), math.sin(e), math.cos(e) * math.cos(a)]
    xp, dtype = array_module(target, distance), jnp.result_type(float)
    target, distance, towards = (xp.asarray(each, dtype) for each in (target, distance, towards))
    return as_float(target + distance * towards)


def check_pose(name: str, eye: Vec3, target: Vec3) -> None:
    """**Raises** `ValueError` if `eye` and `target` do not define a view direction."""
    check_value(f"{name}'s eye", eye, Position)
    check_value(f"{name}'s target", target, Position)
    e, t = concrete(eye), concrete(target)
    if e is None or t is None:
        return
    if np.array_equal(e, t):
        raise ValueError(f"{name}'s eye and target are both {listed(e)}; expected two different points")


def check_near_far(name: str, near: Scalar, far: Scalar, *, positive: bool) -> None:
    """**Raises** `ValueError` unless near < far and, if `positive`, near > 0."""
    n, f = concrete(near), concrete(far)
    if n is None or f is None:
        return
    if not (n < f and np.isfinite(n) and np.isfinite(f) and (n > 0 or not positive)):
        expected = "0 < near < far" if positive else "near < far"
        raise ValueError(f"{name} has near = {n} and far = {f}; expected {expected}, both finite, in world units")
