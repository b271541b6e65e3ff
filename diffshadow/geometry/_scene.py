"""A scene: meshes, a camera and lights."""

import dataclasses
import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool

from .._arithmetic import as_float, concrete
from .._checks import check_instance, shown_with_values
from .._pictures import SIDE, as_html, draw_faces, is_known, lit
from .._types import HostArray
from .._words import counted
from ._camera import AbstractCamera
from ._mesh import Mesh, MeshLike, as_mesh, face_colours, face_normals, merge, meshes_of
from ._origin import WORLD, Origin, PrecisionWarning, as_origin, origin_of, step_of
from ._trimesh import TriangleScene
from ._trimesh_scene import camera_of, lights_of
from .lights import AbstractLight


def _as_tuple[T](given: T | Iterable[T]) -> tuple[T, ...]:
    return tuple(given) if isinstance(given, Iterable) else (given,)


def _as_meshes(given: MeshLike | Iterable[Any]) -> tuple[Mesh, ...]:
    if isinstance(given, TriangleScene):
        return tuple(meshes_of(given))
    return tuple(as_mesh(mesh, "a mesh of the scene") for mesh in _as_tuple(given))


class Scene(eqx.Module):
    """Meshes, a camera and lights.

    - `meshes`: all visible surfaces; one mesh or several, stored as a tuple. Other objects with vertices and faces are
        converted by `Mesh.from_trimesh`. A `trimesh.Scene` has a mesh for each node of its graph.
    - `camera`: where the image is drawn from. May be left out for a `trimesh.Scene` that has a camera.
    - `lights`: one light or several, stored as a tuple. May be left out for a `trimesh.Scene` that has lights: its
        directional, point and spot lights are used. Their shadow maps are fitted to the meshes, and their colours,
        intensities and ranges are ignored.
    - `casts`: for each mesh, whether it casts a shadow; by default all cast. A mesh that does not cast still receives
      shadows. It does not block rays of the reference, unless the reference has `blockers="all"`.
    - `receives`: for each mesh, whether engines show shadows on it; by default on all. Other techniques show shadows on
      all meshes.
    - `origin`: the world point that the coordinates of meshes, camera and lights are relative to. A scene far from the
        world's origin needs one, see `origin_of`; a configuration's scene has it.

    **Raises** `ValueError` if there is no mesh, no camera or no light, if no mesh casts, or unless `casts` and
    `receives` have one entry per mesh.

    **Warns** with `PrecisionWarning` if the meshes are too far from their origin for single precision.

    !!! Example

        ```python
        lamp = geometry.SpotLight.around((1.0, 3.0, 1.0), geometry.merge(meshes).vertices)
        two_lights = geometry.Scene(meshes, camera, [light, lamp], casts=[True, False])
        two_lights.lit_by(1).light is lamp  # True
        ```
    """

    meshes: tuple[Mesh, ...]
    camera: AbstractCamera
    lights: tuple[AbstractLight, ...]
    casts: tuple[bool, ...] | None = eqx.field(static=True, default=None)
    receives: tuple[bool, ...] | None = eqx.field(static=True, default=None)
    origin: Origin = eqx.field(static=True, default=WORLD)

    def __init__(
        self,
        meshes: MeshLike | Iterable[Any],
        camera: AbstractCamera | None = None,
        lights: AbstractLight | Iterable[AbstractLight] | None = None,
        casts: Sequence[bool] | None = None,
        receives: Sequence[bool] | None = None,
        origin: Sequence[float | int] = WORLD,
    ):
        self.meshes = _as_meshes(meshes)
        found = camera_of(meshes) if camera is None else camera
        if found is None:
            raise ValueError("the scene has no camera; expected one, such as a PinholeCamera")
        self.camera = found
        if lights is None:
            points = [np.asarray(mesh.vertices) for mesh in self.meshes] if isinstance(meshes, TriangleScene) else []
            lights = lights_of(meshes, as_float(np.concatenate(points))) if points else ()
        self.lights = _as_tuple(lights)
        self.casts = None if casts is None else tuple(casts)
        self.receives = None if receives is None else tuple(receives)
        self.origin = as_origin(origin)

    def __check_init__(self):
        if not self.meshes:
            raise ValueError("the scene has no mesh; expected a mesh, or several in a sequence")
        if not self.lights:
            raise ValueError("the scene has no light; expected a light, or several in a sequence")
        check_instance("the scene's camera", self.camera, AbstractCamera, "a camera, such as a PinholeCamera")
        for light in self.lights:
            check_instance("a light of the scene", light, AbstractLight, "a light, such as a DirectionalLight")
        for name, each in (("casts", self.casts), ("receives", self.receives)):
            if each is not None and len(each) != len(self.meshes):
                raise ValueError(
                    f"{name} has {counted(len(each), 'entry')}, and the scene has {counted(len(self.meshes), 'mesh')}; "
                    "expected one each"
                )
        if self.casts is not None and not any(self.casts):
            raise ValueError("no mesh of the scene casts shadows; expected at least one: set one of casts to True")
        self._check_precision()

    def _check_precision(self) -> None:
        """**Warns** if the meshes are too far from the origin."""
        known = [concrete(mesh.vertices) for mesh in self.meshes]
        points = [points for points in known if points is not None and points.dtype == np.float32 and len(points)]
        if not points or len(points) < len(known):
            return
        low, high = np.min([p.min(axis=0) for p in points], axis=0), np.max([p.max(axis=0) for p in points], axis=0)
        if step := step_of(low, high):
            origin = [float(f"{value:.9g}") for value in origin_of([low, high])]
            warnings.warn(
                PrecisionWarning(
                    f"the scene is {(high - low).max():.3g} world units wide, and so far from its origin that single "
                    f"precision has steps of {step:.2g} there: shadows lose their digits; subtract a point such as "
                    f"{origin} from all vertices, cameras and lights in double precision, and give it to the Scene as "
                    "origin"
                ),
                stacklevel=4,
            )

    def __repr__(self) -> str:
        return shown_with_values(self)

    def _repr_html_(self) -> str | None:
        """A picture of the camera's view, without shadows."""
        if not is_known(self):
            return None
        mesh, view = self.mesh, self.camera.view()
        height, width = self.camera.resolution
        resolution = (max(1, SIDE * height // max(height, width)), max(1, SIDE * width // max(height, width)))
        points = np.append(np.asarray(mesh.vertices), np.ones((mesh.vertices.shape[0], 1)), axis=1)
        colours = lit(np.asarray(face_normals(mesh)), np.asarray(view.world_to_eye)[2, :3], face_colours(mesh))
        image = draw_faces(points @ np.asarray(view.matrix).T, np.asarray(mesh.faces), colours, resolution)
        lights = ", ".join(type(light).__name__ for light in self.lights)
        title = (
            f"Scene: {counted(len(self.meshes), 'mesh')}, {counted(mesh.faces.shape[0], 'triangle')}; {lights}; "
            f"{width} x {height} pixels"
        )
        return as_html(title, image)

    @property
    def mesh(self) -> Mesh:
        """All meshes merged, in their order."""
        return merge(self.meshes)

    @property
    def casters(self) -> Mesh:
        """The meshes that cast, merged."""
        return merge([mesh for mesh, casts in zip(self.meshes, self._casts, strict=True) if casts])

    @property
    def receivers(self) -> Mesh | None:
        """The meshes that only receive, merged; `None` if all cast."""
        meshes = [mesh for mesh, casts in zip(self.meshes, self._casts, strict=True) if not casts]
        return merge(meshes) if meshes else None

    @property
    def casting_faces(self) -> Bool[HostArray, " f"]:
        """Which faces of `mesh` cast."""
        return np.repeat(self._casts, [mesh.faces.shape[0] for mesh in self.meshes])

    @property
    def light(self) -> AbstractLight:
        """The scene's only light.

        **Raises** `ValueError` if there are several.
        """
        if len(self.lights) != 1:
            raise ValueError(
                f"the scene has {len(self.lights)} lights; expected one: select each in turn with lit_by(index)"
            )
        return self.lights[0]

    def lit_by(self, index: int) -> "Scene":
        """The scene with only the light at `index` in `lights`.

        **Raises** `ValueError` if there is no such light.
        """
        if not 0 <= index < len(self.lights):
            raise ValueError(
                f"the scene has no light {index}; expected an index from 0 to {len(self.lights) - 1}, because it has "
                f"{len(self.lights)} lights"
            )
        return dataclasses.replace(self, lights=self.lights[index])

    @property
    def _casts(self) -> tuple[bool, ...]:
        return (True,) * len(self.meshes) if self.casts is None else self.casts
