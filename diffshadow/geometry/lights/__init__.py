"""Lights, one kind per file."""

from ._abstract import AbstractLight as AbstractLight
from ._abstract import Domain as Domain
from ._cascaded import CascadedLight as CascadedLight
from ._directional import DirectionalLight as DirectionalLight
from ._fitted import AbstractFittedLight as AbstractFittedLight
from ._matrix import MatrixLight as MatrixLight
from ._paged import PagedLight as PagedLight
from ._point import PointLight as PointLight
from ._pose import LightPose as LightPose
from ._pose import Vector as Vector
from ._rectangle import RectangleLight as RectangleLight
from ._spot import SpotLight as SpotLight
from ._warped import WarpedLight as WarpedLight
