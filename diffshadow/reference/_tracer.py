"""The interface of ray tracers."""

import abc

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from .._types import HostArray
from ._rays import Hits, Rays


class AbstractTracer(abc.ABC):
    """Intersects rays with the scene's triangles, in the tracing frame. Two-sided and thread-safe."""

    dtype: type[np.floating]
    """Precision of shadow ray directions."""

    @abc.abstractmethod
    def closest(self, rays: Rays) -> Int[HostArray, " n"]:
        """The first face that each of `rays` hits within its reach, (n,); -1 for none."""

    @abc.abstractmethod
    def start(self, hits: Hits) -> Float64[HostArray, "n 3"]:
        """The origins of shadow rays from `hits`, placed so as not to hit their own surface, (n, 3)."""

    @abc.abstractmethod
    def occluded(
        self,
        origin: Float64[HostArray, "n 3"],
        face: Int[HostArray, " n"],
        which: Int[HostArray, " r"],
        direction: Float[HostArray, "r 3"],
        reach: float,
    ) -> Bool[HostArray, " r"]:
        """Whether shadow rays are occluded.

        **Arguments:**

        - `origin`: (n, 3), from `start`; `face`: (n,), the faces of the scene's mesh that rays start on.
        - `which`: (r,), the index of each ray's origin.
        - `direction`: (r, 3), of any length.
        - `reach`: the greatest distance of an occluder, in multiples of `direction`; may be infinite.
        """
