"""Lines of text in any encoding, and the numbers on them."""

import codecs
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float, Int

from .._types import HostArray
from ._errors import damaged

# UTF-32 comes first, because its mark begins with the mark of UTF-16.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
# The maximum number of characters of a line that a message quotes.
_EXCERPT = 40
# The maximum number of characters of a list of names in a message.
_LIST = 160


def decode(data: bytes) -> str:
    """Decodes text of unknown encoding that begins with an ASCII character.

    A byte order mark gives the encoding. Without a mark, the encoding is UTF-16 if the first or second byte is zero,
    UTF-8 if the bytes are valid, and otherwise Latin-1, where any bytes are valid. Only comments and names have
    characters other than ASCII.
    """
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, errors="replace")
    if len(data) >= 2 and 0 in data[:2] and data[:2] != b"\0\0":
        return data.decode("utf-16-le" if data[1] == 0 else "utf-16-be", errors="replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def split_lines(text: str) -> list[str]:
    """The lines of `text`, stripped, with `#` comments removed and tabs replaced by spaces."""
    # `splitlines` would also split at characters that occur in Latin-1 comments.
    lines = text.replace("\r\n", "\n").replace("\r", "\n").replace("\t", " ").split("\n")
    if "#" in text:
        lines = [line.partition("#")[0] for line in lines]
    return [line.strip() for line in lines]


def excerpt(line: str) -> str:
    """`line`, quoted and shortened."""
    return repr(_short(line, _EXCERPT))


def listed(names: Iterable[str]) -> str:
    """`names`, separated by commas and shortened to fit a message."""
    return _short(", ".join(names), _LIST)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else text[:most] + "..."


def read_points(
    lines: Sequence[str], at: Sequence[int], first: int, numbers: Sequence[int] | None = None
) -> Float[HostArray, "n 3"]:
    """Reads three numbers, starting at word `first`, from each of the n lines with indices `at`.

    **Arguments:**

    - `numbers`: each line's number for errors; by default counted from 1.

    **Raises** `MeshError` if a line has fewer than three numbers, or a word that is not a number.
    """
    words = [word for i in at for word in lines[i].split(None, first + 3)[first : first + 3]]
    try:
        return parsed(words).reshape(len(at), 3)
    except ValueError:
        for i in at:
            row = lines[i].split()[first : first + 3]
            if len(row) < 3 or not all(map(is_number, row)):
                number = i + 1 if numbers is None else numbers[i]
                raise damaged(f"line {number} is {excerpt(lines[i])}; expected three numbers") from None
        raise


def parsed(words: Sequence[str] | Sequence[bytes]) -> Float[HostArray, " n"]:
    """Parses `words`. **Raises** `ValueError` if one of them is not a number."""
    return np.fromiter(map(float, words), np.float64, len(words))


def integers(words: Sequence[str]) -> Int[HostArray, " n"]:
    """Parses `words`. **Raises** `ValueError` if one of them is not a whole number of 64 bits."""
    try:
        return np.fromiter(map(int, words), np.int64, len(words))
    except OverflowError as error:
        raise ValueError(str(error)) from error


def is_number(word: str | bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
