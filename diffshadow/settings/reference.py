"""Settings of the ray-traced reference."""

from typing import Annotated, Any, Literal

from annotated_types import Len

from ._settings import InputFile, Limits, Settings, Unit

Sampler = Literal["sobol", "stratified"]
"""How points on a light are chosen. Both converge equally fast; `"stratified"` works best with a square number."""


Encoding = Literal["linear", "srgb"]
"""The encoding of a picture: linear colours, or sRGB colours from 0 to 1."""

Blockers = Literal["casters", "all"]
"""The meshes that block rays: casters, or all of them."""


class Reference(Settings):
    """The visibility that a fit approaches."""

    type: Any


class TracedReference(Reference):
    """A ray-traced reference."""

    type: Literal["traced"] = "traced"
    # More samples gain nothing in float32.
    samples: Annotated[int, Limits(1, 1 << 16), Unit("rays per pixel"), "shadow rays per pixel"] = 64
    sampler: Annotated[Sampler, "how points of the light are chosen"] = "sobol"
    blockers: Annotated[Blockers, "meshes that block rays: casters, or all, even those with casts: false"] = "casters"
    # More rays are not worth their memory.
    supersampling: Annotated[
        int,
        Limits(1, 8),
        Unit("camera rays per pixel side"),
        "camera rays along a pixel's side: 4 averages 4 x 4 per pixel; recommended for fits of poses",
    ] = 1

    def how(self, seed: int) -> dict[str, Any]:
        """The arguments of `reference.trace_visibility`, without the scene."""
        return {**{key: getattr(self, key) for key in self.each() if key != "type"}, "seed": seed}


class PictureReference(Reference):
    """A picture of the shaded scene. A fit finds the camera, lights, meshes and colours that reproduce it."""

    type: Literal["picture"] = "picture"
    path: Annotated[
        Annotated[str, Len(1)] | None,
        InputFile(),
        "a picture (.exr or .npy, linear; .png, sRGB), as large as the camera's image, relative to this file (in an "
        "override: to the current folder); default: a ray-traced picture of the scene, whose values are then the truth",
    ] = None
    mask: Annotated[
        Annotated[str, Len(1)] | None,
        InputFile(),
        "an image of the pixels that count, above 0.5; default: all of them",
    ] = None
    encoding: Annotated[Encoding | None, "of the picture's numbers; default: by the kind of its file"] = None
    exposure: Annotated[float, Limits(-20, 20), Unit("stops"), "by how much the drawn picture is brightened"] = 0.0
    samples: Annotated[int, Limits(1, 1 << 16), Unit("rays per pixel"), "shadow rays per pixel; without path only"] = 64
    supersampling: Annotated[
        int, Limits(1, 8), Unit("camera rays per pixel side"), "camera rays along a pixel's side; without path only"
    ] = 4

    def how(self, seed: int) -> dict[str, Any]:
        """The arguments of `reference.trace_visibility`, without the scene, for a run that compares visibility."""
        return {"samples": self.samples, "seed": seed}


class ImageReference(Reference):
    """A reference from an image file."""

    type: Literal["image"] = "image"
    path: Annotated[
        str,
        Len(1),
        InputFile(),
        "a visibility image (.npy, .png, .jpg or .exr, linear, 1 where lit), relative to this file (in an override: to "
        "the current folder)",
    ]
