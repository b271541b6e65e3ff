"""Traces references of pages at rest: with few rays at first, then with more."""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any, NamedTuple

from .. import reference, study
from ..geometry import Scene
from ..reference import Reference

# Rays per pixel of the first picture, and by how much each next one has more.
_FIRST, _FACTOR = 4, 4
_MOST_KEPT = 8
_NICENESS = 10


class Asked(NamedTuple):
    """A reference: `key` is what it depends on, and `how` the arguments of `reference.trace_visibility`."""

    key: Hashable
    scene: Scene
    how: Mapping[str, Any]


class Tracer:
    """A thread that traces the references that pages ask for, one after another. Each gets better in several steps.

    - `found`: called with the key of each new reference, in that thread.
    """

    def __init__(self, found: Callable[[Hashable], None]):
        self.found = found
        self._references: dict[Hashable, tuple[Reference, bool]] = {}
        # What each page asks for.
        self._asked: dict[Hashable, Asked] = {}
        self._changed = threading.Condition()
        threading.Thread(target=self._run, daemon=True, name="tracing").start()

    def reference(self, key: Hashable) -> Reference | None:
        """The best reference so far."""
        return self._references.get(key, (None, False))[0]

    def want(self, page: Hashable, key: Hashable, scene: Scene, how: Mapping[str, Any]) -> None:
        """Traces what `page` shows, unless that is done, after what other pages asked for before."""
        with self._changed:
            self._asked.pop(page, None)
            if not self._references.get(key, (None, False))[1]:
                self._asked[page] = Asked(key, scene, how)
            self._changed.notify()

    def rest(self, page: Hashable) -> None:
        """Stops: `page` no longer shows what it asked for."""
        with self._changed:
            self._asked.pop(page, None)

    def _run(self) -> None:
        if sys.platform == "linux":
            # Of this thread alone, and the threads that it starts: drawing comes first.
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._asked)
                asked = next(iter(self._asked.values()))
            with contextlib.suppress(_AbandonedError):
                self._trace(asked)
            with self._changed:
                self._asked = {page: each for page, each in self._asked.items() if each is not asked}

    def _trace(self, asked: Asked) -> None:
        key, scene, how = asked

        def go_on(_: float) -> None:
            if not any(each is asked for each in self._asked.values()):
                raise _AbandonedError

        if self._references.get(key, (None, False))[1]:
            # Another page has asked for the same.
            return
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
