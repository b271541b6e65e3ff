"""Traces references of pages at rest: with few rays at first, then with more."""

import os
import sys
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any, NamedTuple

from .. import reference, study
from ..geometry import Scene
from ..reference import Reference
from ._reasons import reason_of
from ._threads import start

# Rays per pixel of the first picture, and by how much each next one has more.
_FIRST, _FACTOR = 4, 4
_MOST_KEPT = 8
_NICENESS = 10


class Asked(NamedTuple):
    """A reference: `key` is what it depends on, and `how` the arguments of `reference.trace_visibility`."""

    key: Hashable
    scene: Scene
    how: Mapping[str, Any]


class Traced(NamedTuple):
    """What is known of a reference.

    - `reference`: with the most rays so far; none if there is none yet.
    - `is_last`: whether it gets no better.
    - `reason`: why there is none; empty otherwise.
    """

    reference: Reference | None = None
    is_last: bool = False
    reason: str = ""


class Tracer:
    """Traces the references that pages ask for, one after another, in a thread that lasts while there are any. Each
    gets better in several steps.

    - `found`: called with the key of each new reference, in that thread.
    """

    def __init__(self, found: Callable[[Hashable], None]):
        self.found = found
        self._known: dict[Hashable, Traced] = {}
        # What each page asks for.
        self._asked: dict[Hashable, Asked] = {}
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def known(self, key: Hashable) -> Traced:
        """What is known of the reference of `key`."""
        return self._known.get(key, Traced())

    def reference(self, key: Hashable) -> Reference | None:
        """The best reference so far."""
        return self.known(key).reference

    def want(self, page: Hashable, key: Hashable, scene: Scene, how: Mapping[str, Any]) -> None:
        """Traces what `page` shows, unless that is done, after what other pages asked for before. What it asks for
        already goes on."""
        with self._lock:
            asked = self._asked.get(page)
            if self._is_closed or (asked is not None and asked.key == key):
                return
            self._asked.pop(page, None)
            if self.known(key).is_last:
                return
            self._asked[page] = Asked(key, scene, how)
            if self._thread is None:
                self._thread = start(self._run, self.close, "tracing")

    def rest(self, page: Hashable) -> None:
        """Stops: `page` no longer shows what it asked for."""
        with self._lock:
            self._asked.pop(page, None)

    def close(self) -> None:
        """Stops for good."""
        with self._lock:
            self._is_closed = True
            self._asked.clear()

    def join(self) -> None:
        """Waits until nothing is traced."""
        thread = self._thread
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        if sys.platform == "linux":
            # Of this thread alone, and the threads that it starts: drawing comes first.
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        while True:
            with self._lock:
                asked = next(iter(self._asked.values()), None)
                if asked is None:
                    self._thread = None
                    return
            try:
                self._trace(asked)
            except _AbandonedError:
                continue
            with self._lock:
                self._asked = {page: each for page, each in self._asked.items() if each.key != asked.key}

    def _trace(self, asked: Asked) -> None:
        key, scene, how = asked

        def go_on(_: float) -> None:
            # Pages that show the same share it.
            if not any(each.key == key for each in [*self._asked.values()]):
                raise _AbandonedError

        before = self.reference(key)
        try:
            for samples in _steps(scene, **how):
                # It may have been abandoned after its first steps.
                if before is None or before.samples < samples:
                    few = reference.trace_visibility(scene, **{**how, "samples": samples}, progress=go_on)
                    self._publish(key, Traced(few))
            self._publish(key, Traced(study.trace(scene, how, go_on), is_last=True))
        except _AbandonedError:
            raise
        except Exception as error:
            # Such as a camera that sees nothing. Asking again would not help.
            self._publish(key, Traced(is_last=True, reason=reason_of(error)))

    def _publish(self, key: Hashable, made: Traced) -> None:
        with self._lock:
            self._known.pop(key, None)
            self._known[key] = made
            while len(self._known) > _MOST_KEPT:
                del self._known[next(iter(self._known))]
        self.found(key)


class _AbandonedError(Exception):
    """The reference is no longer asked for."""


def _steps(scene: Scene, samples: int, supersampling: int, **_: Any) -> Iterator[int]:
    """The rays per pixel of the references before the last one."""
    few = _FIRST * supersampling**2
    while scene.light.has_size and few < samples:
        yield few
        few *= _FACTOR
