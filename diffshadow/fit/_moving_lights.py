"""Lights that are fitted together with a shape: their positions and directions.

All numbers of the lights are in one flat array. Steps are in degrees as seen from the shape: a position moves by an
angle times the light's distance.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from .._arithmetic import as_float
from .._types import HostArray
from ..geometry import AbstractLight, LightPose
from .problems import ShapeView

# The minimum change per degree of azimuth, for directions near the zenith, where azimuth has little effect.
_LEAST_COSINE = 0.1


class MovingLights(NamedTuple):
    """The lights of groups of views. Some of them move.

    - `groups`: for each group, its views' lights along a first axis.
    - `starts`: for each group, the numbers of the lights' poses, (n, k); `treedefs`: the structures of the poses.
    - `lengths`: (n, k), the change of each number per degree; 0 for fixed numbers.
    """

    groups: list[AbstractLight]
    starts: list[HostArray]
    treedefs: list[Any]
    lengths: list[HostArray]

    @classmethod
    def of(cls, groups: Sequence[ShapeView], middle: Float[HostArray, "3"]) -> "MovingLights":
        """Takes the poses of the lights of groups of views. `middle` is the centre of the shape, the origin of
        distances."""
        lights, starts, treedefs, lengths = [], [], [], []
        for group in groups:
            pose = _poses(group.light)
            leaves, treedef = jax.tree.flatten(pose)
            moves = np.asarray(group.moves, float)
            lights.append(group.light)
            starts.append(np.stack([np.asarray(leaf, float) for leaf in leaves], axis=-1) if leaves else moves[:, :0])
            treedefs.append(treedef)
            units = _degrees(pose, middle)
            lengths.append(np.stack([unit * moves for unit in units], axis=-1) if leaves else moves[:, :0])
        return cls(lights, starts, treedefs, lengths)

    @property
    def move(self) -> bool:
        """Whether any light moves."""
        return any(length.any() for length in self.lengths)

    @property
    def start(self) -> Float[HostArray, " m"]:
        """The numbers of all lights; empty if none moves."""
        return self._flat(self.starts) if self.move else np.zeros(0)

    def poses(self, numbers: Float[HostArray, " m"]) -> list[LightPose] | None:
        """The poses of each group's lights; `None` if no light moves."""
        if not self.move:
            return None
        return [
            jax.tree.unflatten(treedef, [as_float(column) for column in part.T])
            for treedef, part in zip(self.treedefs, self._parts(numbers), strict=True)
        ]

    def lights(self, numbers: Float[HostArray, " m"]) -> list[AbstractLight]:
        """Each group's lights in their poses."""
        poses = self.poses(numbers)
        return self.groups if poses is None else [_placed(*each) for each in zip(self.groups, poses, strict=True)]

    def in_degrees(self, gradient: Sequence[LightPose]) -> Float[HostArray, " m"]:
        """Converts the gradient with respect to the numbers into the gradient with respect to degrees; 0 for fixed
        numbers."""
        parts = [np.stack([np.asarray(leaf, float) for leaf in jax.tree.leaves(pose)], axis=-1) for pose in gradient]
        return self._flat([part * length for part, length in zip(parts, self.lengths, strict=True)])

    def moved(self, numbers: Float[HostArray, " m"], degrees: Float[HostArray, " m"]) -> Float[HostArray, " m"]:
        """The numbers after these changes in degrees."""
        return numbers + degrees * self._flat(self.lengths)

    def greatest(self, values: Float[HostArray, " m"]) -> Float[HostArray, " m"]:
        """The maximum value of each light, at each of its numbers."""
        spread = [
            np.broadcast_to(part.max(axis=1, keepdims=True, initial=0), part.shape) for part in self._parts(values)
        ]
        return self._flat(spread)

    def _parts(self, numbers: Float[HostArray, " m"]) -> list[HostArray]:
        ends = np.cumsum([start.size for start in self.starts])[:-1]
        return [part.reshape(own.shape) for part, own in zip(np.split(numbers, ends), self.starts, strict=True)]

    def _flat(self, parts: Sequence[HostArray]) -> Float[HostArray, " m"]:
        return np.concatenate([part.reshape(-1) for part in parts])


def _degrees(pose: LightPose, middle: Float[HostArray, "3"]) -> list[Float[HostArray, " n"]]:
    """The change per degree of each number of the lights' poses, in order. Sizes are fixed."""
    units = []
    if pose.position is not None:
        places = np.stack([np.asarray(each) for each in (pose.position.x, pose.position.y, pose.position.z)], axis=-1)
        units += [np.radians(np.linalg.norm(places - middle, axis=-1))] * 3
    if pose.azimuth is not None and pose.elevation is not None:
        cosine = np.abs(np.cos(np.radians(np.asarray(pose.elevation, float))))
        units += [1 / np.maximum(cosine, _LEAST_COSINE), np.ones_like(cosine)]
    return units if pose.radius is None else [*units, np.zeros(np.shape(pose.radius))]


@eqx.filter_jit
def _poses(lights: AbstractLight) -> LightPose:
    return jax.vmap(lambda light: light.pose())(lights)


@eqx.filter_jit
def _placed(lights: AbstractLight, poses: LightPose) -> AbstractLight:
    return jax.vmap(lambda light, pose: light.at(pose))(lights, poses)
