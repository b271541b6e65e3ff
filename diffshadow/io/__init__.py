"""Reads meshes, scenes and images; writes meshes, images and cached results."""

from ._arrays import Layout as Layout
from ._arrays import read_arrays as read_arrays
from ._atomic import atomic_path as atomic_path
from ._atomic import check_writable as check_writable
from ._cache import CACHE_LIMIT as CACHE_LIMIT
from ._cache import cache_folder as cache_folder
from ._cache import cache_key as cache_key
from ._cache import cache_size as cache_size
from ._cache import cached_arrays as cached_arrays
from ._cache import clear_cache as clear_cache
from ._cache import keep_compiled_programs as keep_compiled_programs
from ._cache import programs_folder as programs_folder
from ._cache import prune_cache as prune_cache
from ._errors import FileError as FileError
from ._errors import MeshWarning as MeshWarning
from ._images import read_visibility as read_visibility
from ._images import write_png as write_png
from ._images import write_visibility as write_visibility
from ._meshes import load_mesh as load_mesh
from ._ply import write_ply as write_ply
from .scenes._parts import SceneCamera as SceneCamera
from .scenes._parts import SceneFile as SceneFile
from .scenes._parts import SceneLight as SceneLight
from .scenes._parts import SceneMesh as SceneMesh
from .scenes._parts import SceneShadow as SceneShadow
from .scenes._read import read_scene as read_scene
