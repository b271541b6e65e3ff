"""Techniques: algorithms that find the surfaces that a light reaches."""

import abc
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

from .._checks import CheckedModule
from .._types import Mask, Visibility
from ..geometry import Scene
from ..raster import Surface
from ..settings.engines import Side
from ._compare import AbstractCompare


class AbstractTechnique(CheckedModule):
    """Draws the shadows of a scene in two steps.

    `prepare` makes a state from the light's view: a shadow map, a texture, or the edges to extrude. `visibility` makes
    an image from the state. The state depends on meshes, light and, for some techniques, the camera. It does not depend
    on bias or filter, so one state works for all biases and filters.

    Each technique has its own class of state: `ShadowMapping` makes a `ShadowMap`, an engine's technique an
    `EngineMap`, `ProjectiveShadow` a `ProjectiveTexture`. Other techniques, including your own, may have their own
    class of state. Callers only pass it on.
    """

    @abc.abstractmethod
    def prepare(self, scene: Scene, surface: Surface | None = None) -> Any:
        """The technique's state, such as a `ShadowMap`, which is drawn once for the scene's only light.

        **Arguments:**

        - `surface`: the surface that `scene.camera` sees, for techniques that fit their maps to it. By default they
          draw it themselves. All other techniques ignore it.

        **Raises** `ValueError` if the scene has several lights, see `Scene.lit_by`.
        """

    @abc.abstractmethod
    def visibility(self, state: Any, surface: Surface) -> Visibility:
        """Visibility of the light at each pixel, (h, w): 1 lit, 0 shadowed.

        **Arguments:**

        - `state`: the result of `prepare`.
        - `surface`: the surface of `scene.mesh` that a camera sees. Pixels without a surface are lit.
        """

    @abc.abstractmethod
    def covered(self, state: Any, surface: Surface) -> Mask:
        """Pixels that the technique covers, (h, w). All other pixels have no surface, or a surface outside of the
        technique's maps."""

    def casting_sides(self, scene: Scene) -> tuple[Side | None, ...]:
        """The faces of each mesh that cast shadows, by the side that the light sees. `None` for a mesh that does not
        cast."""
        return of_casters(["double" for _ in scene.meshes], scene)


def of_casters(sides: Sequence[Side], scene: Scene) -> tuple[Side | None, ...]:
    """The `sides` of meshes that cast, and `None` for other meshes."""
    return tuple(one if casts else None for one, casts in zip(sides, scene.casts or (True,) * len(sides), strict=True))


@runtime_checkable
class FittableTechnique(Protocol):
    """A technique whose numbers can be fitted: it compares depths, and the compare can be soft."""

    @property
    def compare(self) -> AbstractCompare:
        """How depths are compared."""
        ...

    def lays_out(self, name: str) -> bool:
        """Whether the number at the dotted path `name` changes what `prepare` draws.

        Visibility has no useful derivative with respect to such a number.
        """
        ...

    def prepare(self, scene: Scene, surface: Surface | None = None) -> Any:
        """As for `AbstractTechnique`."""
        ...

    def visibility(self, state: Any, surface: Surface) -> Visibility:
        """As for `AbstractTechnique`."""
        ...

    def covered(self, state: Any, surface: Surface) -> Mask:
        """As for `AbstractTechnique`."""
        ...
