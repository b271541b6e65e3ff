"""Silhouettes: the casters' outlines within the texels of a shadow map."""

from ._half_planes import WHOLE_TEXEL as WHOLE_TEXEL
from ._half_planes import HalfPlanes as HalfPlanes
from ._half_planes import Rectangle as Rectangle
from ._half_planes import cut_area as cut_area
from ._outline import Outline as Outline
from ._silhouette_map import NO_SILHOUETTE as NO_SILHOUETTE
from ._silhouette_map import SilhouetteMap as SilhouetteMap
from ._silhouette_map import find_silhouettes as find_silhouettes
