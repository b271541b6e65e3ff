"""Triangle soups of every awkward kind, in clip space."""

import jax
import numpy as np


def from_window(xy, z, w, resolution):
    """Clip coordinates of window positions (…, 2) in pixels, depth and w."""
    height, width = resolution
    ndc = np.concatenate([xy / [width, height], z[..., None]], axis=-1) * 2 - 1
    return np.concatenate([ndc, np.ones_like(z)[..., None]], axis=-1) * w[..., None]


def _around(rng, size, resolution):
    """Three corners within `size` pixels of a place in the view."""
    middle = rng.uniform([0, 0], resolution[::-1])
    return middle + rng.uniform(-size, size, (3, 2))


def _w(rng):
    return np.exp(rng.uniform(-3, 3, 3))


def tiny(rng, resolution):
    """A pixel across or less."""
    return from_window(_around(rng, 10 ** rng.uniform(-2, 0.5), resolution), rng.random(3), _w(rng), resolution)


def medium(rng, resolution):
    return from_window(_around(rng, rng.uniform(2, 20), resolution), rng.random(3), _w(rng), resolution)


def big(rng, resolution):
    """Larger than the view."""
    return from_window(_around(rng, 200, resolution), rng.random(3), _w(rng), resolution)


def sliver(rng, resolution):
    """Long, and a fraction of a pixel wide."""
    xy = _around(rng, rng.choice([5, 50, 2000]), resolution)
    t = rng.uniform(-0.5, 1.5)
    xy[2] = xy[0] + t * (xy[1] - xy[0]) + rng.normal(size=2) * 10 ** rng.uniform(-3, 0)
    return from_window(xy, rng.random(3), _w(rng), resolution)


def huge(rng, resolution):
    """Out of the guard band, up to a million pixels away."""
    xy = _around(rng, 10 ** rng.uniform(3, 6), resolution)
    if rng.random() < 0.5:
        xy[0] = rng.uniform([0, 0], resolution[::-1])
    return from_window(xy, rng.random(3), _w(rng), resolution)


def on_centres(rng, resolution):
    """Corners and edges exactly on pixel centres, or on the borders of pixels; depths of few values."""
    xy = np.round(_around(rng, 12, resolution) * 2) / 2
    return from_window(xy, rng.integers(0, 5, 3) / 4, np.exp2(rng.integers(-2, 3, 3)), resolution)


def in_space(rng, resolution):
    """Seen in perspective, anywhere round the eye: across the near plane, behind the eye, beyond the far plane."""
    near, far = 0.1, 10.0
    p = rng.normal(size=(3, 3)) * 10 ** rng.uniform(-1, 1.5)
    aspect = resolution[1] / resolution[0]
    z = -(far + near) / (far - near) * p[:, 2] - 2 * far * near / (far - near)
    return np.stack([p[:, 0] / aspect, p[:, 1], z, -p[:, 2]], axis=-1)


def floor(rng, resolution):
    """A vast triangle that passes under or over the eye."""
    near, far = 0.05, 2000.0
    angle = rng.uniform(0, 2 * np.pi) + np.array([0, 2, 4]) * np.pi / 3
    radius, height = 10 ** rng.uniform(0, 3), rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 0.5)
    p = np.stack([radius * np.cos(angle), np.full(3, height), radius * np.sin(angle)], axis=-1)
    z = -(far + near) / (far - near) * p[:, 2] - 2 * far * near / (far - near)
    return np.stack([p[:, 0], p[:, 1], z, -p[:, 2]], axis=-1)


def anything(rng, resolution):
    """Any clip coordinates, `w` of either sign."""
    return rng.normal(size=(3, 4))


def outside(rng, resolution):
    """Beyond the far plane, before the near plane, or beside the view, in part or wholly."""
    xy = _around(rng, rng.uniform(2, 60), resolution) + rng.choice([-80, 0, 80], 2)
    return from_window(xy, rng.uniform(-0.5, 1.5, 3) + rng.choice([-1, 0, 1]), _w(rng), resolution)


def degenerate(rng, resolution):
    """Without area, or with `w` of 0."""
    corners = medium(rng, resolution)
    kind = rng.integers(4)
    if kind == 0:
        corners[2] = corners[1]
    elif kind == 1:
        corners[:] = corners[0]
    elif kind == 2:
        corners[2] = (corners[0] + corners[1]) / 2
    else:
        corners[rng.integers(3), 3] = 0
    return corners


KINDS = (tiny, medium, big, sliver, huge, on_centres, in_space, floor, anything, outside, degenerate)


def soup(rng, count, resolution):
    """Clip coordinates (3 · count, 4), float32, of separate triangles, and the name of each one's kind."""
    chosen = rng.integers(len(KINDS), size=count)
    corners = np.stack([KINDS[k](rng, resolution) for k in chosen])
    return corners.reshape(-1, 4).astype(np.float32), [KINDS[k].__name__ for k in chosen]


def depth_rounding():
    """By how much the depths of two programs that draw the same may differ. The XLA of jax 0.11 rounds the depth of a
    plane differently in different programs."""
    return 0 if jax.__version_info__ >= (0, 12) else 1e-6
