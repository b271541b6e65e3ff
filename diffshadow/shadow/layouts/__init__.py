"""Layouts of a shadow map's texels over the scene. Each layout has its own file."""

from ._abstract import AbstractLayout as AbstractLayout
from ._abstract import Choice as Choice
from ._cascaded_light import CascadedLight as CascadedLight
from ._cascades import Cascades as Cascades
from ._figures import LayerFigure as LayerFigure
from ._figures import MapFigure as MapFigure
from ._fitted_light import AbstractFittedLight as AbstractFittedLight
from ._paged_light import PagedLight as PagedLight
from ._resolution_matched import ResolutionMatched as ResolutionMatched
from ._single import SingleMap as SingleMap
from ._warped import PerspectiveWarp as PerspectiveWarp
from ._warped_light import WarpedLight as WarpedLight
