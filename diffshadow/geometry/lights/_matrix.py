"""A light given by its matrices."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import Mat4, Vec3
from .._camera import check_near_far
from .._matrices import eye_of, matrices_of, near_far_of, view_of
from .._view import View
from ._abstract import AbstractLight, Domain


class MatrixLight(AbstractLight):
    """Light without a size, given by the matrices that its shadow map is drawn with, such as another program's.

    - `world_to_eye`: (4, 4), rigid; the eye looks along `-z`. It acts on column vectors.
    - `eye_to_clip`: (4, 4), as `perspective` and `orthographic` make it, also off the centre. Depth in clip space goes
        from -1 to 1, as OpenGL's does.
    - `is_perspective`: of a perspective projection, the light stands at the eye; of a parallel one, it is directional
        and shines along `-z` of eye space. By default `eye_to_clip` says which; under a trace it must be given.

    Its pose cannot be fitted.

    **Raises** `ValueError` for matrices that are not finite or not (4, 4), a view that is not rigid, a projection of
    another form, or one whose near and far are not near < far, or, of a perspective, 0 < near < far.
    """

    world_to_eye: Mat4
    eye_to_clip: Mat4
    is_perspective: bool = eqx.field(static=True)

    def __init__(self, world_to_eye: Any, eye_to_clip: Any, is_perspective: bool | None = None):
        matrices = matrices_of("the matrix light", world_to_eye, eye_to_clip, is_perspective)
        self.world_to_eye, self.eye_to_clip, self.is_perspective = matrices

    def __check_init__(self):
        near, far = near_far_of(self.eye_to_clip, self.is_perspective)
        check_near_far("the matrix light", near, far, positive=self.is_perspective)

    @property
    def position(self) -> Vec3:
        """The eye's place (3,), world units; where the light stands, unless it is directional."""
        return eye_of(self.world_to_eye)

    def view(self) -> View:
        return view_of(self.world_to_eye, self.eye_to_clip, self.is_perspective)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        if self.is_perspective:
            return self.position - points
        return jnp.broadcast_to(self.world_to_eye[2, :3], points.shape)

    def layer(self, points: Float[Array, "*n 3"]) -> None:
        return None

    @property
    def domain(self) -> Domain:
        return "disk"

    @property
    def is_directional(self) -> bool:
        return not self.is_perspective

    @property
    def has_size(self) -> bool:
        return False
