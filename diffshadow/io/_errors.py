"""Errors and warnings of file input and output."""


class FileError(ValueError):
    """A file or folder cannot be read or written, or does not hold what was expected."""


class MeshWarning(UserWarning):
    """A mesh file holds something besides triangles, which was left out, or its coordinates are rounded."""


class MeshError(Exception):
    """What is wrong with a mesh file and how to mend it, phrased to follow the file's name.

    The readers of the formats raise it; `load_mesh` puts the name in front.
    """


def damaged(reason: str) -> MeshError:
    return MeshError(f"is damaged: {reason}; export it again")
