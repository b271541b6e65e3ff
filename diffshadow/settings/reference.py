"""Settings of the ray-traced reference."""

from typing import Annotated, Any, Literal

from annotated_types import Len

from ._settings import Limits, Settings, Unit

Sampler = Literal["sobol", "stratified"]
"""How points of a light are chosen. Both converge equally fast; `"stratified"` works best with a square number."""


Blockers = Literal["casters", "all"]
"""Which meshes block rays: casters, or all of them."""


class Reference(Settings):
    """The visibility that a fit approaches."""

    type: Any


class TracedReference(Reference):
    """A ray-traced reference."""

    type: Literal["traced"] = "traced"
    # More gain nothing in float32.
    samples: Annotated[int, Limits(1, 1 << 16), Unit("rays per pixel"), "shadow rays per pixel"] = 64
    sampler: Annotated[Sampler, "how points of the light are chosen"] = "sobol"
    blockers: Annotated[Blockers, "meshes that block rays: casters, or all, also with casts: false"] = "casters"
    # More are not worth their memory.
    supersampling: Annotated[
        int,
        Limits(1, 8),
        Unit("camera rays per pixel side"),
        "camera rays along a pixel's side: 4 averages 4 x 4 per pixel; recommended for fits of poses",
    ] = 1

    def how(self, seed: int) -> dict[str, Any]:
        """The arguments of `reference.trace_visibility` besides the scene."""
        return {**{key: getattr(self, key) for key in self.each() if key != "type"}, "seed": seed}


class ImageReference(Reference):
    """A reference from an image file."""

    type: Literal["image"] = "image"
    path: Annotated[
        str,
        Len(1),
        "a visibility image (.npy, .png or .exr, linear, 1 where lit), relative to this file (in an override: to the "
        "current folder)",
    ]
