"""The objects that a fit of poses may change: a technique's numbers, lights and meshes. Fits to pictures add the camera
and colours."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._arithmetic import as_float
from .._types import Scalar, Vec3
from ..geometry import AbstractLight, CameraPose, LightPose, Mesh, Scene, Smoothing, Vector, rotation_less_one
from ..shading import AbstractShading, Colour
from ..shadow import ShadowMapping


class MeshPose(eqx.Module):
    """A mesh's position and rotation relative to its own coordinates.

    - `translate`: its translation, in world units.
    - `turn`: a rotation vector about the centre of its bounding box, in degrees. Its direction is the axis, and its
      length is the angle.
    - `vertices`: positions of single vertices before translation and rotation, in world units, by their index as text.
      Vertices at the same position move together, and shading normals follow them.
    - `home`: (3,), the value of `translate` at which the mesh is not translated.
    - `smoothing`: the faces over which shading normals are smooth at these vertices; `None` without such vertices.
    - `albedo`: the colour of all its faces; `None` to keep its colours.
    """

    translate: Vector
    turn: Vector
    vertices: dict[str, Vector]
    home: Vec3 = eqx.field(converter=as_float)
    together: dict[str, tuple[int, ...]] = eqx.field(static=True, default_factory=dict)
    smoothing: Smoothing | None = None
    albedo: Colour | None = None

    @classmethod
    def of(
        cls,
        mesh: Mesh,
        vertices: Sequence[int] = (),
        home: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        coloured: bool = False,
    ) -> "MeshPose":
        """The current pose of `mesh`.

        **Arguments:**

        - `vertices`: indices of the vertices that can be moved individually.
        - `home`: the value of `translate` for the mesh at its current position.
        - `coloured`: whether its colour can be fitted, in a fit to a picture. A mesh with several colours keeps them.

        **Raises** `ValueError` for a vertex that the mesh does not have.
        """
        points, albedo = np.asarray(mesh.vertices), np.asarray(mesh.albedo)
        for index in vertices:
            if not 0 <= index < len(points):
                raise ValueError(f"the mesh has no vertex {index}; expected an index from 0 to {len(points) - 1}")
        same = lambda index: tuple(map(int, np.flatnonzero((points == points[index]).all(axis=-1))))
        together = {str(index): same(index) for index in vertices}
        return cls(
            translate=Vector(*home),
            turn=Vector(),
            vertices={str(index): Vector(*points[index]) for index in vertices},
            home=home,
            together=together,
            smoothing=Smoothing.of(mesh, {one for each in together.values() for one in each}) if together else None,
            albedo=Colour(*albedo[0]) if coloured and (albedo == albedo[0]).all() else None,
        )

    @eqx.filter_jit
    def placed(self, mesh: Mesh) -> Mesh:
        """`mesh` in this pose."""
        vertices = mesh.vertices
        for index, vertex in self.vertices.items():
            vertices = vertices.at[np.asarray(self.together[index])].set(vertex.array)
        normals = mesh.corner_normals if self.smoothing is None else self.smoothing.corner_normals(mesh, vertices)
        middle = mesh.bounds.mean(axis=0)
        bend = rotation_less_one(jnp.deg2rad(self.turn.array))
        # Offsets are added, so that a mesh at rest keeps its vertices to the last digit.
        turned = vertices + jnp.matmul(vertices - middle, bend.T, precision="highest")
        normals = normals + jnp.matmul(normals, bend.T, precision="highest")
        moved = (turned + (self.translate.array - self.home), normals)
        placed = eqx.tree_at(lambda one: (one.vertices, one.corner_normals), mesh, moved)
        if self.albedo is None:
            return placed
        return eqx.tree_at(lambda one: one.albedo, placed, jnp.broadcast_to(self.albedo.array, mesh.albedo.shape))


class Arrangement(eqx.Module):
    """Everything that a fit of poses may change. Paths such as `lights.0.azimuth` lead to its numbers.

    - `technique`: the shadow mapping.
    - `lights`: the pose of each light.
    - `meshes`: the pose of each mesh.
    - `camera`, `shading`, `exposure`: for a fit to a picture, the camera's pose, the shading, and the brightening of
      the picture in stops; `None` in other fits.
    """

    technique: ShadowMapping
    lights: tuple[LightPose, ...]
    meshes: tuple[MeshPose, ...]
    camera: CameraPose | None = None
    shading: AbstractShading | None = None
    exposure: Scalar | None = None

    @classmethod
    def of(
        cls, technique: ShadowMapping, lights: Sequence[AbstractLight], meshes: Sequence[Mesh | MeshPose]
    ) -> "Arrangement":
        """Everything with its current values."""
        poses = (mesh if isinstance(mesh, MeshPose) else MeshPose.of(mesh) for mesh in meshes)
        return cls(technique, tuple(light.pose() for light in lights), tuple(poses))

    @classmethod
    def of_picture(
        cls,
        technique: ShadowMapping,
        scene: Scene,
        shading: AbstractShading,
        exposure: float,
    ) -> "Arrangement":
        """Everything that a picture of `scene` depends on, with the scene's values. Meshes with a single colour have an
        `albedo`."""
        meshes = [MeshPose.of(mesh, coloured=True) for mesh in scene.meshes]
        return cls.of(technique, scene.lights, meshes).pictured(scene, shading, exposure)

    def pictured(self, scene: Scene, shading: AbstractShading, exposure: float) -> "Arrangement":
        """This arrangement, with the additional values of pictures of `scene`: the camera's pose, the `shading`, and
        the `exposure` in stops."""
        return dataclasses.replace(self, camera=scene.camera.pose(), shading=shading, exposure=as_float(exposure))

    def placed(self, scene: Scene) -> Scene:
        """`scene` with the lights, meshes and camera of the arrangement.

        The frustums of shadow maps are fitted to the meshes if the light allows it. `io.write_gltf` writes such a scene
        for other programs.
        """
        meshes = [pose.placed(mesh) for pose, mesh in zip(self.meshes, scene.meshes, strict=True)]
        points = jnp.concatenate([mesh.vertices for mesh in meshes])
        lights = [light.at(pose).refitted(points) for pose, light in zip(self.lights, scene.lights, strict=True)]
        camera = scene.camera if self.camera is None else scene.camera.at(self.camera)
        return dataclasses.replace(scene, meshes=meshes, lights=lights, camera=camera)


def is_of_technique(path: str) -> bool:
    """Whether the number at `path` belongs to the technique."""
    return path.startswith("technique.")
