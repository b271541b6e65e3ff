"""What a page asks for, as it sends it: the settings that it shows, and how it looks at them."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

View = Literal[
    "shaded", "visibility", "reference", "error", "acne and leaks", "shadow map", "light's view", "layers of the map"
]
"""What a picture shows."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
# As far as a camera may be, in world units.
Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
Point = tuple[Coordinate, Coordinate, Coordinate]
# Keys have fewer characters.
Name = Annotated[str, Field(min_length=1, max_length=256)]


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Camera(_Message):
    """Where the camera of a page is: `eye` and `target` in world units, and the `height` of a parallel one's image."""

    eye: Point
    target: Point
    height: Coordinate | None = None


class State(_Message):
    """The settings that a page shows.

    - `scene`: the name of a view of the fit; none for the configuration's own scene.
    - `structure`: what is built otherwise than in the configuration, by dotted key.
    - `numbers`: what is set otherwise, by dotted key, among the numbers that need no building.
    - `fitted`: the names of the numbers that a fit finds; none for the configuration's own.
    """

    scene: Name | None = None
    structure: dict[Name, JsonValue] = Field(default={}, max_length=64)
    numbers: dict[Name, Finite] = Field(default={}, max_length=1024)
    camera: Camera | None = None
    fitted: Annotated[tuple[Name, ...], Field(max_length=1024)] | None = None


class Look(_Message):
    """What a page wants to see of its settings.

    - `light`: the index of the light that single lights are shown of.
    - `split`: whether the picture before the changes is shown beside it; or the engine with whose defaults it is shown.
    """

    state: State
    view: View = "shaded"
    light: Annotated[int, Field(ge=0, lt=1024)] = 0
    split: bool | Name = False


class Message(_Message):
    """One message of a page: at least one of its parts.

    - `look`: a picture to draw; `shown`: the number of the picture that the page has shown.
    - `save`, `code`, `fit`: the settings to write as YAML, to convert for engines, or to fit from.
    - `picture`: what to write as PNG.
    - `stop`: whether to stop the fit.
    """

    look: Look | None = None
    shown: int | None = None
    save: State | None = None
    code: Look | None = None
    picture: Look | None = None
    fit: State | None = None
    stop: bool = False
