"""Small scenes, maps and look-ups whose shadows are known, and places for runs, shared by the tests."""

import contextlib
import dataclasses
import functools
import socket
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from optimistix import RESULTS

from diffshadow._arithmetic import as_array, as_float
from diffshadow.fit import TechniqueProblem
from diffshadow.fit._solve import Solution
from diffshadow.fit.problems._stack import Stack
from diffshadow.geometry import (
    DirectionalLight,
    Edges,
    Mesh,
    OrthographicCamera,
    PinholeCamera,
    Scene,
    SpotLight,
    Textures,
    merge,
)
from diffshadow.raster import Surface, draw_surface
from diffshadow.shadow import AbstractFilter, Bias, HardCompare, Lookup, ShadowMap, ShadowMapping, draw_shadow_map

SLANTED = (0.5, -1.0, -0.3)
"""The way the sun shines in these scenes."""
LAMP = (-1.2, 3.0, 0.9)
"""Where the spot light stands in these scenes."""

BOX_OVER_PLANE = """
scene:
  meshes:
    - {path: builtin:box, size: 0.6, drop_to_ground: true, translate: [0, 0.2, 0]}
    - {path: builtin:plane, options: {size: 3}}
  camera: {resolution: [64, 64], orbit: {distance: 4}}
  light: {angular_radius: 1.5}
shadow_map: {resolution: [64, 64]}"""
"""The head of a configuration: a box over a plane under a sun of a size, with 64² pixels and texels."""


def marked(cases: Iterable[Any], exhaustive: Collection[Any]) -> list[Any]:
    """The cases of a test, of which those in `exhaustive` are left to the exhaustive tests."""
    return [pytest.param(case, marks=pytest.mark.exhaustive) if case in exhaustive else case for case in cases]


def quad(center: Any, right: Any, up: Any) -> Mesh:
    """Two triangles; `right` and `up` are half of its sides."""
    c, r, u = (np.asarray(x, dtype=float) for x in (center, right, up))
    return Mesh([c - r - u, c + r - u, c + r + u, c - r + u], [[0, 1, 2], [0, 2, 3]])


def floor_and_card(card_half: float = 0.5, height: float = 1.0) -> Mesh:
    """A floor 6 world units wide in y = 0, and a square card that hovers over its middle."""
    card = quad((0, height, 0), (card_half, 0, 0), (0, 0, -card_half))
    return merge([quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), card])


def floor_camera(half: float = 1.5, resolution: tuple[int, int] = (96, 96)) -> OrthographicCamera:
    """Looks down on the floor from just above it: it sees the card's shadow but not the card."""
    return OrthographicCamera(
        (0, 0.5, 0), (0, 0, 0), (0, 0, -1), height=2 * half, near=0.1, far=1.0, resolution=resolution
    )


def side_camera(resolution: tuple[int, int] = (64, 64)) -> PinholeCamera:
    """Sees the card, its shadow and a good part of the floor."""
    return PinholeCamera((2.2, 2.6, 3.2), (0.2, 0.3, -0.2), fov_y=40.0, near=0.5, far=12.0, resolution=resolution)


def sun(mesh: Mesh, direction: Any = SLANTED, angular_radius: float = 0.0) -> DirectionalLight:
    return DirectionalLight.around(jnp.asarray(direction), mesh.vertices, angular_radius)


def lamp(mesh: Mesh, position: Any = LAMP) -> SpotLight:
    return SpotLight.around(jnp.asarray(position), mesh.vertices)


LIGHTS: dict[str, Callable[[Mesh], Any]] = {"directional": sun, "spot": lamp}


def seen_by(camera: Any, mesh: Mesh) -> Surface:
    """The surface, with the same fields as surfaces of points that are made by hand: they share programs."""
    return dataclasses.replace(draw_surface(mesh, camera), from_behind=None)


@functools.cache
def drawn(light: str, image: int, texels: int) -> tuple[Surface, ShadowMap]:
    """The card over the floor from the side, and its map; drawn once, in float32."""
    with jax.enable_x64(False):
        mesh = floor_and_card()
        surface = draw_surface(mesh, side_camera((image, image)))
        return surface, draw_shadow_map(mesh, LIGHTS[light](mesh), (texels, texels))


def problem(
    technique: ShadowMapping,
    light: str = "directional",
    image: int = 64,
    texels: int = 64,
    target: ShadowMapping | None = None,
) -> TechniqueProblem:
    """The card over the floor seen from the side; the reference is what `target` makes of it, or all lit."""
    to_default = lambda x: as_float(x) if eqx.is_inexact_array_like(x) else x
    surface, shadow_map = jax.tree.map(to_default, drawn(light, image, texels))
    reference = jnp.ones_like(surface.position[..., 0])
    if target is not None:
        reference = shadows(target, shadow_map, surface)
    return TechniqueProblem(technique, shadow_map, surface, reference, covered(technique, shadow_map, surface))


def shadows(technique: ShadowMapping, shadow_map: ShadowMap, surface: Surface) -> Any:
    return technique.visibility(shadow_map, surface)


def covered(technique: ShadowMapping, shadow_map: ShadowMap, surface: Surface) -> Any:
    return technique.covered(shadow_map, surface)


def jacfwd_and_value(function: Callable[..., Any]) -> Callable[..., Any]:
    """The derivative of a function and its value, which is not found twice."""

    def twice(x: Any) -> Any:
        value = function(x)
        return value, value

    return jax.jacfwd(twice, has_aux=True)


def technique(kernel: AbstractFilter, constant=0.0, slope=0.0, normal_offset=0.0, compare=None) -> ShadowMapping:
    return ShadowMapping(kernel, Bias(constant, slope, normal_offset), compare or HardCompare())


def map_of(depth: Any) -> ShadowMap:
    """A map with `depth` (h, w); its light does not matter, for look-ups into it are made by hand."""
    return ShadowMap(as_float(depth), DirectionalLight((0, -1, 0), (0, 0, 0), (1, 1), -1, 1))


def random_map(rng: np.random.Generator, shape: tuple[int, int] = (11, 14), empty: float = 0.2) -> ShadowMap:
    """Depths in [0.2, 0.8], of which a share is `empty`."""
    depth = rng.uniform(0.2, 0.8, shape)
    return map_of(np.where(rng.random(shape) < empty, 1.0, depth))


def lookups_at(x: Any, y: Any, depth: Any = 0.5, depth_per_texel: float = 0.05) -> Lookup:
    """Look-ups at texels (x, y), broadcast to (h, w)."""
    x, y, depth = (np.atleast_2d(v) for v in np.broadcast_arrays(x, y, depth))
    texel, step = np.stack([x, y], axis=-1), np.full(x.shape, depth_per_texel)
    return Lookup(as_float(texel), as_float(depth), as_float(step), as_array(np.ones(x.shape, bool)))


def random_lookups(
    rng: np.random.Generator, shape: tuple[int, int] = (9, 13), size: tuple[int, int] = (11, 14)
) -> Lookup:
    """Look-ups over a map of `size` and a few texels round it, at depths of its range."""
    height, width = size
    x, y = rng.uniform(-4, width + 4, shape), rng.uniform(-4, height + 4, shape)
    return lookups_at(x, y, rng.uniform(0.2, 0.8, shape))


@eqx.filter_jit
def apply(kernel: AbstractFilter, shadow_map: ShadowMap, lookup: Lookup, compare: Any) -> Any:
    """The filter's visibility, compiled once for each kind and shape."""
    return kernel(shadow_map, lookup, compare)


@contextlib.contextmanager
def compiled_programs() -> Iterator[list[str]]:
    """The names of the programs that are compiled, or loaded from the disk, meanwhile."""
    names: list[str] = []

    def listen(event: str, _: float, **about: Any) -> None:
        if event.endswith("backend_compile_duration"):
            names.append(str(about.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield names
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


@contextlib.contextmanager
def staying_in(folder: Path) -> Iterator[None]:
    """`folder` as the current one, with a cache of its own, until the block ends."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("DIFFSHADOW_CACHE", str(folder / "cache"))
        yield


def free_port() -> int:
    """A port of this machine that nothing listens to."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def fit_section(bias: float, radius: float, max_steps: int, anneal: str) -> str:
    """The section of a configuration that fits bias and radius, each from 0 to so many texels."""
    return f"""
fit:
  parameters:
    bias.constant: {{lower: 0, upper: {bias}}}
    filter.radius: {{lower: 0, upper: {radius}}}
  solver: {{max_steps: {max_steps}}}
  anneal: {anneal}
"""


def filled(mesh: Mesh, edges: Edges, vertices: int, faces: int, rows: int) -> tuple[Mesh, Edges]:
    """Mesh and edges with so many vertices, faces and rows: what is added draws nothing and outlines nothing, and
    meshes of all sizes share what is compiled."""

    def pad(values: Any, n: int, with_: int = 0) -> np.ndarray:
        rest = [(0, 0)] * (np.ndim(values) - 1)
        return np.pad(np.asarray(values), [(0, n - len(values)), *rest], constant_values=with_)

    whole = Mesh(pad(mesh.vertices, vertices), pad(mesh.faces, faces), np.zeros((faces, 3, 3)))
    fields = [pad(edges.vertices, rows), pad(edges.faces, rows), pad(edges.directions, rows)]
    # What is added is a component of its own.
    component = pad(edges.component, faces, len(edges.solid))
    arrays = [jnp.asarray(values, jnp.int32) for values in (*fields, component)]
    return whole, Edges(*arrays, jnp.asarray(pad(edges.solid, faces + 1)), False)


def floor_surface(half: float, resolution: tuple[int, int]) -> Surface:
    """What a camera sees that looks straight down on the middle of a floor in y = 0, `2 half` world units high: (h, w)
    points in rows that run to -z."""
    height, width = resolution
    x, z = ((np.arange(n) + 0.5 - n / 2) * (2 * half / height) for n in (width, height))
    position = np.stack(np.broadcast_arrays(x, 0.0, -z[:, None]), axis=-1)
    return surface_at(position, (0, 1, 0))


def surface_at(position: Any, normal: Any) -> Surface:
    """A white surface at points (h, w, 3) with these normals, all of its first face."""
    own = np.broadcast_to(np.asarray(normal, float), np.shape(position))
    place, normal, white = map(as_float, (position, own, np.ones(own.shape)))
    face = np.zeros(own.shape[:2], np.int32)
    return Surface(place, normal, normal, white, as_array(face), as_array(face == 0))


def twice(mesh: Mesh) -> Mesh:
    """Each face of a quad twice, which looks alike: it has as many as the card over the floor, and shares what is
    compiled."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return Mesh(np.concatenate([vertices, vertices]), np.concatenate([faces, faces + len(vertices)]))


@jax.jit
def _waves(first: Any, second: Any, position: Any) -> Any:
    x, z = position[..., 0], position[..., 2]
    return 0.5 + 0.4 * jnp.sin(first * x + second * z * x)


class Waves(eqx.Module):
    """Stands for a technique whose images are smooth functions of two numbers, and compiles in no time."""

    first: Any
    second: Any
    compare: HardCompare = HardCompare()

    def lays_out(self, name: str) -> bool:
        return False

    def prepare(self, scene: Scene, surface: Surface | None = None) -> Any:
        raise AssertionError("nothing is drawn")

    def visibility(self, state: Any, surface: Surface) -> Any:
        return _waves(self.first, self.second, surface.position)

    def covered(self, state: Any, surface: Surface) -> Any:
        return jnp.ones(surface.position.shape[:2], bool)


class Programs:
    """Stands for the compiled programs of phases of two numbers: each moves their free values by `step`, and takes only
    what it was made for.

    - `made`: the shapes of the arguments of each.
    """

    def __init__(self, step: float):
        self.step = np.float32(step)
        self.made: list[Any] = []

    def __call__(self, _: Any, arguments: Any, **_how: Any) -> Callable[..., Solution]:
        shapes = lambda tree: [np.shape(leaf) for leaf in jax.tree.leaves(tree)]
        self.made.append(shapes(arguments))

        def program(*given: Any, expected: Any = self.made[-1]) -> Solution:
            assert shapes(given) == expected
            joint, free = given[0], np.asarray(given[2])
            images = tuple(np.zeros((len(p.numbers) if isinstance(p, Stack) else 1, 4, 4)) for p in joint.problems)
            slopes, end = tuple(np.zeros((2, *each.shape)) for each in images), jnp.asarray(free + self.step)
            return Solution(end, np.zeros(2), np.ones(2), images, slopes, np.ones(1), 0, RESULTS.successful)

        return program


def fence(cutoff: float | None = 0.5) -> Mesh:
    """An upright card whose texture's alpha is that of bars, with the gaps between them cut out."""
    row, column = np.indices((16, 24))
    alpha = np.where((column % 8 < 3) | (row % 8 < 2), 1.0, 0.1)
    image = np.concatenate([np.random.default_rng(5).uniform(0, 1, (16, 24, 3)), alpha[..., None]], axis=-1)
    card = quad((0, 0.6, 0), (1.0, 0, 0.2), (0, 0.5, 0.1))
    corners = np.array([(0, 0), (2.5, 0), (2.5, 2), (0, 2)])
    textures = Textures.of(image, corners[np.asarray(card.faces)], cutoff)
    return Mesh(card.vertices, card.faces, card.corner_normals, textures=textures)


def fence_over_floor() -> tuple[Mesh, Mesh]:
    """A floor and a fence over it."""
    return quad((0, 0, 0), (3, 0, 0), (0, 0, -3)), fence()
