"""Does a sweep's runs in local worker processes, on a Dask cluster, or in this process.

Each local worker has one thread, so that one worker per core fills the machine without oversubscribing it.
"""

import logging
import os
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from typing import Any

import jax

from ... import io
from ..._memory import collect_rarely
from ..._xla import use_all_cores
from ..record._sweeps import Outcome
from ._apart import Returned, work_apart, write_returned
from ._code import PACKAGE, Code, asked_of, own_code
from ._inputs import Sender
from ._interrupts import POLL, deferred_interrupts, out_of_reach
from ._work import FAILED, Batch, work, write_outcome

# XLA takes the size of its thread pool from NPROC, and reads both variables when JAX is first used.
_ONE_THREAD = {
    "NPROC": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
}
# The most memory that a worker may need.
_BYTES_PER_WORKER = 1_500_000_000
# Seconds to wait for a scheduler.
_CONNECT_TIMEOUT = 15
# Seconds to wait for any answer from the address of a scheduler.
_ANSWER_TIMEOUT = 60
# Seconds to wait for the first worker, or for a new one after all have died. A busy machine is slow to start one. After
# so many of them, it is said what is awaited.
_WORKERS_TIMEOUT, _SAID_AFTER = 120, 10
# So many workers may die as they join, before any work is done, until that is an error.
_DEATHS = 3
# What a worker evaluates. A function of this package would end a worker that cannot import it, without a reason that
# reaches this process. Nor need a scheduler have this package.
_WORK_APART = "__import__('importlib').import_module(module).work_apart(*arguments)"
# Batches per worker that are submitted at once: enough to keep workers busy, few enough for sweeps of a million runs.
_BATCHES_AHEAD = 4


class InProcess:
    """Does the runs in this process, one after another."""

    workers = 1

    @property
    def programs(self) -> str | None:
        """The folder of compiled programs, which JAX already uses."""
        return None

    def outcomes(self, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """The outcomes of all runs, in order of completion."""
        for batch in batches:
            for run in batch.runs:
                yield from work(batch._replace(runs=(run,)))


class OnCluster:
    """Does the runs on the workers of a Dask client.

    **Arguments:**

    - `client`: the Dask client.
    - `interrupted`: called while waiting; it raises to stop the sweep.
    - `apart`: whether workers share no files with this process. Then inputs are sent to them, and what they return is
        written here.
    - `say`: called with what the sweep waits for, if that takes long.
    """

    def __init__(
        self,
        client: Any,
        interrupted: Callable[[], None] = lambda: None,
        *,
        apart: bool = False,
        say: Callable[[str], None] = lambda text: None,
    ):
        self._client, self._interrupted, self._say = client, interrupted, say
        self._sender = Sender(client) if apart else None
        self._checked: set[str] = set()
        self._died: set[str] = set()

    @property
    def programs(self) -> str | None:
        """The folder of compiled programs that workers use too; none if they have their own."""
        return None if self._sender else jax.config.jax_compilation_cache_dir

    @property
    def workers(self) -> int:
        """The number of runs that can be done at once."""
        return sum(self._client.nthreads().values())

    def outcomes(self, batches: Iterable[Batch]) -> Iterator[Outcome]:
        """The outcomes of all runs, in order of completion. If a worker dies, another one does its runs.

        **Raises** `OSError` if the scheduler or all workers are lost, or if a run cannot be written; `ValueError` if a
        worker does not have this code of the package.
        """
        from distributed import KilledWorker, as_completed

        to_come = iter(batches)
        waiting: dict[Any, Batch] = {}
        finished = as_completed()

        def submit(batch: Batch) -> None:
            task: tuple[Any, ...] = (_work_in_worker, batch)
            if self._sender is not None:
                arguments = tuple(own_code()), *self._sender.of(batch)
                task = eval, _WORK_APART, {"module": work_apart.__module__, "arguments": arguments}
            future = self._client.submit(*task, key=f"diffshadow-{uuid.uuid4().hex}", pure=False)
            waiting[future] = batch
            finished.add(future)

        def fill() -> None:
            # The number of workers is a question to the scheduler.
            most = _BATCHES_AHEAD * max(self.workers, 1)
            while len(waiting) < most and (batch := next(to_come, None)) is not None:
                self._interrupted()
                submit(batch)

        try:
            fill()
            while waiting:
                future = self._next(finished)
                batch = waiting.pop(future)
                try:
                    found = future.result()
                except KilledWorker:
                    if len(batch.runs) == 1:
                        yield _killed(batch)
                    else:
                        # One of the runs kills its worker. Submitted one by one, the others succeed.
                        for run in batch.runs:
                            submit(batch._replace(runs=(run,)))
                except CancelledError:
                    raise ConnectionError(
                        "the Dask scheduler is gone; expected it to run until the sweep ends: start the sweep again, "
                        "and only the missing runs are done"
                    ) from None
                except Exception:
                    # Other code may fail in any way, before it can say so.
                    if self._sender is not None:
                        self.check_versions(again=True)
                    raise
                else:
                    self._died.clear()
                    yield from found if self._sender is None else _written(batch, *found)
                fill()
        finally:
            self._client.cancel(list(waiting))

    def check_versions(self, *, again: bool = False) -> None:
        """**Raises** `ValueError` if a worker has another version or other sources of this package, or cannot import
        it.

        **Arguments:** `again`: whether to ask workers that were asked before.
        """
        there = set(self._client.nthreads()) - (set() if again else self._checked)
        if not there:
            return
        # A function that each Python has, so that workers load nothing of this package before it is compared.
        found = self._client.run(eval, asked_of(own_code().hash), workers=list(there), on_error="return")
        for address, answer in sorted(found.items()):
            if isinstance(answer, OSError):
                # The worker is gone.
                self._died.add(address)
            elif isinstance(answer, Exception):
                raise ValueError(f"the Dask worker at {address} cannot say which code it has: {answer}") from answer
            elif (fault := _difference(Code(*answer), own_code())) is not None:
                raise ValueError(
                    f"the Dask worker at {address} {fault}; then start the sweep again, and only the missing runs are "
                    "done"
                )
            else:
                self._checked.add(address)
        if len(self._died) >= _DEATHS:
            raise ValueError(
                f"{len(self._died)} Dask workers died as they were given work, the last at {max(self._died)}; expected "
                "workers that stay: see their logs, which say why"
            )

    def wait_for_workers(self, scheduler: str) -> None:
        """Waits for the first worker of the `scheduler` at this address.

        **Raises** `ValueError` if none joins in time.
        """
        began, is_said = time.monotonic(), False
        start = f"start it with dask worker {scheduler} --nthreads 1"
        while not self.workers:
            self._interrupted()
            waited = time.monotonic() - began
            if waited > _WORKERS_TIMEOUT:
                raise ValueError(
                    f"the Dask scheduler at {scheduler} has no workers after {_WORKERS_TIMEOUT} seconds; expected at "
                    f"least one: {start}"
                )
            if waited > _SAID_AFTER and not is_said:
                is_said = True
                self._say(f"waiting for a worker of the Dask scheduler at {scheduler}, which has none yet: {start}")
            time.sleep(POLL)

    def _next(self, finished: Any) -> Any:
        """The next finished future.

        **Raises** `OSError` if all workers are lost, and `ValueError` if those that join have other code, or die: Dask
        would wait forever.
        """
        last_seen, is_said = time.monotonic(), False
        while not finished.has_ready():
            self._interrupted()
            time.sleep(POLL)
            there = self._client.nthreads()
            if self._sender is not None and not self._checked.issuperset(there):
                self.check_versions()
            if there:
                last_seen, is_said = time.monotonic(), False
            elif time.monotonic() - last_seen > _WORKERS_TIMEOUT:
                raise ConnectionError(
                    f"all Dask workers are gone, and no new one started within {_WORKERS_TIMEOUT} seconds; expected "
                    "at least one: find out why they died (too little memory?), then start the sweep again, and only "
                    "the missing runs are done"
                )
            elif time.monotonic() - last_seen > _SAID_AFTER and not is_said:
                is_said = True
                self._say("all Dask workers are gone: waiting for a new one")
        return next(finished)


def _difference(there: Code, here: Code) -> str | None:
    """How the code of a worker differs from the code here, and how to mend it; none if it does not."""
    if not there.version:
        return f"does not have {PACKAGE}; expected {here.version}, as here: {_install(here)}"
    if there.version != here.version:
        return (
            f"has {PACKAGE} {there.version}; expected {here.version}, as here: {_install(here)} (the hash of its "
            f"sources is {there.hash or 'unknown'}, and {here.hash} here)"
        )
    if there.hash and there.hash != here.hash:
        return (
            f"has other code of {PACKAGE} {there.version}, whose sources have the hash {there.hash}; expected "
            f"{PACKAGE} {here.version} with {here.hash}, as here: install the same code there"
        )
    if there.fault:
        reason = f"({there.fault}); expected that it can: install there what it lacks"
        return f"cannot import {PACKAGE} {there.version} {reason}"
    return None


def _install(code: Code) -> str:
    return f"install it there (pip install {PACKAGE}=={code.version})"


def _written(batch: Batch, runs: Sequence[Returned], references: Mapping[str, bytes]) -> Iterator[Outcome]:
    """The outcomes of `runs` that were done elsewhere, each after it is written here."""
    for key, content in references.items():
        io.keep_content(key, content)
    for run in runs:
        write_returned(batch, run)
        yield run.outcome


def _work_in_worker(batch: Batch) -> list[Outcome]:
    """`work` in a worker process that is set up as the command is."""
    use_all_cores()
    collect_rarely()
    return work(batch)


@contextmanager
def pool(
    scheduler: str | None, workers: int | None, most: int, say: Callable[[str], None] = lambda text: None
) -> Iterator[InProcess | OnCluster]:
    """Opens the pool that does the runs.

    **Arguments:**

    - `scheduler`: address of a Dask scheduler; by default local workers are started.
    - `workers`: number of local worker processes; by default one per core, as far as memory allows. With 0, all runs
        are done in this process.
    - `most`: the most local workers to start by default.
    - `say`: called with what the sweep waits for, if that takes long.

    **Raises** `ValueError` if there is no scheduler at the address, it has no workers, or one of them has other code of
    this package.
    """
    if scheduler is None and workers == 0:
        yield InProcess()
        return
    begun = time.monotonic()
    with deferred_interrupts() as interrupted:

        def wait() -> None:
            interrupted()
            # Dask has no timeout for the first answer.
            if scheduler is not None and time.monotonic() - begun > _ANSWER_TIMEOUT:
                raise _no_scheduler(scheduler, "the server there does not answer")

        opened = lambda: _local(most, workers) if scheduler is None else _reached(scheduler)
        with out_of_reach(opened, wait) as client:
            where = OnCluster(client, interrupted, apart=scheduler is not None, say=say)
            if scheduler is not None:
                where.wait_for_workers(scheduler)
                # `putenv`, since XLA reads the C environment. No effect if the worker has already used JAX.
                for name, value in _ONE_THREAD.items():
                    client.run(os.putenv, name, value)
                where.check_versions()
            yield where


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
            # Any free port, on this machine only: several sweeps may run at once.
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

    return max(1, min(CPU_COUNT, MEMORY_LIMIT // _BYTES_PER_WORKER))


@contextmanager
def _reached(scheduler: str) -> Iterator[Any]:
    """A client of the scheduler at an address."""
    from distributed import Client

    # In two steps, so that it can be closed if it cannot connect. Dask would close it when it is garbage collected,
    # which may wait for a lock for ever if that happens while another client or cluster starts.
    client = Client.__new__(Client)
    try:
        Client.__init__(client, scheduler, timeout=_CONNECT_TIMEOUT)
    except Exception as error:  # many types: Dask may read another server's answer as the length of a message
        client.close()
        raise _no_scheduler(scheduler, str(error)) from error
    with client:
        yield client


def _no_scheduler(address: str, reason: str) -> ValueError:
    return ValueError(
        f"there is no Dask scheduler at {address!r} ({reason}); expected an address such as tcp://host:8786: start one "
        "with dask scheduler, or leave out --scheduler to use only this machine"
    )


def _killed(batch: Batch) -> Outcome:
    (run,) = batch.runs
    error = "its worker died at every attempt, perhaps for lack of memory"
    outcome = Outcome(id=run.id, status=FAILED, error=error, metrics={}, seconds={})
    write_outcome(batch.folder, run, outcome, batch.settings.run)
    return outcome
