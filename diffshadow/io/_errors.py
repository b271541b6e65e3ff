"""Errors and warnings of file input and output."""


class FileError(ValueError):
    """A file or folder cannot be read or written, or does not hold what was expected."""


class FileWarning(UserWarning):
    """A file was read, but not all of it, or not as it says."""


class MeshWarning(FileWarning):
    """A mesh file holds something besides triangles, which was left out."""


class ImageWarning(FileWarning):
    """An image file says something of its pixels that is not obeyed, or holds more than was read."""


class MeshError(Exception):
    """What is wrong with a mesh file and how to mend it, phrased to follow the file's name.

    The readers of the formats raise it; `load_mesh` puts the name in front.
    """


def damaged(reason: str) -> MeshError:
    return MeshError(f"is damaged: {reason}; export it again")
