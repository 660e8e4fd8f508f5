"""Data sets made by many processes: ``deepct dataset generate`` mapped over a dask cluster.

The program makes one share of the samples in each call; which samples those are it knows from
the plan in the data set's folder. So all that travels over the cluster is command lines, a
worker needs the program and the folders but not this package, and what was made is never made
again: not after a failure, nor by the next run.
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
"""How often a share is tried again, on whatever worker is free."""

SHARES_PER_THREAD = 4
"""Shares for each of the cluster's threads, so that all end at about the same time."""


@dataclass(frozen=True)
class Order:
    """Which data set, out of what, and where; all folders as every worker sees them."""

    recipe: Path
    simulations: Path
    out: Path
    deepct: str = "deepct"
    """The program, on the PATH of every worker or by its full path."""

    def command(self, verb: str, *flags: str) -> list[str]:
        """A command line of ``deepct dataset``; paths are absolute, for workers elsewhere."""
        # A name is looked up where it is called, a path is meant from here.
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
    """A client of the scheduler at ``address``, or of a cluster on this machine while it lasts.

    ``workers`` is the number of shares that are made at the same time on this machine, one for
    each core where it is ``None``. Tasks only start the program and wait for it, so they need
    no processes of Python.

    Raises :class:`InputError` where nothing answers at the address.
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
    """Make a whole data set on the workers of ``client`` and write its manifest here.

    A task of the cluster is a share, made on one thread; ``None`` makes as many as suit the
    cluster. A share that fails is tried again :data:`RETRIES` times. ``report`` gets a line
    after each.

    Raises :class:`InputError` with what the program said where it fails for good.
    """
    # What is wrong with the recipe shows here, before the cluster starts on it.
    report(_run(order.command("plan", "--quiet")).strip())
    shares = shares or SHARES_PER_THREAD * max(1, sum(client.nthreads().values()))
    commands = [
        order.command("generate", "--quiet", "--threads", "1", "--share", f"{number}/{shares}")
        for number in range(1, shares + 1)
    ]
    before, start = _samples(order.out), time.monotonic()
    # A function of Python's own: the workers need not have this package.
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
    report(_run(order.command("generate", "--quiet")).splitlines()[0])
    if made:
        report(f"{made} made by the cluster, {made / hours:.0f} per hour")


def _run(command: list[str]) -> str:
    """What a program says that runs on this machine."""
    process = _result(lambda: subprocess.run(command, capture_output=True, text=True, check=True))
    return process.stdout


def _result(
    call: Callable[[], subprocess.CompletedProcess[str]],
) -> subprocess.CompletedProcess[str]:
    """What a call of the program gives, its failure as the error that users see."""
    try:
        return call()
    except subprocess.CalledProcessError as problem:
        said = problem.stderr.strip() or f"ended with status {problem.returncode}"
        raise InputError(problem.cmd[0], said, "what is made already will be kept") from None
    except KilledWorker as problem:
        remedy = "give the workers more memory, or fewer threads each"
        raise InputError("cluster", f"workers died: {problem}", remedy) from None
    except OSError as problem:
        where = problem.filename or "deepct"
        raise InputError(where, problem.strerror or "cannot be run", GET_PROGRAM) from None


def _samples(folder: Path) -> int:
    return sum(1 for _ in (folder / "samples").glob("*.nc"))


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))
