"""Draws in stages. Each stage keeps its last results, so a change redraws only the stages that depend on it.

| stage | depends on |
|---|---|
| meshes | the meshes of the configuration |
| surface | meshes, camera, size |
| state, such as a map | meshes, light, technique; also the surface if the layout is fitted to the camera |
| visibility | surface, state, the technique's numbers |
| antialiased surface, if `scene.camera.antialias` asks for it | meshes, camera, size |
| picture | visibility, shading, and the page's view |
"""

import threading
from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, UInt8

from .. import geometry, raster, shadow
from .._types import HostArray
from ..config import BuiltMeshes, Config, build_camera, build_lights, build_meshes, build_shading, changed, frozen
from ._state import Look
from ._subject import Subject

Picture = UInt8[HostArray, "h w 3"]
"""An image in sRGB, with the top row first."""


class Recent:
    """The last `most` results of a stage, by key. `calls` counts the results that were computed."""

    def __init__(self, most: int = 4):
        self.most, self.calls = most, 0
        self._kept: dict[Hashable, Any] = {}
        self._lock = threading.Lock()

    def __call__(self, key: Hashable, make: Callable[[], Any]) -> Any:
        with self._lock:
            if key in self._kept:
                # A used result moves to the end, so the least recently used is dropped first.
                found = self._kept[key] = self._kept.pop(key)
                return found
        # Without the lock, so that other threads can draw at the same time.
        made = make()
        with self._lock:
            self.calls += 1
            self._kept[key] = made
            while len(self._kept) > self.most:
                del self._kept[next(iter(self._kept))]
        return made

    def __contains__(self, key: Hashable) -> bool:
        return key in self._kept


class DrawingCache:
    """The last results of all stages. Pages and subjects share them."""

    def __init__(self):
        self.meshes, self.camera, self.lights, self.shading = Recent(), Recent(8), Recent(8), Recent()
        self.surface, self.state, self.visibility, self.covered = Recent(), Recent(), Recent(8), Recent()
        self.antialiased = Recent()


class Frame:
    """One picture of a subject, at one size and with a page's settings. Each part is drawn on first use.

    - `config`: with all numbers of the page. Its structure may not differ from the subject's.
    - `size`: (height, width), in pixels.
    - `light`: the index of the light for views of a single light.
    """

    def __init__(
        self, cache: DrawingCache, subject: Subject, look: Look, size: tuple[int, int], config: Config | None = None
    ):
        self.cache, self.subject, self.look, self.size = cache, subject, look, size
        self.config = subject.at(look.state) if config is None else config
        self._meshes = frozen(self.config.scene.meshes)
        self._camera = frozen(self.config.scene.camera)
        self._lights = [frozen(light) for light in self.config.scene.each_light.values()]
        self.light = min(look.light, len(self._lights) - 1)
        self.built: BuiltMeshes = cache.meshes(self._meshes, lambda: build_meshes(self.config))
        self.numbers = subject.numbers_of(self.config)

    @cached_property
    def technique(self) -> Any:
        """The technique with the page's numbers."""
        return self.subject.technique_with(self.numbers)

    @property
    def camera(self) -> geometry.AbstractCamera:
        """The camera, with images of this size."""
        return self._camera_of(self.size)

    @property
    def lights(self) -> list[geometry.AbstractLight]:
        """All lights."""
        return self.cache.lights((self._meshes, *self._lights), lambda: build_lights(self.config, self.built))

    @property
    def shading(self) -> Any:
        """The shading of pictures."""
        key = frozen(self.config.shading), len(self._lights)
        return self.cache.shading(key, lambda: build_shading(self.config))

    def scene(self, light: int) -> geometry.Scene:
        """The scene with one light."""
        return self.built.scene(self.config, self.camera, [self.lights[light]])

    @property
    def surface(self) -> raster.Surface:
        """The surface that the camera sees."""
        return self._surface_of(self.size)

    @property
    def moves(self) -> bool:
        """Whether the surface or the map of a light is not drawn yet. A smaller picture then comes first."""
        states = (self.state_key(light) in self.cache.state for light in range(len(self._lights)))
        return self._surface_key(self.size) not in self.cache.surface or not all(states)

    def state_key(self, light: int) -> Hashable:
        """The key of a light's state."""
        laid_out = tuple(self.numbers[name] for name in self.subject.laid_out)
        camera = self._camera if self.subject.follows_camera else ""
        return self._meshes, self._lights[light], self.subject.map_key, laid_out, camera

    def state(self, light: int) -> Any:
        """The state of the technique for a light, such as its map."""
        return self.cache.state(self.state_key(light), lambda: self._prepared(light))

    def _prepared(self, light: int) -> Any:
        """A new state. A small picture uses a map of full size, because its acne would otherwise differ."""
        if not self.subject.follows_camera:
            return self.technique.prepare(self.scene(light))
        full = self.subject.full_size
        scene = self.built.scene(self.config, self._camera_of(full), [self.lights[light]])
        return self.technique.prepare(scene, self._surface_of(full))

    def visibility(self, light: int) -> Any:
        """The visibility of a light, of shape (h, w)."""
        numbers = tuple(self.numbers.values())
        key = self.subject.key, numbers, self.state_key(light), self._surface_key(self.size)
        draw = lambda: self.technique.visibility(self.state(light), self.surface)
        return self.cache.visibility(key, draw)

    def covered(self, light: int) -> Bool[HostArray, "h w"]:
        """The pixels that count for a light, as booleans of shape (h, w)."""
        key = self.subject.key, self.state_key(light), self._surface_key(self.size)
        draw = lambda: np.asarray(self.technique.covered(self.state(light), self.surface))
        return self.cache.covered(key, draw)

    @property
    def truth_key(self) -> Hashable:
        """The key of the shown light's reference."""
        return self._surface_key(self.size), self._lights[self.light], frozen(self.subject.how)

    def shaded(self) -> Picture:
        """The picture that a render stores, lit by all lights."""
        visibility = [self.visibility(light) for light in range(len(self.lights))]
        surface = self._antialiased if self.config.scene.antialiases else self.surface
        return np.asarray(_shaded(self.shading, surface, visibility, self.lights, self.camera))

    @property
    def _antialiased(self) -> raster.AntialiasedSurface:
        draw = lambda: raster.draw_antialiased(geometry.merge(self.built.meshes), self.camera)
        return self.cache.antialiased(self._surface_key(self.size), draw)

    def from_light(self) -> Picture:
        """The scene as the shown light sees it, shaded with its shadow. Every dark pixel is false shadow."""
        view, key = self.lights[self.light].view(), self._lights[self.light]
        clip = np.array(view.eye_to_clip)
        height, width = self.size
        # The camera sees everything that the map sees, with square pixels.
        wider = width / height * clip[0, 0] / clip[1, 1]
        clip[0], clip[1] = clip[0] / max(wider, 1.0), clip[1] * min(wider, 1.0)
        camera = geometry.MatrixCamera(view.world_to_eye, clip, self.size, view.is_perspective)
        surface = self.cache.surface((self._meshes, key, self.size), lambda: self._drawn_by(camera))
        visibility = self.technique.visibility(self.state(self.light), surface)
        light, shading = [self.lights[self.light]], self.shading.of_light(self.light)
        return np.asarray(_shaded(shading, surface, [visibility], light, camera))

    def _camera_of(self, size: tuple[int, int]) -> geometry.AbstractCamera:
        scene = changed(self.config.scene, camera=changed(self.config.scene.camera, resolution=size))
        make = lambda: build_camera(changed(self.config, scene=scene), self.built)
        return self.cache.camera(self._surface_key(size), make)

    def _surface_key(self, size: tuple[int, int]) -> Hashable:
        return self._meshes, self._camera, size

    def _surface_of(self, size: tuple[int, int]) -> raster.Surface:
        return self.cache.surface(self._surface_key(size), lambda: self._drawn_by(self._camera_of(size)))

    def _drawn_by(self, camera: geometry.AbstractCamera) -> raster.Surface:
        # The buffer of the technique lets this share its program with the map.
        has_map = isinstance(self.technique, shadow.ShadowMapping)
        buffer = self.technique.layers.buffer(camera.resolution) if has_map else None
        return raster.draw_surface(geometry.merge(self.built.meshes), camera, buffer=buffer)


@eqx.filter_jit
def _shaded(
    shading: Any,
    surface: raster.Surface | raster.AntialiasedSurface,
    visibility: Any,
    lights: Any,
    camera: geometry.AbstractCamera,
) -> UInt8[Array, "h w 3"]:
    """The shaded picture in sRGB (IEC 61966-2-1), within 1/255. Three square roots replace the power of 1/2.4 and take
    two thirds of its time."""
    draw = shading.antialiased if isinstance(surface, raster.AntialiasedSurface) else shading
    linear = jnp.clip(draw(surface, visibility, lights, camera), 0, 1)
    root = jnp.sqrt(linear)
    fourth = jnp.sqrt(root)
    curve = 0.585122381 * root + 0.783140355 * fourth - 0.368262736 * jnp.sqrt(fourth)
    return jnp.rint(255 * jnp.where(linear <= 0.0031308, 12.92 * linear, curve)[::-1]).astype(jnp.uint8)
