"""The code of this package: its version, a hash of its sources, and why it cannot be imported.

Workers of a cluster run the text of this module, which needs nothing but Python: their package may be another one.
"""

import functools
import hashlib
import importlib
import importlib.metadata
import importlib.util
import sys
from pathlib import Path
from typing import NamedTuple

PACKAGE = "diffshadow"
# What workers import when they are given work.
_NEEDED, _OWN = f"{PACKAGE}.study.sweeps._apart", f"{PACKAGE}.study.sweeps._code"
# Files that figures depend on.
_SUFFIXES = (".py", ".json")
# The digits of a hash in messages, and in what is compared.
_DIGITS = 12


class Code(NamedTuple):
    """The code of the package.

    - `version`: empty if it is not installed; `hash`: hash of its sources, empty if they are not found.
    - `fault`: why it cannot be imported; empty if it can, or if that was not tried.
    """

    version: str
    hash: str
    fault: str = ""


def code_of() -> Code:
    """The version and the sources of the package, without importing it.

    The hash is of the files' paths and contents, so that it is the same for a wheel and a clone.
    """
    try:
        version = importlib.metadata.version(PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        version = ""
    try:
        found = importlib.util.find_spec(PACKAGE)
    except (ImportError, ValueError):
        found = None
    if found is None or not found.submodule_search_locations:
        return Code(version, "", f"No module named {PACKAGE!r}")
    root, digest = Path(next(iter(found.submodule_search_locations))), hashlib.sha256()
    for file in sorted(root.rglob("*"), key=lambda file: file.relative_to(root).parts):
        if file.suffix in _SUFFIXES and file.is_file():
            # A clone may have other ends of lines.
            content = file.read_bytes().replace(b"\r\n", b"\n")
            digest.update(f"{'/'.join(file.relative_to(root).parts)}:{len(content)}:".encode() + content)
    return Code(version, digest.hexdigest()[:_DIGITS])


@functools.cache
def own_code() -> Code:
    """The code of this process."""
    return code_of()


def imported_code(here: str) -> Code:
    """The code of a process once it has imported what workers need. The package is imported only if its sources have
    the hash `here`."""
    if _OWN in sys.modules:
        # A process keeps what it has imported, whatever becomes of the files.
        return sys.modules[_OWN].own_code()
    found = code_of()
    if found.fault or found.hash != here:
        return found
    try:
        importlib.import_module(_NEEDED)
        return sys.modules[_OWN].own_code()
    except Exception as error:  # a package may fail in any way
        reason = " ".join(str(error).split())
        return found._replace(fault=f"{type(error).__name__}: {reason}" if reason else type(error).__name__)


def asked_of(here: str) -> str:
    """A Python expression whose value is `imported_code(here)` as a tuple, wherever it is evaluated."""
    text = Path(__file__).read_text(encoding="utf-8")
    run = f"(exec({text!r}, names), tuple(names['imported_code']({here!r})))"
    return f"(lambda names: {run}[1])({{'__name__': 'code'}})"
