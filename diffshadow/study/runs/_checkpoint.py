"""Checkpoints of fits of shapes: a fit that was stopped goes on where it was."""

import contextlib
import hashlib
import time
import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np

from ... import fit, io
from ...config import Config, dump_resolved

_OF_SHAPE = ("vertices", "faces", "free", "u", "mean", "square", "best_vertices", "best_faces")
_ARRAYS = (*_OF_SHAPE, "lights", "light_mean", "light_square", "best_lights")
_NUMBERS = ("phase", "step", "crossings")


class Checkpoint:
    """The checkpoint of the run of a configuration, in a hidden file beside the run's folder."""

    def __init__(self, config: Config, folder: Path):
        shape = config.fit.shape
        self.file = folder.with_name(f".{folder.name}-checkpoint.npz")
        self._pause = 0.0 if shape is None else shape.seconds
        # Only the same configuration goes on; input files may have changed unnoticed.
        self._key = hashlib.sha256(dump_resolved(config).encode("utf-8", "backslashreplace")).hexdigest()
        self._written = time.monotonic()
        # The step that the file is of, once it is known.
        self._step: int | None = None

    def read(self) -> fit.ShapeState | None:
        """Where the fit was stopped; none if there is no checkpoint of this configuration, or a damaged one."""
        try:
            # From memory: given a damaged file, `np.load` leaves it open.
            with np.load(BytesIO(self.file.read_bytes()), allow_pickle=False) as stored:
                if str(stored["key"]) != self._key:
                    return None
                arrays = {name: stored[name] for name in _ARRAYS}
                numbers = {name: int(stored[name]) for name in _NUMBERS}
                losses = tuple(map(float, stored["losses"]))
                history = tuple((int(phase), float(loss)) for phase, loss in stored["history"])
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        self._step = len(history)
        return fit.ShapeState(**numbers, **arrays, losses=losses, history=history)

    def at(self, state: fit.ShapeState) -> None:
        """Writes `state` if the last checkpoint is old enough."""
        if time.monotonic() - self._written >= self._pause:
            self.write(state)

    def write(self, state: fit.ShapeState) -> None:
        """Writes `state`.

        **Raises** `FullDiskError` if no space is left; the last checkpoint then stays.
        """
        arrays = {name: getattr(state, name) for name in (*_ARRAYS, *_NUMBERS, "losses")}
        history = np.asarray(state.history, np.float64).reshape(-1, 2)
        self.file.parent.mkdir(parents=True, exist_ok=True)
        kept = "" if self._step is None else f"; the fit then continues after step {self._step}, which is kept"
        with io.naming_full_disks(self.file, kept), io.atomic_path(self.file) as temporary:
            np.savez(temporary, allow_pickle=False, key=self._key, history=history, **arrays)
        self._written, self._step = time.monotonic(), len(state.history)

    def remove(self) -> None:
        """Removes the file of a finished fit."""
        with contextlib.suppress(OSError):
            self.file.unlink()
