"""Meshes, cameras, lights and the transforms between their spaces."""

from ..settings.techniques import CascadeSelection
from ._arrange import Arranged as Arranged
from ._arrange import Given as Given
from ._arrange import Wanted as Wanted
from ._arrange import angles_of as angles_of
from ._arrange import arrange as arrange
from ._arrange import turn_up as turn_up
from ._camera import AbstractCamera, MatrixCamera, OrthographicCamera, PinholeCamera, orbit_eye
from ._camera_pose import CameraPose
from ._edges import NO_NEIGHBOUR as NO_NEIGHBOUR
from ._edges import Edges
from ._edges import share_vertices as share_vertices
from ._framing import ROOM_FOV as ROOM_FOV
from ._framing import FrameLight as FrameLight
from ._framing import Lens as Lens
from ._framing import sun as frame_sun
from ._ground import stands_on_z as stands_on_z
from ._ground import up_of as up_of
from ._ground import y_up as y_up
from ._library import LIBRARY, OptionError, library_mesh
from ._matrices import eye_of as eye_of
from ._mesh import Mesh, MeshLike, as_mesh, face_normals, merge
from ._mesh import face_colours as face_colours
from ._normals import crease_normals, weld
from ._origin import WORLD, Origin, PrecisionWarning
from ._origin import origin_of as origin_of
from ._origin import step_of as step_of
from ._pages import Pages as Pages
from ._pages import Tile as Tile
from ._pages import cell_of as cell_of
from ._pages import finest_of as finest_of
from ._pages import side_of as side_of
from ._placement import drop_to_ground, fit_to_size
from ._scene import Scene
from ._smoothing import Smoothing as Smoothing
from ._subdivide import split_in_four
from ._textures import NO_TEXTURE, Textures
from ._textures import Sampler as Sampler
from ._textures import linear_colours as linear_colours
from ._textures import read_texels as read_texels
from ._textures import sampler_codes as sampler_codes
from ._textures import scaled_cutoff as scaled_cutoff
from ._transforms import (
    frame,
    look_at,
    orthographic,
    perspective,
    rotation,
    scaling,
    transform_points,
    transform_vectors,
    translation,
)
from ._transforms import infinite_far as infinite_far
from ._transforms import rotation_less_one as rotation_less_one
from ._transforms import tangents as tangents
from ._vector import Vector as Vector
from ._view import View
from ._warp import Warp as Warp
from .lights import AbstractLight, DirectionalLight, LightPose, MatrixLight, PointLight, RectangleLight, SpotLight
from .lights import Domain as Domain

__all__ = [
    "LIBRARY",
    "NO_TEXTURE",
    "WORLD",
    "AbstractCamera",
    "AbstractLight",
    "CameraPose",
    "CascadeSelection",
    "DirectionalLight",
    "Edges",
    "LightPose",
    "MatrixCamera",
    "MatrixLight",
    "Mesh",
    "MeshLike",
    "OptionError",
    "Origin",
    "OrthographicCamera",
    "PinholeCamera",
    "PointLight",
    "PrecisionWarning",
    "RectangleLight",
    "Scene",
    "SpotLight",
    "Textures",
    "View",
    "as_mesh",
    "crease_normals",
    "drop_to_ground",
    "face_normals",
    "fit_to_size",
    "frame",
    "library_mesh",
    "look_at",
    "merge",
    "orbit_eye",
    "orthographic",
    "perspective",
    "rotation",
    "scaling",
    "split_in_four",
    "transform_points",
    "transform_vectors",
    "translation",
    "weld",
]


def __dir__() -> list[str]:
    return __all__
