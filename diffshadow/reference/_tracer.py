"""The interface of ray tracers."""

import abc

import numpy as np
from jaxtyping import Bool, Float64, Int

from .._types import HostArray
from ._rays import Hits, Rays, ShadowRays


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
    def occluded(self, rays: ShadowRays) -> Bool[HostArray, " r"]:
        """Whether shadow rays are occluded, (r,). They begin where `start` puts them."""
