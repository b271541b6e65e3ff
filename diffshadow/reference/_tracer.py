"""What a reference needs of a ray tracer."""

import abc

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from .._types import HostArray
from ._rays import Hits, Rays


class AbstractTracer(abc.ABC):
    """Meets rays with the scene's triangles, in the tracing frame. Two-sided; safe to call from several threads."""

    dtype: type[np.floating]
    """Precision of the directions of shadow rays."""

    @abc.abstractmethod
    def closest(self, rays: Rays) -> Int[HostArray, "n"]:
        """The face that each of `rays` meets first within its reach, (n,); -1 for none."""

    @abc.abstractmethod
    def start(self, hits: Hits) -> Float64[HostArray, "n 3"]:
        """Where shadow rays from `hits` start so as not to meet their own surface, (n, 3)."""

    @abc.abstractmethod
    def occluded(
        self,
        origin: Float64[HostArray, "n 3"],
        face: Int[HostArray, "n"],
        which: Int[HostArray, "r"],
        direction: Float[HostArray, "r 3"],
        reach: float,
    ) -> Bool[HostArray, "r"]:
        """Whether anything lies in the way of shadow rays.

        **Arguments:**

        - `origin`: (n, 3), from `start`; `face`: (n,), the surfaces that rays leave.
        - `which`: (r,), the origin of each ray.
        - `direction`: (r, 3), of any length.
        - `reach`: the farthest occluder, in multiples of `direction`; may be infinite.
        """
