"""A light given by its matrices."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._types import Mat4, Vec3
from .._camera import check_near_far
from .._matrices import as_opengl, eye_of, matrices_of, near_far_of, view_of
from .._view import View
from ._abstract import AbstractLight, Domain


class MatrixLight(AbstractLight):
    """Light without a size, given by the matrices of its shadow map, for example from another program.

    - `world_to_eye`: (4, 4), rigid; the eye looks along `-z`. It acts on column vectors.
    - `eye_to_clip`: (4, 4), a projection of the form of `perspective` or `orthographic`, possibly off-centre. Depth
        in clip space is from -1 to 1, as in OpenGL.
    - `is_perspective`: with a perspective projection, the light is at the eye; with a parallel one, it is directional
        and shines along `-z` of eye space. By default it is read from `eye_to_clip`. Required under `jit`.

    Its pose cannot be fitted.

    **Raises** `ValueError` for matrices that are not finite or not (4, 4), a view that is not rigid, a projection of
    another form, or unless near < far (0 < near < far for a perspective projection).
    """

    world_to_eye: Mat4
    eye_to_clip: Mat4
    is_perspective: bool = eqx.field(static=True)

    def __init__(self, world_to_eye: Any, eye_to_clip: Any, is_perspective: bool | None = None):
        matrices = matrices_of("the matrix light", world_to_eye, eye_to_clip, is_perspective)
        self.world_to_eye, self.eye_to_clip, self.is_perspective = matrices

    @classmethod
    def from_engine(
        cls,
        world_to_eye: Any,
        eye_to_clip: Any,
        *,
        left_handed: bool = False,
        depth: tuple[float, float] = (-1.0, 1.0),
    ) -> "MatrixLight":
        """The light of an engine's matrices, with conventions other than OpenGL's.

        **Arguments:**

        - `world_to_eye`, `eye_to_clip`: (4, 4), for column vectors: transpose matrices for row vectors.
        - `left_handed`: whether the eye looks along `+z`, as in Babylon.js and Direct3D. Such an eye sees the mirror
            image of this light's view, so the columns of the engine's map run in the opposite direction.
        - `depth`: clip depth over w at near and far: (-1, 1) for OpenGL, (0, 1) for Direct3D, Metal and WebGPU, (1, 0)
            for reversed depth.

        **Raises** `ValueError` for matrices that are not (4, 4), for equal depths, and for the errors of `MatrixLight`.
        """
        return cls(*as_opengl(world_to_eye, eye_to_clip, left_handed, depth))

    def _check_rules(self):
        near, far = near_far_of(self.eye_to_clip, self.is_perspective)
        check_near_far("the matrix light", near, far, positive=self.is_perspective)

    @property
    def position(self) -> Vec3:
        """The eye's position (3,), world units; the light's position, unless it is directional."""
        return eye_of(self.world_to_eye)

    def view(self) -> View:
        return view_of(self.world_to_eye, self.eye_to_clip, self.is_perspective)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        if self.is_perspective:
            return self.position - points
        return jnp.broadcast_to(self.world_to_eye[2, :3], points.shape)

    @property
    def domain(self) -> Domain:
        return "disk"

    @property
    def is_directional(self) -> bool:
        return not self.is_perspective

    @property
    def has_size(self) -> bool:
        return False
