"""Where a sweep's runs are done: in local worker processes, on a Dask cluster, or in this process.

A local worker has one thread, so that as many workers as cores share the machine without getting in each other's way.
"""

import logging
import os
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Any

from ..._xla import use_all_cores
from ._interrupts import POLL, deferred_interrupts, out_of_reach
from ._work import FAILED, Batch, Outcome, work, write_outcome

# XLA makes a pool of as many threads as NPROC says, and reads both when JAX is first used.
_ONE_THREAD = {
    "NPROC": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
}
# What a worker may need at the most.
_BYTES_A_WORKER = 1_500_000_000
# Seconds to wait for a scheduler, and for its first worker.
_PATIENCE = 15
# Seconds to wait for whatever is at the address of a scheduler to answer at all.
_SILENCE = 60
# Seconds to wait for a worker once all have died: a busy machine takes long to start one.
_WORKERS_PATIENCE = 120
# Batches for each worker that are under way at once: enough that none waits, few enough that a million runs fit.
_AHEAD = 4


class InProcess:
    """Does the runs here, one after another."""

    workers = 1

    def outcomes(self, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """The outcomes of all runs, as they come."""
        for batch in batches:
            for run in batch.runs:
                yield from work(batch._replace(runs=(run,)))


class OnCluster:
    """Does the runs on the workers of a Dask client.

    **Arguments:**

    - `interrupted`: called while it waits, to raise what ends it.
    """

    def __init__(self, client: Any, interrupted: Callable[[], None] = lambda: None):
        self._client, self._interrupted = client, interrupted

    @property
    def workers(self) -> int:
        """Runs that can be under way at once."""
        return sum(self._client.nthreads().values())

    def outcomes(self, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """The outcomes of all runs, as they come. What a worker that dies had begun is done by another.

        **Raises** `OSError` if the scheduler or all workers are lost or one cannot write, `ValueError` if one lacks
        this package.
        """
        from distributed import KilledWorker, as_completed

        to_come = iter(batches)
        waiting: dict[Any, Batch] = {}
        finished = as_completed()

        def submit(batch: Batch) -> None:
            future = self._client.submit(_work_in_worker, batch, key=f"diffshadow-{uuid.uuid4().hex}", pure=False)
            waiting[future] = batch
            finished.add(future)

        def fill() -> None:
            while len(waiting) < _AHEAD * max(self.workers, 1) and (batch := next(to_come, None)) is not None:
                self._interrupted()
                submit(batch)

        try:
            fill()
            while waiting:
                future = self._next(finished)
                batch = waiting.pop(future)
                try:
                    yield from future.result()
                except KilledWorker:
                    if len(batch.runs) == 1:
                        yield _killed(batch)
                    else:
                        # One of them kills its worker; alone, the others get through.
                        for run in batch.runs:
                            submit(batch._replace(runs=(run,)))
                except CancelledError:
                    raise ConnectionError(
                        "the Dask scheduler is gone; expected it to stay until the sweep ends: start the sweep again, "
                        "and only what is missing is done"
                    ) from None
                except ModuleNotFoundError as error:
                    raise ValueError(
                        f"a Dask worker cannot load this package ({error}); expected diffshadow of this version to be "
                        "installed wherever workers run"
                    ) from error
                fill()
        finally:
            self._client.cancel(list(waiting))

    def _next(self, finished: Any) -> Any:
        """The next run's future. **Raises** `OSError` if workers die and none comes: Dask would wait for ever."""
        last_seen = time.monotonic()
        while not finished.has_ready():
            self._interrupted()
            time.sleep(POLL)
            if self.workers:
                last_seen = time.monotonic()
            elif time.monotonic() - last_seen > _WORKERS_PATIENCE:
                raise ConnectionError(
                    f"all Dask workers are gone, and for {_WORKERS_PATIENCE} seconds none has come; expected at least "
                    "one: see why they died (too little memory?), then start the sweep again, and only what is missing "
                    "is done"
                )
        return next(finished)


def _work_in_worker(batch: Batch) -> list[Outcome]:
    """`work`, by a process of its own, whose programs are compiled as the command's are."""
    use_all_cores()
    return work(batch)


@contextmanager
def pool(scheduler: str | None, workers: int | None, most: int) -> Iterator[InProcess | OnCluster]:
    """Where runs are to be done.

    **Arguments:**

    - `scheduler`: address of a Dask scheduler; local workers if left out.
    - `workers`: local worker processes: by default one for each core, as far as there is memory for them. With 0, all
        runs are done in this process.
    - `most`: how many of them are worth starting by default.

    **Raises** `ValueError` if there is no scheduler at the address, or it has no workers.
    """
    if scheduler is None and workers == 0:
        yield InProcess()
        return
    begun = time.monotonic()
    with deferred_interrupts() as interrupted:

        def wait() -> None:
            interrupted()
            # Dask sets no limit to how long it waits for the first answer.
            if scheduler is not None and time.monotonic() - begun > _SILENCE:
                raise _no_scheduler(scheduler, "what is there does not answer")

        opened = lambda: _local(most, workers) if scheduler is None else _reached(scheduler)
        with out_of_reach(opened, wait) as client:
            yield OnCluster(client, interrupted)


@contextmanager
def _local(most: int, workers: int | None) -> Iterator[Any]:
    """A client of workers on this machine."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=min(_workers(), most) if workers is None else workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,
            # Any free port, seen from here alone: several sweeps may run on one machine.
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
            env={**_ONE_THREAD, "XLA_FLAGS": f"{os.environ.get('XLA_FLAGS', '')} {_ONE_THREAD['XLA_FLAGS']}".strip()},
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def _workers() -> int:
    from dask.system import CPU_COUNT
    from distributed.system import MEMORY_LIMIT

    return max(1, min(CPU_COUNT, MEMORY_LIMIT // _BYTES_A_WORKER))


@contextmanager
def _reached(scheduler: str) -> Iterator[Any]:
    """A client of the scheduler at an address."""
    from distributed import Client

    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except Exception as error:  # Dask takes the answer of another server for the length of a message, for one.
        raise _no_scheduler(scheduler, str(error)) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            raise ValueError(
                f"the Dask scheduler at {scheduler} has no workers; expected at least one: start it with dask worker "
                f"{scheduler} --nthreads 1"
            ) from error
        # XLA asks the C library for it. Too late, and harmless, where a worker has used JAX before.
        for name, value in _ONE_THREAD.items():
            client.run(os.putenv, name, value)
        yield client


def _no_scheduler(address: str, reason: str) -> ValueError:
    return ValueError(
        f"there is no Dask scheduler at {address!r} ({reason}); expected an address such as tcp://host:8786: start one "
        "with dask scheduler, or leave --scheduler out to work on this machine alone"
    )


def _killed(batch: Batch) -> Outcome:
    (run,) = batch.runs
    error = "its worker died each time that it was tried, perhaps for lack of memory"
    outcome = Outcome(run.id, FAILED, error, {}, {})
    write_outcome(batch.folder, run, outcome)
    return outcome
