"""A scene: meshes, a camera and lights."""

import equinox as eqx

from ._camera import AbstractCamera
from ._lights import AbstractLight
from ._mesh import Mesh


class Scene(eqx.Module):
    """What is drawn, from where, and lit by what.

    - `mesh`: every surface, each a caster and a receiver; `merge` makes one mesh of several.
    - `camera`: where the image is drawn from.
    - `light`: what casts the shadows.
    """

    mesh: Mesh
    camera: AbstractCamera
    light: AbstractLight
