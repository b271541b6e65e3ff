"""The messages of a page: its settings and its view of them."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

View = Literal[
    "shaded", "visibility", "reference", "error", "acne and leaks", "shadow map", "light's view", "layers of the map"
]
"""The view that a picture shows."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
# The largest coordinate of a camera, in world units.
Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
Point = tuple[Coordinate, Coordinate, Coordinate]
# Names and keys have at most 256 characters.
Name = Annotated[str, Field(min_length=1, max_length=256)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Camera(_Message):
    """The camera of a page: `eye` and `target` in world units, and the image `height` of a parallel camera."""

    eye: Point
    target: Point
    height: Coordinate | None = None


class State(_Message):
    """The settings that a page shows.

    - `scene`: the name of a view of the fit, or `None` for the configuration's own scene.
    - `structure`: the changed values that require building, by dotted key.
    - `numbers`: the changed numbers that require no building, by dotted key.
    - `fitted`: the names of the numbers to fit, or `None` for the configuration's own.
    """

    scene: Name | None = None
    structure: dict[Name, JsonValue] = Field(default={}, max_length=64)
    numbers: dict[Name, Finite] = Field(default={}, max_length=1024)
    camera: Camera | None = None
    fitted: Annotated[tuple[Name, ...], Field(max_length=1024)] | None = None


class Look(_Message):
    """How a page views its settings.

    - `light`: the index of the light for views of a single light.
    - `split`: whether to show the picture before the changes next to this one, or the name of an engine to show with
      its defaults.
    """

    state: State
    view: View = "shaded"
    light: Annotated[int, Field(ge=0, lt=1024)] = 0
    split: bool | Name = False


class Message(_Message):
    """One message of a page. It has at least one part.

    - `look`: a picture to draw; `shown`: the number of the picture that the page has shown.
    - `save`, `code`, `fit`: the settings to write as YAML, to convert for engines, or to fit from.
    - `picture`: the picture to write as PNG.
    - `stop`: whether to stop the fit.
    """

    look: Look | None = None
    shown: int | None = None
    save: State | None = None
    code: Look | None = None
    picture: Look | None = None
    fit: State | None = None
    stop: bool = False
