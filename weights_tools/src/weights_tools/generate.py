"""Generation of data sets by many processes: ``deepct dataset generate`` on a dask cluster.

Each call of the program generates one share of the samples, which it determines from the plan in
the folder of the data set. Therefore only command lines are sent over the cluster, and a worker
needs the program and the folders, but not this package. Existing samples are never generated
again, neither after a failure nor by a later run.
"""

from __future__ import annotations

import logging
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from dask.system import CPU_COUNT
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from weights_tools.errors import InputError
from weights_tools.program import GET_PROGRAM

RETRIES = 2
"""Number of times that a failed share is repeated, on any free worker."""

SHARES_PER_THREAD = 4
"""Number of shares per thread of the cluster, so that all threads end at about the same time."""


@dataclass(frozen=True)
class Order:
    """Recipe, input and output of a data set. All workers must be able to access the folders."""

    recipe: Path
    simulations: Path
    out: Path
    deepct: str = "deepct"
    """The program: a name on the PATH of every worker, or a path."""

    def command(self, verb: str, *flags: str) -> list[str]:
        """A command line of ``deepct dataset``, with absolute paths for workers elsewhere."""
        # A name is looked up by the worker; a path is relative to the current folder.
        name = Path(self.deepct)
        return [
            self.deepct if len(name.parts) == 1 else str(name.absolute()),
            "dataset",
            verb,
            str(self.recipe.resolve()),
            *("--simulations", str(self.simulations.resolve())),
            *("--out", str(self.out.resolve())),
            *flags,
        ]


@contextmanager
def cluster(address: str | None, workers: int | None) -> Iterator[Client]:
    """A client of the scheduler at ``address``, or of a temporary local cluster if it is ``None``.

    ``workers`` is the number of shares that the local cluster generates at the same time; ``None``
    means one per core. The tasks only start the program and wait for it, so that threads suffice
    for the workers.

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


def generate(
    order: Order, client: Client, shares: int | None, report: Callable[[str], None]
) -> None:
    """Generate a data set on the workers of ``client`` and write its manifest.

    Each task of the cluster generates one of ``shares`` shares with one thread; by default there
    are :data:`SHARES_PER_THREAD` shares per thread. A share that fails is repeated up to
    :data:`RETRIES` times. ``report`` is called with a line of text after each share.

    Raises :class:`InputError` with the message of the program if a share fails repeatedly.
    """
    # This detects errors in the recipe before the cluster starts.
    report(_run(order.command("plan")).strip())
    shares = shares or SHARES_PER_THREAD * max(1, sum(client.nthreads().values()))
    commands = [
        order.command("generate", "--quiet", "--threads", "1", "--share", f"{number}/{shares}")
        for number in range(1, shares + 1)
    ]
    before, start = _samples(order.out), time.monotonic()
    # A function of the standard library, as the workers need not have this package.
    tasks = client.map(
        subprocess.run,
        commands,
        capture_output=True,
        text=True,
        check=True,
        retries=RETRIES,
        pure=False,
    )
    try:
        for done, task in enumerate(as_completed(tasks), start=1):
            _result(task.result)
            elapsed = time.monotonic() - start
            left = elapsed / done * (shares - done)
            report(f"share {done} of {shares}, {_clock(elapsed)} passed, {_clock(left)} left")
    finally:
        client.cancel(tasks)
    made, hours = _samples(order.out) - before, (time.monotonic() - start) / 3600.0
    report(_run(order.command("generate")).splitlines()[0])
    if made:
        report(f"{made} made by the cluster, {made / hours:.0f} per hour")


def _run(command: list[str]) -> str:
    """Run a command on this machine and return its standard output."""
    process = _result(lambda: subprocess.run(command, capture_output=True, text=True, check=True))
    return process.stdout


def _result(
    call: Callable[[], subprocess.CompletedProcess[str]],
) -> subprocess.CompletedProcess[str]:
    """The result of a call of the program; failures are converted to :class:`InputError`."""
    try:
        return call()
    except subprocess.CalledProcessError as problem:
        said = problem.stderr.strip() or f"ended with status {problem.returncode}"
        remedy = "a new run continues with the samples that exist"
        raise InputError(problem.cmd[0], said, remedy) from None
    except KilledWorker as problem:
        remedy = "give the workers more memory, or fewer threads each"
        raise InputError("cluster", f"workers were killed: {problem}", remedy) from None
    except OSError as problem:
        where = problem.filename or "deepct"
        raise InputError(where, problem.strerror or "cannot be run", GET_PROGRAM) from None


def _samples(folder: Path) -> int:
    return sum(1 for _ in (folder / "samples").glob("*.nc"))


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
