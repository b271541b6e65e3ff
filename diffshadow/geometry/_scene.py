"""A scene: meshes, a camera and lights."""

from collections.abc import Iterable

import equinox as eqx

from ._camera import AbstractCamera
from ._mesh import Mesh
from .lights import AbstractLight


def _as_tuple(lights: AbstractLight | Iterable[AbstractLight]) -> tuple[AbstractLight, ...]:
    return (lights,) if isinstance(lights, AbstractLight) else tuple(lights)


class Scene(eqx.Module):
    """What is drawn, from where, and lit by what.

    - `mesh`: every surface, each a caster and a receiver; `merge` makes one mesh of several.
    - `camera`: where the image is drawn from.
    - `lights`: what casts the shadows; one light or several, kept as a tuple.

    **Raises** `ValueError` if there is no light.
    """

    mesh: Mesh
    camera: AbstractCamera
    lights: tuple[AbstractLight, ...] = eqx.field(converter=_as_tuple)

    def __check_init__(self):
        if not self.lights:
            raise ValueError("the scene has no light; expected a light, or several in a sequence")

    @property
    def light(self) -> AbstractLight:
        """The scene's only light.

        **Raises** `ValueError` if there are several.
        """
        if len(self.lights) != 1:
            raise ValueError(
                f"the scene has {len(self.lights)} lights, and only one is expected here: take them one by one, each "
                "with lit_by(index)"
            )
        return self.lights[0]

    def lit_by(self, index: int) -> "Scene":
        """The scene with the light at `index` in `lights` alone.

        **Raises** `ValueError` if there is no such light.
        """
        if not 0 <= index < len(self.lights):
            raise ValueError(
                f"the scene has no light {index}; expected an index from 0 to {len(self.lights) - 1}, for it has "
                f"{len(self.lights)}"
            )
        return Scene(self.mesh, self.camera, self.lights[index])
