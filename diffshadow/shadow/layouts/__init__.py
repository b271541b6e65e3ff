"""How a shadow map's texels are laid out over the scene, one way per file."""

from ._abstract import AbstractLayout as AbstractLayout
from ._abstract import Choice as Choice
from ._cascades import Cascades as Cascades
from ._resolution_matched import ResolutionMatched as ResolutionMatched
from ._single import SingleMap as SingleMap
from ._warped import PerspectiveWarp as PerspectiveWarp
