"""Rows of the table of derivatives: functions of few numbers in float64, and where to try them.

Importing the modules beside this one fills `ROWS`.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffshadow._arithmetic import as_float
from diffshadow.raster import Surface

ROWS: dict[str, "Row"] = {}


class Row(NamedTuple):
    """A function and where to try it.

    - `make`: makes the function under `jax.enable_x64`: from numbers (n,) to a tree of arrays. With it, it may return a
        second function, whose differences the derivative equals; for values that are rounded.
    - `at`: the numbers. Each of them changes the value.
    - `covers`: settings, paths of an `Arrangement` and public names that the row tries.
    - `is_still`: whether the value has no derivative by design, although it changes.
    - `on_host`: whether the function runs in NumPy, and returns a number and its gradient (n,).
    - `backward`: whether reverse mode is tried too, which takes twice as long to compile: where the package has a
        derivative or a loop of its own. JAX transposes all else by itself.
    - `step`, `tolerance`: of central differences, and of derivatives relative to the largest of a leaf.
    """

    make: Callable[[], Any]
    at: tuple[float, ...]
    covers: frozenset[str]
    is_still: bool
    on_host: bool
    backward: bool
    step: float
    tolerance: float


def row(
    name: str,
    at: Sequence[float],
    covers: str = "",
    *,
    is_still: bool = False,
    on_host: bool = False,
    backward: bool = False,
    step: float = 1e-5,
    tolerance: float = 1e-6,
) -> Callable[[Callable[[], Any]], Callable[[], Any]]:
    """Adds a row, which the decorated function makes."""

    def add(make: Callable[[], Any]) -> Callable[[], Any]:
        assert name not in ROWS, name
        numbers = tuple(map(float, at))
        ROWS[name] = Row(make, numbers, frozenset(covers.split()), is_still, on_host, backward, step, tolerance)
        return make

    return add


class Found(NamedTuple):
    """What was found at a row's numbers, (n,).

    - `values`: the leaves of the value, (m,) each.
    - `differences`, `forward`: central differences and forward-mode derivatives of each leaf, (n, m).
    - `backward`, `expected`: the derivative of a weighted sum of all leaves, (n,), by reverse and by forward mode.
    """

    values: list[np.ndarray]
    differences: list[np.ndarray]
    forward: list[np.ndarray]
    backward: Any
    expected: Any


def _weights(leaf: Any) -> Any:
    return jnp.cos(1 + jnp.arange(leaf.size, dtype=leaf.dtype)).reshape(leaf.shape)


@functools.cache
def found(name: str) -> Found:
    """All that is known of a row."""
    made = ROWS[name]
    at, steps = np.array(made.at), made.step * np.eye(len(made.at))
    with jax.enable_x64(True):
        if made.on_host:
            of = made.make()
            value, gradient = of(at)
            ends = [(of(at + step)[0] - of(at - step)[0]) / (2 * made.step) for step in steps]
            return Found([np.array([value])], [np.array(ends)[:, None]], [np.asarray(gradient)[:, None]], None, None)
        given = made.make()
        of, smooth = given if isinstance(given, tuple) else (given, None)
        leaves = lambda x: [leaf for leaf in jax.tree.leaves(of(x)) if eqx.is_inexact_array(leaf)]

        @jax.jit
        def program(x, way):
            """The value, its derivative along a way, and the gradient of its weighed sum: in one program."""
            if not made.backward:
                return *jax.jvp(leaves, (x,), (way,)), None
            value, push = jax.linearize(leaves, x)
            (pulled,) = jax.linear_transpose(push, x)([_weights(leaf) for leaf in value])
            return value, push(way), pulled

        flat = lambda tree: [np.asarray(leaf).reshape(-1) for leaf in jax.tree.leaves(tree)]
        ways = np.eye(len(at))
        value, _, backward = program(at, ways[0])
        forward = [flat(program(at, way)[1]) for way in ways]
        plain = (lambda x: program(x, ways[0])[0]) if smooth is None else jax.jit(smooth)
        ends = [
            [(high - low) / (2 * made.step) for high, low in zip(flat(plain(at + s)), flat(plain(at - s)), strict=True)]
            for s in steps
        ]
        stacked = lambda each: [np.stack(leaf) for leaf in zip(*each, strict=True)]
        weights = flat([_weights(leaf) for leaf in value])
        expected = sum(slope @ weight for slope, weight in zip(stacked(forward), weights, strict=True))
        return Found(flat(value), stacked(ends), stacked(forward), backward, np.asarray(expected))


def surface_of(position: Any, normal: Any, **more: Any) -> Surface:
    """A surface at points (h, w, 3) with these normals."""
    position = jnp.asarray(position)
    normal = jnp.broadcast_to(jnp.asarray(normal), position.shape)
    given = {"interpolated_normal": normal, "albedo": jnp.full(position.shape, 0.6), **more}
    face = jnp.zeros(position.shape[:2], jnp.int32)
    return Surface(position=position, normal=normal, face=face, mask=face == 0, **given)


def faces_at(clip: Any, faces: Any, places: Any) -> np.ndarray:
    """The nearest face at places of the window (h, w, 2), in normalized device coordinates; -1 for none."""
    clip, faces = np.asarray(clip), np.asarray(faces)
    seen, least = np.full(places.shape[:2], -1, np.int32), np.full(places.shape[:2], np.inf)
    for number, face in enumerate(faces):
        x, y, z, w = clip[face].T
        edges = [
            (x[j] - places[..., 0] * w[j]) * (y[k] - places[..., 1] * w[k])
            - (x[k] - places[..., 0] * w[k]) * (y[j] - places[..., 1] * w[j])
            for j, k in ((1, 2), (2, 0), (0, 1))
        ]
        share = np.stack(edges) / np.sum(edges, axis=0)
        depth = np.tensordot(z, share, 1) / np.tensordot(w, share, 1)
        nearer = (share > 0).all(axis=0) & (depth < least)
        seen[nearer], least[nearer] = number, depth[nearer]
    return seen


def centres(height: int, width: int) -> np.ndarray:
    """Centres of pixels, (h, w, 2), in normalized device coordinates."""
    y, x = (np.indices((height, width)) + 0.5) * 2 / np.array([height, width])[:, None, None] - 1
    return np.stack([x, y], axis=-1)


def numbers(seed: int, *shape: int, low: float = 0.0, high: float = 1.0) -> Any:
    """Random numbers in float64."""
    return as_float(np.random.default_rng(seed).uniform(low, high, shape))
