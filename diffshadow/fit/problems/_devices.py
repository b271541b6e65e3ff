"""Divides the views of a fit among several devices."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.multihost_utils import process_allgather
from jax.sharding import AxisType, Mesh, NamedSharding
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Float

_VIEWS = "views"


def devices_of(asked: int, *, moves: bool = False) -> int:
    """The number of devices for a fit that requests `asked`; 0 requests all devices of all processes.

    **Raises** `ValueError` if there are fewer devices, if JAX has several processes and not all devices are used, or
    for more than one device if lights or meshes move (`moves`).
    """
    there, processes = jax.device_count(), jax.process_count()
    if asked > there:
        raise ValueError(
            f"devices is {asked}, and JAX sees {there} ({jax.default_backend()}); expected at most {there}: lower it, "
            "or set jax_num_cpu_devices before JAX starts"
        )
    if moves and (asked or there) > 1:
        raise ValueError(
            f"devices is {asked or there}, and lights or meshes move; expected 1: only fits of a technique are shared"
        )
    if processes > 1 and 1 < asked < there:
        raise ValueError(
            f"devices is {asked}, and {processes} processes of JAX have {there}; expected 0 or {there}, so that all "
            "share the fit, or 1 for a fit in each process"
        )
    return asked or there


def spread[T](tree: T, devices: int) -> T:
    """`tree`, with a part of the views on each device. Its arrays have a leading axis for views."""
    sharding = NamedSharding(_mesh(devices), P(_VIEWS))
    return jax.tree.map(lambda leaf: jax.device_put(leaf, sharding), tree)


def on_host(tree: Any) -> Any:
    """`tree` with its arrays in host memory. Arrays of several processes are gathered, so each process must call
    this."""

    def copied(leaf: Any) -> Any:
        is_here = not isinstance(leaf, jax.Array) or leaf.is_fully_addressable or leaf.is_fully_replicated
        return np.asarray(leaf if is_here else process_allgather(leaf, tiled=True))

    return jax.tree.map(copied, tree)


def on_each_device(function: Callable[[Any, Any], Any], shared: Any, views: Any, devices: int) -> Any:
    """The results of `function` for `shared` and each device's part of `views`, along a first axis of views."""
    dynamic, static = eqx.partition(shared, eqx.is_array)
    own = lambda shared, views: function(eqx.combine(shared, static), views)
    # The loops in `function` do not declare which of their values are the same on all devices.
    split = jax.shard_map(own, mesh=_mesh(devices), in_specs=(P(), P(_VIEWS)), out_specs=P(_VIEWS), check_vma=False)
    return split(dynamic, views)


def compressed(
    residuals: Sequence[Float[Array, "..."]], slopes: Sequence[Float[Array, "..."]], devices: int
) -> tuple[Float[Array, " r"], Float[Array, "r p"]]:
    """A residual vector and a Jacobian with few rows. They have the same normal equations as the images and slopes.

    **Arguments:** `residuals`, `slopes`: each stack's residuals (n, h, w), and their derivatives (p, n, h, w).

    Each device computes the triangular factor of its own part, so that no device needs the Jacobian of all views
    (Demmel et al., "Communication-optimal parallel and sequential QR and LU factorizations", SIAM Journal on Scientific
    Computing 34, 2012).
    """
    found = []
    for images, stacks in zip(residuals, slopes, strict=True):
        both = jnp.moveaxis(jnp.concatenate([stacks, images[None]]), 0, -1)
        parts = both.shape[0]
        if parts % devices == 0:
            found.append(on_each_device(lambda _, part: _triangle(part), (), both, devices))
        else:
            found.append(_triangle(both))
    rows = jnp.concatenate(found)
    return rows[:, -1], rows[:, :-1]


def _triangle(both: Float[Array, "n h w q"]) -> Float[Array, "k q"]:
    return jnp.linalg.qr(both.reshape(-1, both.shape[-1]), mode="r")


def _mesh(devices: int) -> Mesh:
    # JAX derives the shardings of all later operations.
    return jax.make_mesh((devices,), (_VIEWS,), (AxisType.Auto,), devices=jax.devices()[:devices])
