"""Light cameras that an engine chooses: fits to a camera's view, and matrices with the engines' rounding."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..._arithmetic import as_float
from ..._types import HostArray, Resolution, Scalar
from ...geometry import AbstractCamera, AbstractLight, View
from ._textures import rounded


class CameraOfLight(NamedTuple):
    """One camera of a light, in float64 on the host.

    - `world_to_eye`, `eye_to_clip`: (4, 4), by OpenGL's conventions, for column vectors.
    - `near`, `far`: distances along its axis where window depth is 0 and 1, world units.
    - `to_clip`: (4, 4), from world space to clip space as the engine computes it. If the engine has reversed depth,
      depth over w is from 1 at near to 0 at far.
    - `to_window`: (4, 4), from world space to the map as the engine computes it: x and y over w are from 0 to 1 over
        the whole texture, z over w is depth from 0 to 1.
    """

    world_to_eye: HostArray
    eye_to_clip: HostArray
    near: float
    far: float
    to_clip: HostArray
    to_window: HostArray


class EngineCameras(AbstractLight):
    """A light with the engine's cameras: one, or one for each cascade.

    - `world_to_eye`, `eye_to_clip`, `near`, `far`, `to_clip`, `to_window`: one for each of the k cameras, see
        `CameraOfLight`.
    - `camera`: the view of the camera that they are fitted to; `None` if they are not fitted.
    - `ends`: (k,), the depth along the camera's axis up to which each cascade is looked up, in world units. There are
      no shadows beyond the last depth. `None` for a light without such ends.
    - `is_perspective`: whether it is a spot light instead of a directional light.
    - `inner_cosine`: cosine of the angle within which a spot light has its full strength; `None` if this is its window.
    """

    world_to_eye: Float[Array, "k 4 4"] = eqx.field(converter=as_float)
    eye_to_clip: Float[Array, "k 4 4"] = eqx.field(converter=as_float)
    near: Float[Array, " k"] = eqx.field(converter=as_float)
    far: Float[Array, " k"] = eqx.field(converter=as_float)
    to_clip: Float[Array, "k 4 4"] = eqx.field(converter=as_float)
    to_window: Float[Array, "k 4 4"] = eqx.field(converter=as_float)
    camera: View | None = None
    ends: Float[Array, " k"] | None = None
    is_perspective: bool = eqx.field(static=True, default=False)
    inner_cosine: Scalar | None = None

    @classmethod
    def of(
        cls,
        cameras: Sequence[CameraOfLight],
        is_perspective: bool,
        camera: AbstractCamera | None = None,
        ends: Any = None,
    ) -> "EngineCameras":
        view = None if camera is None else camera.view()
        of = lambda name: np.stack([getattr(each, name) for each in cameras])
        return cls(
            *(of(name) for name in CameraOfLight._fields),
            camera=view,
            ends=None if ends is None else as_float(ends),
            is_perspective=is_perspective,
        )

    @property
    def count(self) -> int:
        """The number of cameras."""
        return self.near.shape[0]

    @property
    def position(self) -> Float[Array, "3"]:
        """A spot light's position, world units."""
        turn = self.world_to_eye[0, :3]
        return -jnp.sum(turn[:, :3] * turn[:, 3:], axis=0)

    def view(self) -> View:
        if self.count == 1:
            return self.first
        return View(self.world_to_eye, self.eye_to_clip, self.near, self.far, self.is_perspective)

    @property
    def first(self) -> View:
        """The view of the first camera."""
        return View(self.world_to_eye[0], self.eye_to_clip[0], self.near[0], self.far[0], self.is_perspective)

    def layer(self, points: Float[Array, "*n 3"]) -> Int[Array, "*n"] | None:
        if self.count == 1:
            return None
        assert self.ends is not None
        depth = lax.stop_gradient(self.depth(points))[..., None]
        beyond = jnp.sum(depth >= self.ends, axis=-1, dtype=jnp.int32)
        return jnp.minimum(beyond, self.count - 1)

    def depth(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """The depth of `points` along the axis of the camera that the cameras are fitted to, in world units."""
        assert self.camera is not None
        return self.camera.distance(points)

    def is_shadowed(self, points: Float[Array, "*n 3"]) -> Any:
        """Whether `points` are within the depths that have shadows, (...,); True if there is no end."""
        return True if self.ends is None else self.depth(points) <= self.ends[-1]

    def window(self, points: Float[Array, "*n 3"], layer: Int[Array, "*n"] | int | None) -> Float[Array, "*n 4"]:
        """`points` in the map's texture. The product with the matrix equals a shader's product to the bit."""
        return in_order(self.to_window[0 if layer is None else layer], points)

    def clip(self, points: Float[Array, "n 3"], camera: int | None = None) -> Float[Array, "*k n 4"]:
        """Clip coordinates of `points` in one `camera` (without the axis k) or in each, also to the bit."""
        if self.count == 1 or camera is not None:
            return in_order(self.to_clip[camera or 0], points)
        return in_order(self.to_clip[:, None], points)

    def towards(self, points: Float[Array, "*n 3"], sample: Float[Array, "*n 2"] | None = None) -> Float[Array, "*n 3"]:
        if self.is_perspective:
            return self.position - points
        return jnp.broadcast_to(self.world_to_eye[0, 2, :3], points.shape)

    @property
    def is_directional(self) -> bool:
        return not self.is_perspective

    @property
    def has_size(self) -> bool:
        return False


def in_order(matrix: Float[Array, "*m 4 4"], points: Float[Array, "*n 3"]) -> Float[Array, "*k 4"]:
    """`matrix` times [p, 1], with the rounding of software rasterizers: by columns, with each product rounded."""
    columns = [rounded(matrix[..., k] * points[..., k : k + 1]) for k in range(3)]
    return ((columns[0] + columns[1]) + columns[2]) + matrix[..., 3]


# --- Fits to a camera's view ---


def frustum_corners(camera: AbstractCamera, near: float, far: float) -> Float[HostArray, "8 3"]:
    """The corners of the part of the view of `camera` between two depths, in world space; the near end first.

    Each end starts at its lower right corner and goes anticlockwise.
    """
    view = camera.view()
    clip = np.asarray(view.eye_to_clip, np.float64)
    sides = np.array([(1, -1), (1, 1), (-1, 1), (-1, -1)], np.float64)
    corners = []
    for depth in (near, far):
        by = depth if view.is_perspective else 1.0
        across = [(sides[:, k] * by + (clip[k, 2] * depth if view.is_perspective else -clip[k, 3])) for k in (0, 1)]
        corners.append(np.stack([across[0] / clip[0, 0], across[1] / clip[1, 1], np.full(4, -depth)], axis=-1))
    world = np.linalg.inv(np.asarray(view.world_to_eye, np.float64))
    return np.concatenate(corners) @ world[:3, :3].T + world[:3, 3]


def sphere_from_mean(corners: Float[HostArray, "n 3"]) -> tuple[Float[HostArray, "3"], float]:
    """The mean of `corners`, and the distance from it to the farthest of them."""
    centre = corners.mean(axis=0)
    return centre, float(np.linalg.norm(corners - centre, axis=1).max())


def split_depths(near: float, far: float, count: int, logarithmic: float) -> list[float]:
    """The end of each of `count` cascades: a mix of equal parts and equal ratios of depth, where `logarithmic` is the
    share of equal ratios."""
    parts = [i / count for i in range(1, count)]
    mixed = [
        (1 - logarithmic) * (near + (far - near) * part) + logarithmic * near * (far / near) ** part for part in parts
    ]
    return [*mixed, far]


def inverse_pose(axes: Float[HostArray, "3 3"], eye: Any) -> Float[HostArray, "4 4"]:
    """World space to the space of an eye with the right, up and backward directions `axes`: the inverse of its pose,
    with both stored in single precision."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.transpose(axes), np.asarray(eye, np.float64)
    return np.linalg.inv(pose.astype(np.float32).astype(np.float64)).astype(np.float32)


def parallel_projection(half: float, near: float, far: float) -> Float[HostArray, "4 4"]:
    """OpenGL's parallel projection of a square window, `half` its width."""
    matrix = np.diag([1 / half, 1 / half, -2 / (far - near), 1.0])
    matrix[2, 3] = -(far + near) / (far - near)
    return matrix


def cone_projection(tangent: float, near: float, far: float) -> Float[HostArray, "4 4"]:
    """OpenGL's perspective of a square window whose half width is `tangent` at the distance 1; far may be infinite."""
    share = 0.0 if np.isinf(far) else near / far
    matrix = np.diag([1 / tangent, 1 / tangent, -(1 + share) / (1 - share), 0.0])
    matrix[2, 3], matrix[3, 2] = -2 * near / (1 - share), -1
    return matrix


def reversed_depth(projection: Float[HostArray, "4 4"]) -> Float[HostArray, "4 4"]:
    """OpenGL's `projection` with clip depth over w from 1 at near to 0 at far."""
    matrix = np.array(projection, np.float64)
    matrix[2] = (matrix[3] - matrix[2]) / 2
    return matrix


def viewport(x: float, y: float, size: float) -> Float[HostArray, "4 4"]:
    """From clip space to a square part of a texture, whose corner is at (x, y), and to depths from 0 to 1."""
    matrix = np.diag([size / 2, size / 2, 0.5, 1.0])
    matrix[:3, 3] = x + size / 2, y + size / 2, 0.5
    return matrix


def in_single(*matrices: HostArray) -> Float[HostArray, "4 4"]:
    """The product of `matrices`, taken from the right. Each matrix and each product is rounded to single precision."""
    product = np.asarray(matrices[-1], np.float32)
    for matrix in matrices[-2::-1]:
        product = (np.asarray(matrix, np.float32).astype(np.float64) @ product.astype(np.float64)).astype(np.float32)
    return product


# --- Cascades in one texture ---

Places = tuple[tuple[float, float], ...]
"""The corners x and y of the cascades' squares in a texture that they share, whose sides are 1."""

QUARTERS: Places = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5))
"""Of PlayCanvas."""


def quarter_of(resolution: Resolution, count: int) -> Resolution:
    """(height, width) in texels of each of `count` maps in a texture of this `resolution`. A single map fills the whole
    texture."""
    height, width = resolution
    return resolution if count == 1 else (height // 2, width // 2)


def in_quarters(layers: Float[Array, "*k h w"], places: Places, empty: float) -> Float[Array, "H W"]:
    """One texture of up to four `layers`, at `places`. Its other texels are `empty`. A single map fills the whole
    texture."""
    if layers.ndim == 2:
        return layers
    _, height, width = layers.shape
    texture = jnp.full((2 * height, 2 * width), empty, layers.dtype)
    for layer, (x, y) in zip(layers, places, strict=False):
        texture = lax.dynamic_update_slice(texture, layer, (int(2 * y) * height, int(2 * x) * width))
    return texture


def of_quarters(texture: Float[Array, "H W"], count: int, places: Places) -> Float[Array, "*k h w"]:
    """The layers of a texture from `in_quarters`."""
    if count == 1:
        return texture
    height, width = (side // 2 for side in texture.shape)
    at = [(int(2 * y) * height, int(2 * x) * width) for x, y in places[:count]]
    return jnp.stack([texture[row : row + height, column : column + width] for row, column in at])
