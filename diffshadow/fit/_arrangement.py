"""What a fit of poses may move: a technique's numbers, the lights, and the meshes."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._misc import as_float, normalize, safe_norm
from .._types import Scalar, Vec3
from ..geometry import AbstractLight, DirectionalLight, Mesh, PointLight, SpotLight
from ..shadow import ShadowMapping


class Vector(eqx.Module):
    """Three numbers, each of which can be fitted by itself."""

    x: Scalar = eqx.field(converter=as_float, default=0.0)
    y: Scalar = eqx.field(converter=as_float, default=0.0)
    z: Scalar = eqx.field(converter=as_float, default=0.0)

    @property
    def array(self) -> Vec3:
        """All three, (3,)."""
        return jnp.stack([self.x, self.y, self.z])


class LightPose(eqx.Module):
    """Where a light stands, which way it shines, and how large it is; what a kind of light lacks is none.

    - `position`: of a spot or a point light, world units.
    - `azimuth`, `elevation`: where the light of a directional or a spot light comes from, along its axis, in degrees:
        azimuth 0 is +z and 90 is +x, elevation 90 is straight above. Elevation may go on beyond 90, over the pole.
    - `radius`: a directional light's `angular_radius` in degrees, any other's `radius` in world units.
    """

    position: Vector | None
    azimuth: Scalar | None
    elevation: Scalar | None
    radius: Scalar | None

    @classmethod
    def of(cls, light: AbstractLight) -> "LightPose":
        """The pose of `light` as it stands; a light of another kind has nothing that could be fitted."""
        match light:
            case DirectionalLight():
                return cls(None, *_angles(light.direction), light.angular_radius)
            case SpotLight():
                return cls(Vector(*light.position), *_angles(light.direction), light.radius)
            case PointLight():
                return cls(Vector(*light.position), None, None, light.radius)
        return cls(None, None, None, None)

    def placed(self, light: AbstractLight, points: Float[Array, "n 3"]) -> AbstractLight:
        """`light` in this pose, the frustum of its map fitted to `points` (n, 3)."""
        match light:
            case DirectionalLight():
                moved = eqx.tree_at(lambda one: (one.direction, one.angular_radius), light, (self._way, self.radius))
            case SpotLight():
                parts = lambda one: (one.position, one.direction, one.radius)
                moved = eqx.tree_at(parts, light, (self._place, self._way, self.radius))
            case PointLight():
                moved = eqx.tree_at(lambda one: (one.position, one.radius), light, (self._place, self.radius))
            case _:
                return light
        return moved.refitted(points)

    @property
    def _place(self) -> Vec3:
        assert self.position is not None
        return self.position.array

    @property
    def _way(self) -> Vec3:
        assert self.azimuth is not None
        assert self.elevation is not None
        a, e = jnp.deg2rad(self.azimuth), jnp.deg2rad(self.elevation)
        return -jnp.stack([jnp.cos(e) * jnp.sin(a), jnp.sin(e), jnp.cos(e) * jnp.cos(a)])


def _angles(direction: Vec3) -> tuple[Scalar, Scalar]:
    x, y, z = -normalize(direction)
    # By the tangent, which keeps its digits near the pole.
    return jnp.rad2deg(jnp.arctan2(x, z)), jnp.rad2deg(jnp.arctan2(y, jnp.hypot(x, z)))


class MeshPose(eqx.Module):
    """Where a mesh stands, as against where it was drawn up.

    - `translate`: its shift, world units.
    - `turn`: a rotation vector about the middle of its bounding box, in degrees: its direction is the axis, its length
        the angle.
    - `vertices`: places of single vertices before shift and turn, world units, by their index as text. Vertices that
        lay in the same place move together.
    - `home`: (3,), the value of `translate` at which the mesh stands where it was drawn up.
    """

    translate: Vector
    turn: Vector
    vertices: dict[str, Vector]
    home: Vec3 = eqx.field(converter=as_float)
    together: dict[str, tuple[int, ...]] = eqx.field(static=True, default_factory=dict)

    @classmethod
    def of(cls, mesh: Mesh, vertices: Sequence[int] = (), home: Sequence[float] = (0.0, 0.0, 0.0)) -> "MeshPose":
        """The pose of `mesh` as it stands.

        **Arguments:**

        - `vertices`: indices of those that are to be moved one by one.
        - `home`: what its `translate` is called now.

        **Raises** `ValueError` for a vertex that the mesh does not have.
        """
        points = np.asarray(mesh.vertices)
        for index in vertices:
            if not 0 <= index < len(points):
                raise ValueError(f"the mesh has no vertex {index}; expected an index from 0 to {len(points) - 1}")
        same = lambda index: tuple(map(int, np.flatnonzero((points == points[index]).all(axis=-1))))
        return cls(
            translate=Vector(*home),
            turn=Vector(),
            vertices={str(index): Vector(*points[index]) for index in vertices},
            home=home,
            together={str(index): same(index) for index in vertices},
        )

    def placed(self, mesh: Mesh) -> Mesh:
        """`mesh` in this pose."""
        vertices = mesh.vertices
        for index, vertex in self.vertices.items():
            vertices = vertices.at[np.asarray(self.together[index])].set(vertex.array)
        middle = mesh.bounds.mean(axis=0)
        bend = _rotation_less_one(jnp.deg2rad(self.turn.array))
        # Added to what is there, so that a mesh at rest keeps its vertices to the last digit.
        turned = vertices + jnp.matmul(vertices - middle, bend.T, precision="highest")
        normals = mesh.corner_normals + jnp.matmul(mesh.corner_normals, bend.T, precision="highest")
        moved = (turned + (self.translate.array - self.home), normals)
        return eqx.tree_at(lambda one: (one.vertices, one.corner_normals), mesh, moved)


def _rotation_less_one(vector: Vec3) -> Float[Array, "3 3"]:
    """The turn about `vector` by its length in radians (Rodrigues' formula) less the identity, smooth at 0 too."""
    x, y, z = vector
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack(row) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])])
    angle = safe_norm(vector)
    # R - I = sin(a) / a K + (1 - cos(a)) / a² K², with K the cross product with the vector itself.
    first, second = jnp.sinc(angle / jnp.pi), jnp.sinc(angle / (2 * jnp.pi)) ** 2 / 2
    return first * cross + second * jnp.matmul(cross, cross, precision="highest")


class Arrangement(eqx.Module):
    """All that a fit of poses may change: paths such as `lights.0.azimuth` lead to its numbers.

    - `technique`: the shadow mapping.
    - `lights`: the pose of each light.
    - `meshes`: the pose of each mesh.
    """

    technique: ShadowMapping
    lights: tuple[LightPose, ...]
    meshes: tuple[MeshPose, ...]

    @classmethod
    def of(
        cls, technique: ShadowMapping, lights: Sequence[AbstractLight], meshes: Sequence[Mesh | MeshPose]
    ) -> "Arrangement":
        """Everything as it stands."""
        poses = (mesh if isinstance(mesh, MeshPose) else MeshPose.of(mesh) for mesh in meshes)
        return cls(technique, tuple(map(LightPose.of, lights)), tuple(poses))


def is_of_technique(path: str) -> bool:
    """Whether the number that `path` leads to is the technique's."""
    return path.startswith("technique.")
