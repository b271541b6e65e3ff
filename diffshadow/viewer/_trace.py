"""Traces references while nothing moves: with few rays at first, then with more."""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Hashable, Iterator

from .. import reference, study
from ..config import Config
from ..geometry import Scene
from ..reference import Reference
from ..settings.reference import TracedReference

# Rays per pixel of the first picture, and by how much each next one has more.
_FIRST, _FACTOR = 4, 4
_MOST_KEPT = 8
_NICENESS = 10


class Tracer:
    """A thread that traces the reference that was asked for last, in several steps, each better than the one before.

    - `found`: called with the key of each new reference, in that thread.
    """

    def __init__(self, found: Callable[[Hashable], None]):
        self.found = found
        self._references: dict[Hashable, tuple[Reference, bool]] = {}
        self._wanted: tuple[Hashable, Config, Scene] | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._run, daemon=True, name="tracing").start()

    def reference(self, key: Hashable) -> Reference | None:
        """The best reference so far."""
        return self._references.get(key, (None, False))[0]

    def want(self, key: Hashable, config: Config, scene: Scene) -> None:
        """Traces the reference of `config`, in a `scene` with one light, unless that is done."""
        with self._changed:
            self._wanted = None if self._references.get(key, (None, False))[1] else (key, config, scene)
            self._changed.notify()

    def rest(self) -> None:
        """Stops: what was asked for is no longer shown."""
        with self._changed:
            self._wanted = None

    def _run(self) -> None:
        if sys.platform == "linux":
            # Of this thread alone, and the threads that it starts: drawing comes first.
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted is not None)
                wanted = self._wanted
            assert wanted is not None
            with contextlib.suppress(_AbandonedError):
                self._trace(*wanted)
            with self._changed:
                if self._wanted is wanted:
                    self._wanted = None

    def _trace(self, key: Hashable, config: Config, scene: Scene) -> None:
        def go_on(_: float) -> None:
            if self._wanted is None or self._wanted[0] != key:
                raise _AbandonedError

        section = config.reference
        assert isinstance(section, TracedReference)
        try:
            for samples in _steps(section, scene):
                how = {**section.how(config.seed), "samples": samples}
                self._publish(key, reference.trace_visibility(scene, **how, progress=go_on), is_last=False)
            self._publish(key, study.traced(config, scene, go_on), is_last=True)
        except ValueError:
            # The camera sees nothing.
            raise _AbandonedError from None

    def _publish(self, key: Hashable, made: Reference, *, is_last: bool) -> None:
        with self._changed:
            self._references.pop(key, None)
            self._references[key] = made, is_last
            while len(self._references) > _MOST_KEPT:
                del self._references[next(iter(self._references))]
        self.found(key)


class _AbandonedError(Exception):
    """The reference is no longer asked for."""


def _steps(section: TracedReference, scene: Scene) -> Iterator[int]:
    """The rays per pixel of the references before the last one."""
    samples = _FIRST * section.supersampling**2
    while scene.light.has_size and samples < section.samples:
        yield samples
        samples *= _FACTOR
