"""Runs on a worker that shares no files with the sweep's process.

A batch takes along copies of its inputs, which are known by a hash of their content. The worker returns the files of
its runs. Figures and limits go through a folder of the worker's own, which has the sweep's path below a prefix. The
prefix is cut out of all that is returned, so that text names paths as the sweep's process does.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from ... import io
from ..._memory import collect_rarely
from ..._xla import use_all_cores
from ...config import SweepRun
from ..record._folder import remove
from ..record._sweeps import Outcome
from ._code import PACKAGE, own_code
from ._work import FIGURES, RUNS, Batch, do, files_of, write_files

# The folder of copies of input files, in the worker's own.
_COPIES = "inputs"


class Returned(NamedTuple):
    """A run that was done elsewhere: its outcome, and its files by their paths in the sweep's folder."""

    outcome: Outcome
    files: Mapping[str, bytes]


class WrongCodeError(RuntimeError):
    """A worker has another version of this package's code."""


def work_apart(
    code: tuple[str, ...],
    pickled: bytes,
    contents: Mapping[str, bytes],
    references: Mapping[str, bytes],
    missing: Sequence[str],
) -> tuple[list[Returned], dict[str, bytes]]:
    """Does the runs of a batch, in a worker process that is set up as the command is.

    **Arguments:**

    - `code`: this package's `Code` where the sweep was started.
    - `pickled`: a `Batch`, and the hash of each of its input files by path.
    - `contents`: the contents of these files by hash.
    - `references`: cached references by their keys; `missing`: the keys of references that are not cached.

    **Returns** the runs, and the missing references that are cached now.

    **Raises** `WrongCodeError` if this worker has different code; `FullDiskError` if it has no space left.
    """
    from distributed import get_worker
    from distributed.protocol.pickle import loads

    if tuple(own_code()) != code:
        raise WrongCodeError(str(own_code()))
    use_all_cores()
    collect_rarely()
    io.keep_compiled_programs()
    prefix = Path(get_worker().local_directory) / PACKAGE
    copies = {hash: _copied(prefix / _COPIES / hash, content) for hash, content in contents.items()}
    for key, content in references.items():
        io.keep_content(key, content)
    batch, hashes = loads(pickled)
    folder = Path(f"{prefix}{batch.folder}")
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with io.reading_copies({path: copies[hash] for path, hash in hashes.items()}):
            returned = [_done(batch._replace(folder=str(folder)), run, str(prefix)) for run in batch.runs]
    except io.FullDiskError as error:
        raise io.FullDiskError(f"{error} (on the Dask worker at {get_worker().address})") from error
    traced = {key: content for key in missing if (content := io.cached_content(key)) is not None}
    return returned, traced


def write_returned(batch: Batch, returned: Returned) -> None:
    """Writes the files of a run to the sweep's folder, each of its folders as a whole."""
    folders: dict[Path, dict[str, bytes]] = {}
    for name, content in returned.files.items():
        above, folder, file = Path(name).parts
        folders.setdefault(Path(batch.folder) / above / folder, {})[file] = content
    for folder, files in folders.items():
        write_files(folder, files)


def _copied(file: Path, content: bytes) -> Path:
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        with io.atomic_path(file) as temporary:
            temporary.write_bytes(content)
    return file


def _done(batch: Batch, run: SweepRun, prefix: str) -> Returned:
    """Does a run. Its figures are removed here."""
    outcome = do(batch, run)
    if outcome.error is not None:
        outcome = outcome.model_copy(update={"error": outcome.error.replace(prefix, "")})
    folder = Path(batch.folder)
    own = files_of(run, outcome, batch.settings.run)
    files = {f"{RUNS}/{run.id}/{name}": content for name, content in own.items()}
    for place in sorted((folder / FIGURES).glob(f"{run.id}*")) if batch.settings.figures else ():
        for file in sorted(place.iterdir()):
            files[str(file.relative_to(folder))] = file.read_bytes().replace(prefix.encode(), b"")
        remove(place)
    return Returned(outcome, files)
