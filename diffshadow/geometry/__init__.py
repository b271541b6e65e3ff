"""Meshes, cameras, lights and the transforms between their spaces."""

from ._camera import AbstractCamera as AbstractCamera
from ._camera import OrthographicCamera as OrthographicCamera
from ._camera import PinholeCamera as PinholeCamera
from ._camera import orbit_eye as orbit_eye
from ._library import LIBRARY as LIBRARY
from ._library import library_mesh as library_mesh
from ._lights import AbstractLight as AbstractLight
from ._lights import DirectionalLight as DirectionalLight
from ._lights import SpotLight as SpotLight
from ._mesh import Mesh as Mesh
from ._mesh import face_normals as face_normals
from ._mesh import merge as merge
from ._normals import crease_normals as crease_normals
from ._normals import weld as weld
from ._placement import drop_to_ground as drop_to_ground
from ._placement import fit_to_size as fit_to_size
from ._scene import Scene as Scene
from ._transforms import look_at as look_at
from ._transforms import orthographic as orthographic
from ._transforms import perspective as perspective
from ._transforms import rotation as rotation
from ._transforms import scaling as scaling
from ._transforms import transform_points as transform_points
from ._transforms import transform_vectors as transform_vectors
from ._transforms import translation as translation
from ._view import View as View
