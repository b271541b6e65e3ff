"""The section that says what the truth is."""

from typing import Annotated, Literal

from pydantic import Field, Tag

from ._section import Section, Unit, by_type


class TracedReferenceConfig(Section):
    """Ray-traced truth."""

    type: Literal["traced"] = "traced"
    samples: Annotated[int, Unit("rays a pixel")] = Field(default=64, ge=1, le=65536, description="shadow rays a pixel")
    sampler: Literal["sobol", "stratified"] = Field(default="sobol", description="how points of the light are chosen")
    supersampling: Annotated[int, Unit("camera rays a pixel's side")] = Field(
        default=1,
        ge=1,
        le=8,
        description="4 gives each pixel the mean over 4 x 4 points; fits of poses want it",
    )


class ImageReferenceConfig(Section):
    """Truth from a file."""

    type: Literal["image"] = "image"
    path: str = Field(
        min_length=1,
        description="a visibility image, relative to this file (in an override: to the current folder)",
    )


ReferenceConfig = Annotated[
    Annotated[TracedReferenceConfig, Tag("traced")] | Annotated[ImageReferenceConfig, Tag("image")], by_type("traced")
]
