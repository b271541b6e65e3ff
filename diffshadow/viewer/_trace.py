"""Traces references while nothing moves: with few rays at first, then with more."""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any

from .. import reference, study
from ..geometry import Scene
from ..reference import Reference

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
        self._wanted: tuple[Hashable, Scene, Mapping[str, Any]] | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._run, daemon=True, name="tracing").start()

    def reference(self, key: Hashable) -> Reference | None:
        """The best reference so far."""
        return self._references.get(key, (None, False))[0]

    def want(self, key: Hashable, scene: Scene, how: Mapping[str, Any]) -> None:
        """Traces what `reference.trace_visibility` finds with arguments `how`, unless that is done."""
        with self._changed:
            self._wanted = None if self._references.get(key, (None, False))[1] else (key, scene, how)
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

    def _trace(self, key: Hashable, scene: Scene, how: Mapping[str, Any]) -> None:
        def go_on(_: float) -> None:
            if self._wanted is None or self._wanted[0] != key:
                raise _AbandonedError

        try:
            for samples in _steps(scene, **how):
                few = reference.trace_visibility(scene, **{**how, "samples": samples}, progress=go_on)
                self._publish(key, few, is_last=False)
            self._publish(key, study.trace(scene, how, go_on), is_last=True)
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


def _steps(scene: Scene, samples: int, supersampling: int, **_: Any) -> Iterator[int]:
    """The rays per pixel of the references before the last one."""
    few = _FIRST * supersampling**2
    while scene.light.has_size and few < samples:
        yield few
        few *= _FACTOR
