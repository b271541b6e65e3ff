"""Lights. Each kind has its own file."""

from ._abstract import AbstractLight as AbstractLight
from ._abstract import Domain as Domain
from ._directional import DirectionalLight as DirectionalLight
from ._matrix import MatrixLight as MatrixLight
from ._point import PointLight as PointLight
from ._pose import LightPose as LightPose
from ._rectangle import RectangleLight as RectangleLight
from ._spot import SpotLight as SpotLight
