"""Traces references for pages at rest, first with few rays and then with more."""

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

# Rays per pixel of the first reference, and the factor between references.
_FIRST, _FACTOR = 4, 4
_MOST_KEPT = 8
_NICENESS = 10


class Asked(NamedTuple):
    """A reference: `key` identifies it, and `how` has the arguments of `reference.trace_visibility`."""

    key: Hashable
    scene: Scene
    how: Mapping[str, Any]


class Traced(NamedTuple):
    """The state of a reference.

    - `reference`: the reference with the most rays so far, or `None`.
    - `is_last`: whether it has all its rays.
    - `reason`: why there is no reference; otherwise empty.
    """

    reference: Reference | None = None
    is_last: bool = False
    reason: str = ""


class Tracer:
    """Traces the references that pages request, one after another, in a thread that lives as long as there are
    requests. Each reference improves in several steps.

    - `found`: called in that thread with the key of each new reference.
    """

    def __init__(self, found: Callable[[Hashable], None]):
        self.found = found
        self._known: dict[Hashable, Traced] = {}
        # The request of each page.
        self._asked: dict[Hashable, Asked] = {}
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def known(self, key: Hashable) -> Traced:
        """The state of the reference of `key`."""
        return self._known.get(key, Traced())

    def reference(self, key: Hashable) -> Reference | None:
        """The best reference so far."""
        return self.known(key).reference

    def want(self, page: Hashable, key: Hashable, scene: Scene, how: Mapping[str, Any]) -> None:
        """Traces the reference of `page`, unless it is complete, after the earlier requests of other pages. A request
        that already exists continues."""
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
        """Cancels the request of `page`."""
        with self._lock:
            self._asked.pop(page, None)

    def close(self) -> None:
        """Stops permanently."""
        with self._lock:
            self._is_closed = True
            self._asked.clear()

    def join(self) -> None:
        """Waits until nothing is being traced."""
        thread = self._thread
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        if sys.platform == "linux":
            # Drawing comes first. The priority is that of this thread and of the threads that it starts.
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
            # Pages with the same settings share a reference.
            if not any(each.key == key for each in [*self._asked.values()]):
                raise _AbandonedError

        before = self.reference(key)
        try:
            for samples in _steps(scene, **how):
                # The request may have been cancelled after its first steps.
                if before is None or before.samples < samples:
                    few = reference.trace_visibility(scene, **{**how, "samples": samples}, progress=go_on)
                    self._publish(key, Traced(few))
            self._publish(key, Traced(study.trace(scene, how, go_on), is_last=True))
        except _AbandonedError:
            raise
        except Exception as error:
            # For example, the camera sees nothing. Another attempt would not help.
            self._publish(key, Traced(is_last=True, reason=reason_of(error)))

    def _publish(self, key: Hashable, made: Traced) -> None:
        with self._lock:
            self._known.pop(key, None)
            self._known[key] = made
            while len(self._known) > _MOST_KEPT:
                del self._known[next(iter(self._known))]
        self.found(key)


class _AbandonedError(Exception):
    """The reference is no longer requested."""


def _steps(scene: Scene, samples: int, supersampling: int, **_: Any) -> Iterator[int]:
    """The rays per pixel of all references except the last."""
    few = _FIRST * supersampling**2
    while scene.light.has_size and few < samples:
        yield few
        few *= _FACTOR
