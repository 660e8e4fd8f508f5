"""Commands of ``deepct`` on a dask cluster.

Only command lines are sent over the cluster. A worker therefore needs the program and the folders, under
the same names, but not this package. Existing results are never computed again, neither after a failure
nor by a later run.
"""

from __future__ import annotations

import logging
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from dask.system import CPU_COUNT
from distributed import Client, Future, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from weights_tools.errors import InputError
from weights_tools.program import GET_PROGRAM

RETRIES = 2
"""Number of times that a failed share is repeated, on any free worker."""

SHARES_PER_THREAD = 4
"""Number of shares per thread of the cluster, so that all threads end at about the same time."""

SHARED = ("dataset", "experiment")
"""The commands that have shares."""

Report = Callable[[str], None]
"""Is called with each line of text about the progress."""


@contextmanager
def cluster(address: str | None, workers: int | None) -> Iterator[Client]:
    """A client of the scheduler at ``address``, or of a temporary local cluster if it is ``None``.

    ``workers`` is the number of commands that the local cluster runs at the same time; ``None`` means
    one per core. The tasks only start the program and wait for it, so that threads suffice for the
    workers.

    Raises :class:`InputError` if there is no scheduler at the address.
    """
    if address is None:
        with (
            LocalCluster(
                n_workers=workers or CPU_COUNT,
                threads_per_worker=1,
                processes=False,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.ERROR,
            ) as local,
            Client(local) as client,
        ):
            yield client
        return
    try:
        client = Client(address)
    except (OSError, ValueError) as problem:
        raise InputError(address, str(problem), "name a running dask scheduler") from None
    with client:
        yield client


@dataclass(frozen=True)
class Program:
    """``deepct`` on the workers of a cluster."""

    client: Client
    report: Report
    name: str = "deepct"
    """A name on the PATH of every worker, or a path."""

    def here(self, words: Sequence[str]) -> str:
        """Run a command on this machine and return its standard output.

        Raises :class:`InputError` with the message of the program if it fails.
        """
        run = subprocess.run
        command = self._command(words)
        return _result(lambda: run(command, capture_output=True, text=True, check=True)).stdout

    def in_shares(self, words: Sequence[str], shares: int | None) -> str:
        """Run a command that has the option ``--share``, such as ``dataset generate`` or
        ``experiment``: each of ``shares`` shares as one task with one thread, and then, on this machine,
        the whole command, which collects the results. Returns the standard output of the last one.

        ``None`` stands for :data:`SHARES_PER_THREAD` shares per thread of the cluster. A share that fails
        is repeated up to :data:`RETRIES` times.

        Raises :class:`InputError` for another command, and with the message of the program if a share
        fails repeatedly.
        """
        if words[0] not in SHARED:
            problem = f"`{words[0]}` has no shares, which {' and '.join(SHARED)} have"
            raise InputError("distribute", problem, "give its files with --files and --out-dir")
        shares = shares or SHARES_PER_THREAD * max(1, sum(self.client.nthreads().values()))
        each = [[*words, "--share", f"{number}/{shares}"] for number in range(1, shares + 1)]
        start = time.monotonic()
        for number, task in self._tasks(each, RETRIES):
            _result(task.result)
            self.report(f"share {number} of {shares}, {_clock(start, number, shares)}")
        return self.here(words)

    def for_files(self, words: Sequence[str], files: Sequence[Path], folder: Path) -> None:
        """Run a command for each of the files as its only input, as one task with one thread, which writes
        a file of the same name to ``folder``. Files that exist there are left as they are. What fails is
        reported, and the other files are processed all the same.

        Raises :class:`InputError` if two files have the same name, or if any of them failed.
        """
        results = {path: folder / path.name for path in files}
        if len(set(results.values())) < len(results):
            raise InputError(folder, "is the output of two files of one name", "rename one of them")
        folder.mkdir(parents=True, exist_ok=True)
        left = [path for path, result in results.items() if not result.exists()]
        each = [[*words, str(path), "--out", str(results[path])] for path in left]
        failed, start = 0, time.monotonic()
        for number, task in self._tasks(each, 0):
            try:
                _result(task.result)
            except InputError as problem:
                failed += 1
                self.report(str(problem))
            self.report(f"file {number} of {len(left)}, {_clock(start, number, len(left))}")
        if failed:
            problem = f"{failed} of {len(files)} files failed"
            raise InputError(folder, problem, "see the messages above; a new run tries them again")

    def _command(self, words: Sequence[str]) -> list[str]:
        # A name is looked up by the worker; a path is relative to the current folder.
        name = Path(self.name)
        return [self.name if len(name.parts) == 1 else str(name.absolute()), *words]

    def _tasks(self, each: list[list[str]], retries: int) -> Iterator[tuple[int, Future]]:
        """The tasks of command lines as they end, counted from 1."""
        # A function of the standard library, as the workers need not have this package.
        tasks = self.client.map(
            subprocess.run,
            [self._command([*words, "--quiet", "--threads", "1"]) for words in each],
            cwd=str(Path.cwd()),
            capture_output=True,
            text=True,
            check=True,
            retries=retries,
            pure=False,
        )
        try:
            yield from enumerate(as_completed(tasks), start=1)
        finally:
            self.client.cancel(tasks)


def _result(
    call: Callable[[], subprocess.CompletedProcess[str]],
) -> subprocess.CompletedProcess[str]:
    """The result of a call of the program; failures are converted to :class:`InputError`."""
    try:
        return call()
    except subprocess.CalledProcessError as problem:
        said = problem.stderr.strip() or f"ended with status {problem.returncode}"
        raise InputError(problem.cmd[0], said, "a new run continues with what exists") from None
    except KilledWorker as problem:
        remedy = "give the workers more memory, or fewer threads each"
        raise InputError("cluster", f"workers were killed: {problem}", remedy) from None
    except OSError as problem:
        where = problem.filename or "deepct"
        raise InputError(where, problem.strerror or "cannot be run", GET_PROGRAM) from None


def _clock(start: float, done: int, total: int) -> str:
    """The time since ``start``, and that which is expected until all is done."""
    passed = time.monotonic() - start
    spans = [timedelta(seconds=round(span)) for span in (passed, passed / done * (total - done))]
    return f"{spans[0]} passed, {spans[1]} left"
