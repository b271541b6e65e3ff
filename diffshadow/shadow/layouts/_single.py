"""One map for the whole scene."""

from ...geometry import AbstractLight, PointLight
from .._shader import ShaderPart, text_of
from ._abstract import AbstractLayout, Choice


class SingleMap(AbstractLayout):
    """The light's own map, over the whole frustum of the light; for a point light, one layer for each face."""

    def light(self, light, camera, resolution, surface=None) -> AbstractLight:
        return light

    def choose(self, light, points) -> Choice:
        return Choice(light.layer(points))

    def shader(self, light) -> ShaderPart:
        faces = ["_cube.glsl"] if isinstance(light, PointLight) else []
        return ShaderPart((), text_of(*faces, "layouts/_single.glsl"))
