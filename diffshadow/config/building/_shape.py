"""Builds a fit of a shape: a screen behind the shape for each light, and the meshes that cast shadows on the
screens."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ... import fit, geometry, io, raster
from ..._arithmetic import as_array, as_float, as_int
from ..._types import HostArray, Resolution
from ...settings import scene
from .._errors import KeyPath
from ..framing._meshes import build_mesh
from ..sections._config import Config
from ..sections._fit import ShapeConfig
from ..sections._scene import DirectionalLightConfig
from ..sections._section import changed
from ._scene import Surroundings, light_on
from ._scene import blame as blame_of

Blame = Callable[[KeyPath], AbstractContextManager[None]]

# The side of a pictured square, in radii of all meshes.
_EXTENT = 2.2
# The distances from the shape's centre to the screen behind it and to the camera in front of it, in half sides of the
# pictured square.
_SCREEN, _CAMERA = 1.3, 0.2
# The width of a screen, relative to the view of its camera.
_WIDER = 2.0
# A pixel of an image is in shadow below this visibility. The second number is the fraction of an image's border that
# may be in shadow.
_DARK, _MOSTLY = 0.5, 0.5
# The minimum sine of the angle between the light and a level screen.
_GRAZING = 0.1
_AXES = "xyz"


class Screen(NamedTuple):
    """A light, the screen that receives its shadows, and a camera that sees only the screen.

    - `key`: key of the light in the configuration.
    """

    key: str
    light: geometry.AbstractLight
    mesh: geometry.Mesh
    camera: geometry.OrthographicCamera

    def surface(self) -> raster.Surface:
        """The surface that the camera sees: `raster.draw_surface(self.mesh, self.camera)`, without a compiled
        program."""
        camera = self.camera
        height, width = camera.resolution
        eye, target, up = (np.asarray(each, np.float64) for each in (camera.eye, camera.target, camera.up))
        normal = eye - target
        normal = normal / np.linalg.norm(normal)
        along = lambda count: ((np.arange(count) + 0.5) / count - 0.5) * float(camera.height)
        row, column = along(height)[:, None, None], along(width)[:, None] * (width / height)
        position = as_float(target + row * up + column * np.cross(up, normal))
        everywhere = lambda value: as_float(np.broadcast_to(value, position.shape))
        return raster.Surface(
            position=position,
            normal=everywhere(normal),
            interpolated_normal=everywhere(normal),
            albedo=everywhere(1.0),
            face=as_int(np.zeros((height, width))),
            mask=as_array(np.ones((height, width), bool)),
        )

    def scene(self, mesh: geometry.Mesh) -> geometry.Scene:
        """The screen in the shadow of a mesh."""
        return geometry.Scene([mesh, self.mesh], self.camera, [self.light], (True, False))


class ShapePlan(NamedTuple):
    """The inputs of a fit of a shape.

    - `seen`, `unseen`: the screens of the fit's lights, and of the lights that only measure the result.
    - `starts`: for each light of the fit, whether it is fitted too, and its start.
    - `start`: the mesh at the start; `None` for the visual hull of the targets. `symmetry`: as for `fit.ShapeProblem`.
    - `targets`: the mesh whose shadow each light should cast; empty if there are images.
    - `truth`: the mesh that casts all of these shadows, if there is one.
    - `images`, `weights`: (h, w), an image and weights for each light; empty without images.
    - `remarks`: sentences on images that look wrong.
    """

    seen: list[Screen]
    unseen: list[Screen]
    starts: list[tuple[bool, geometry.AbstractLight]]
    start: geometry.Mesh | None
    symmetry: tuple[float, float, float, float] | None
    targets: list[geometry.Mesh]
    truth: geometry.Mesh | None
    images: list[Float[HostArray, "h w"]]
    weights: list[Float[HostArray, "h w"]]
    phases: list[fit.ShapePhase]
    remarks: list[str]


def build_shape(config: Config) -> ShapePlan:
    """The lights, screens and meshes of a fit of a shape.

    **Raises** `ConfigError` for a mesh, a light or an image that cannot be used.
    """
    blame = functools.partial(blame_of, config)
    shape, here = config.fit.shape, ("fit", "shape")
    assert shape is not None
    meshes = []
    for i, section in enumerate(config.scene.meshes):
        with blame(("scene", "meshes", i)):
            meshes.append(build_mesh(section))
    cast = [mesh for mesh, section in zip(meshes, config.scene.meshes, strict=True) if section.casts]
    casters, targets = geometry.merge(cast), []
    for i, section in enumerate(shape.targets):
        with blame((*here, "targets", i)):
            targets.append(build_mesh(section))
    is_traced = not (shape.images or targets)
    start = None if is_traced else _welded(casters)
    if shape.start is not None:
        with blame((*here, "start")):
            start = _welded(build_mesh(shape.start))
    about = casters if start is None else start
    whole = geometry.merge([about, *(targets or [casters])])
    middle = np.asarray(casters.bounds if is_traced else about.bounds, np.float64).mean(axis=0)
    radius = float(np.linalg.norm(np.asarray(whole.vertices)[np.unique(whole.faces)] - middle, axis=-1).max())
    extent = _EXTENT * radius if shape.extent is None else shape.extent
    screens = lambda lights: [_screen(blame, key, light, shape, middle, extent) for key, light in lights.items()]
    if start is not None:
        build_free(config, start)
    images, weights = _images(shape, blame)
    phases = [
        fit.ShapePhase(**{key: getattr(phase, key) for key in type(phase).model_fields}) for phase in shape.phases
    ]
    seen = screens({("scene", *key): light for key, light in config.scene.each_light.items()})
    rng = np.random.default_rng(config.seed)
    return ShapePlan(
        seen=seen,
        starts=[
            (True, _moved_light(screen.light, middle, shape.off, rng)) if i in shape.moves else (False, screen.light)
            for i, screen in enumerate(seen)
        ],
        unseen=screens({(*here, "unseen", i): light for i, light in enumerate(shape.unseen)}),
        start=start,
        symmetry=_symmetry(shape, about),
        targets=[] if images else targets or [casters] * len(config.scene.each_light),
        truth=casters if is_traced else None,
        images=images,
        weights=weights,
        phases=phases,
        remarks=list(_image_remarks(shape, images, weights)),
    )


def _moved_light(
    light: geometry.AbstractLight, middle: Float[HostArray, "3"], degrees: float, rng: np.random.Generator
) -> geometry.AbstractLight:
    """A light in a random direction, at this angle in degrees from its position, as seen from the shape's `middle`."""
    pose, way = light.pose(), rng.normal(size=3)
    if pose.position is not None:
        towards = np.asarray(pose.place, np.float64) - middle
        aside = np.cross(towards, way)
        turned = np.tan(np.radians(degrees)) * np.linalg.norm(towards) * aside / np.linalg.norm(aside)
        x, y, z = as_float(middle + towards + turned)
        pose = dataclasses.replace(pose, position=geometry.Vector(x, y, z))
    if pose.azimuth is not None and pose.elevation is not None and light.is_directional:
        along, up = degrees * way[:2] / np.linalg.norm(way[:2])
        cosine = max(abs(float(np.cos(np.radians(pose.elevation)))), 0.1)
        azimuth, elevation = pose.azimuth + along / cosine, pose.elevation + up
        pose = dataclasses.replace(pose, azimuth=azimuth, elevation=elevation)
    return light.at(pose)


def _welded(mesh: geometry.Mesh) -> geometry.Mesh:
    vertices, faces, _ = geometry.weld(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces), 0)
    return geometry.Mesh(vertices, faces)


def build_free(config: Config, start: geometry.Mesh) -> Bool[HostArray, " v"]:
    """The moving vertices (v,) of the mesh that a fit starts from.

    **Raises** `ConfigError` if there are none.
    """
    shape = config.fit.shape
    assert shape is not None
    heights = np.asarray(start.vertices)[:, 1]
    free = np.ones(len(heights), bool) if shape.pinned is None else heights >= shape.pinned
    with blame_of(config, ("fit", "shape", "pinned")):
        if not free.any():
            raise ValueError(
                f"is {shape.pinned:g}, above all of the start's vertices; expected moving vertices: lower it to less "
                f"than {heights.max():.4g}"
            )
    return free


def _symmetry(shape: ShapeConfig, start: geometry.Mesh) -> tuple[float, float, float, float] | None:
    if shape.symmetry is None:
        return None
    axis = _AXES.index(shape.symmetry)
    x, y, z = np.eye(3)[axis].tolist()
    return x, y, z, float(np.asarray(start.bounds).mean(axis=0)[axis])


def _images(shape: ShapeConfig, blame: Blame) -> tuple[list[Float[HostArray, "h w"]], list[Float[HostArray, "h w"]]]:
    """The images, and the weights of their pixels.

    **Raises** `ConfigError` for a file that cannot be read, for an image of another size, and for an image without a
    shadow or without light.
    """
    images, weights = [], []
    for i, path in enumerate(shape.images):
        with blame(("fit", "shape", "images", i)):
            images.append(_image(path, shape.resolution))
        with blame(("fit", "shape", "masks", i)):
            weights.append(_image(shape.masks[i], shape.resolution) if shape.masks else np.ones(shape.resolution))
        with blame(("fit", "shape", "images", i)):
            dark = images[-1][weights[-1] > 0] < _DARK
            if not dark.any() or dark.all():
                raise ValueError(
                    f"is {path}, which is {'dark' if dark.any() else 'light'} in all pixels that count; expected a "
                    "dark shadow on white: check the image, its mask, or whether it is inverted"
                )
    return images, weights


def _image_remarks(
    shape: ShapeConfig, images: Sequence[Float[HostArray, "h w"]], weights: Sequence[Float[HostArray, "h w"]]
) -> Iterator[str]:
    """A sentence for each image that is dark around a light shape. No shape inside casts such a shadow."""
    for i, (image, weight) in enumerate(zip(images, weights, strict=True)):
        rows, columns = (np.flatnonzero((weight > 0).any(axis=axis)) for axis in (1, 0))
        rim = np.ones_like(weight, bool)
        rim[rows[0] + 1 : rows[-1], columns[0] + 1 : columns[-1]] = False
        share = float((image[rim & (weight > 0)] < _DARK).mean())
        if share > _MOSTLY:
            yield (
                f"fit.shape.images.{i} ({shape.images[i]}) is dark in {share:.0%} of the pixels at its border that "
                "count, but a shadow should be dark on white: if the shape is white, invert the image; if the shadow "
                "is cut off, show the whole shadow and raise fit.shape.extent"
            )


def _image(path: str, resolution: Resolution) -> Float[HostArray, "h w"]:
    image = np.asarray(io.read_visibility(path))
    if image.shape != tuple(resolution):
        raise ValueError(
            f"is an image of {list(image.shape)} pixels, [height, width], and fit.shape.resolution is "
            f"{list(resolution)}; expected the same: scale the image, or set the resolution"
        )
    return image


def _screen(
    blame: Blame,
    key: KeyPath,
    section: scene.Light,
    shape: ShapeConfig,
    middle: Float[HostArray, "3"],
    extent: float,
) -> Screen:
    """The screen of one light.

    **Raises** `ConfigError` for a light that does not fall on it.
    """
    half = extent / 2
    with blame(key):
        around = _ball(middle, half)
        light = _hard(
            light_on(_framed(section), Surroundings(around, around, middle, half, geometry.WORLD)), section, half
        )
        position = getattr(light, "position", None)
        way, distance = np.asarray(getattr(light, "direction", np.zeros(3)), np.float64), np.inf
        if position is not None:
            way = middle - np.asarray(position, np.float64)
            distance = float(np.linalg.norm(way))
            if distance <= half:
                raise ValueError(
                    f"stands {distance:.3g} world units from the shape's centre; expected a position outside of the "
                    f"pictured square, beyond {half:.3g}: move it away, or make fit.shape.extent smaller"
                )
        way = way / np.linalg.norm(way)
        down = np.array([0.0, -1.0, 0.0])
        facing = way if shape.screen == "facing" else down
        cosine = float(way @ facing)
        if cosine < _GRAZING:
            raise ValueError(
                "shines upwards or along the level screen; expected light from above: raise its elevation, or set "
                "fit.shape.screen to facing"
            )
        behind = _SCREEN * half / cosine
        centre = middle + behind * way
        upright = _upright(facing, way)
        wide, (height, width) = extent * (1 + behind / distance) / cosine, shape.resolution
        tall = wide * min(1.0, height / width)
        if position is None:
            # The map's texels coincide with the image's pixels.
            size = tall * width / height, tall * cosine
            slant = tall * np.sqrt(max(1 - cosine**2, 0.0)) / 2
            light = geometry.DirectionalLight(
                way, middle, size, -extent, behind + extent + slant, 0.0, _upright(way, way)
            )
        across = np.cross(facing, upright)
        u, v = (_WIDER * wide * axis for axis in (across, upright))
        mesh = geometry.Mesh([centre - u - v, centre + u - v, centre + u + v, centre - u + v], [[0, 1, 2], [0, 2, 3]])
        eye = centre - _CAMERA * half * facing
        camera = geometry.OrthographicCamera(
            as_float(eye),
            as_float(centre),
            as_float(upright),
            height=tall,
            near=_CAMERA * half / 4,
            far=_CAMERA * half * 2,
            resolution=shape.resolution,
        )
        return Screen(".".join(map(str, key)), light, mesh, camera)


def _framed(section: scene.Light) -> scene.Light:
    """A sun's section without a frame of its map, because the images define it."""
    is_sun = isinstance(section, DirectionalLightConfig)
    return changed(section, frame="scene", shadow_camera=None) if is_sun else section


def _hard(light: geometry.AbstractLight, section: scene.Light, half: float) -> geometry.AbstractLight:
    """A light as a point, with a map that extends to the screen."""
    if isinstance(light, geometry.RectangleLight):
        raise ValueError(
            "is a rectangle, whose shadows are soft, and fit.shape compares hard ones; expected a directional, spot or "
            "point light: change its type"
        )
    if isinstance(light, geometry.SpotLight | geometry.PointLight):
        given: Any = section
        far = float(light.far) + 4 * half if given.far is None else light.far
        return type(light)(**{**vars(light), "radius": 0.0, "far": far})
    return light


def _upright(facing: Float[HostArray, "3"], way: Float[HostArray, "3"]) -> Float[HostArray, "3"]:
    """The direction that is upright in the image of a screen: upwards, or along the light for a level screen."""
    for up in (np.array([0.0, 1.0, 0.0]), way, np.array([0.0, 0.0, -1.0])):
        across = up - (up @ facing) * facing
        if np.linalg.norm(across) > 1e-3:
            return across / np.linalg.norm(across)
    raise AssertionError("three directions lie along one")


def _ball(middle: Float[HostArray, "3"], radius: float) -> Float[HostArray, "n 3"]:
    """Points around a ball."""
    corners = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    corners = corners[np.abs(corners).sum(axis=-1) > 0]
    return middle + radius * corners / np.linalg.norm(corners, axis=-1, keepdims=True)
