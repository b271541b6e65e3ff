"""Reads meshes, scenes and images; writes meshes, scenes, images and cached results."""

from ._arrays import ArrayLayout as ArrayLayout
from ._arrays import read_arrays as read_arrays
from ._atomic import atomic_path
from ._atomic import check_writable as check_writable
from ._cache import cache_folder, cache_size, clear_cache, keep_compiled_programs
from ._cache import cache_key as cache_key
from ._cache import cached_arrays as cached_arrays
from ._cache import cached_content as cached_content
from ._cache import keep_content as keep_content
from ._cache import programs_folder as programs_folder
from ._cache import prune_cache as prune_cache
from ._errors import FileError, FileWarning, ImageWarning, MeshWarning
from ._errors import FullDiskError as FullDiskError
from ._errors import is_full_disk as is_full_disk
from ._errors import naming_full_disks as naming_full_disks
from ._images import read_picture, read_visibility, write_animation, write_png, write_visibility
from ._looks import Picture as Picture
from ._looks import png_of as png_of
from ._meshes import coarse_steps as coarse_steps
from ._meshes import files_of_mesh as files_of_mesh
from ._meshes import load_mesh
from ._paths import existing_file as existing_file
from ._paths import reading_copies as reading_copies
from ._ply import write_ply
from ._trimesh import suffix_of_others as suffix_of_others
from ._write_gltf import write_gltf
from .scenes._parts import SceneCamera, SceneFile, SceneLight, SceneMesh, SceneShadow
from .scenes._read import read_scene

__all__ = [
    "FileError",
    "FileWarning",
    "ImageWarning",
    "MeshWarning",
    "SceneCamera",
    "SceneFile",
    "SceneLight",
    "SceneMesh",
    "SceneShadow",
    "atomic_path",
    "cache_folder",
    "cache_size",
    "clear_cache",
    "keep_compiled_programs",
    "load_mesh",
    "read_picture",
    "read_scene",
    "read_visibility",
    "write_animation",
    "write_gltf",
    "write_ply",
    "write_png",
    "write_visibility",
]


def __dir__() -> list[str]:
    return __all__
