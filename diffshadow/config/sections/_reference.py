"""Sections of the reference."""

from typing import Annotated, Any, Literal

from pydantic import Field, Tag

from ._section import Section, Unit, by_type


class TracedReferenceConfig(Section):
    """A ray-traced reference."""

    type: Literal["traced"] = "traced"
    samples: Annotated[int, Unit("rays per pixel")] = Field(
        default=64, ge=1, le=65536, description="shadow rays per pixel"
    )
    sampler: Literal["sobol", "stratified"] = Field(default="sobol", description="how points of the light are chosen")
    blockers: Literal["casters", "all"] = Field(
        default="casters", description="meshes that block rays: those that cast, or all, also with casts: false"
    )
    supersampling: Annotated[int, Unit("camera rays per pixel side")] = Field(
        default=1,
        ge=1,
        le=8,
        description="camera rays along a pixel's side: 4 averages 4 x 4 per pixel; recommended for fits of poses",
    )

    def how(self, seed: int) -> dict[str, Any]:
        """The arguments of `reference.trace_visibility` besides the scene."""
        return {**self.model_dump(exclude={"type"}), "seed": seed}


class ImageReferenceConfig(Section):
    """A reference from an image file."""

    type: Literal["image"] = "image"
    path: str = Field(
        min_length=1,
        description="a visibility image (.npy, .png or .exr, linear, 1 where lit), relative to this file (in an "
        "override: to the current folder)",
    )


ReferenceConfig = Annotated[
    Annotated[TracedReferenceConfig, Tag("traced")] | Annotated[ImageReferenceConfig, Tag("image")], by_type("traced")
]
