"""The one kind of error that reading and writing files ends in."""


class FileError(ValueError):
    """A file or folder cannot be read or written, or holds something else than was expected of it."""
