"""The errors and warnings that reading and writing files ends in."""


class FileError(ValueError):
    """A file or folder cannot be read or written, or holds something else than was expected of it."""


class MeshWarning(UserWarning):
    """A mesh file holds something beside triangles, which was left out."""


class MeshError(Exception):
    """What is wrong with a mesh file and what to do about it, as the end of a sentence that begins with its name.

    Readers of one format raise it; `load_mesh` adds the name.
    """


def damaged(reason: str) -> MeshError:
    return MeshError(f"is damaged: {reason}; export it again")
