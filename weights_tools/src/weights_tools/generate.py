"""Generation of data sets by many processes: ``deepct dataset generate`` on a dask cluster.

Each call of the program generates one share of the samples, which it determines from the plan in
the folder of the data set.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from weights_tools.cluster import Program


@dataclass(frozen=True)
class Order:
    """Recipe, input and output of a data set. All workers must be able to access the folders."""

    recipe: Path
    simulations: Path
    out: Path

    def words(self, verb: str) -> list[str]:
        """The words of a command of ``deepct dataset``."""
        folders = ["--simulations", str(self.simulations), "--out", str(self.out)]
        return ["dataset", verb, str(self.recipe), *folders]


def generate(order: Order, program: Program, shares: int | None = None) -> None:
    """Generate a data set on the workers of ``program`` and write its manifest.

    Each task of the cluster generates one of ``shares`` shares, see :meth:`Program.in_shares`.

    Raises :class:`InputError` with the message of the program if a share fails repeatedly.
    """
    # This detects errors in the recipe before the cluster starts.
    program.report(program.here(order.words("plan")).strip())
    before, start = _samples(order.out), time.monotonic()
    said = program.in_shares(order.words("generate"), shares)
    made, hours = _samples(order.out) - before, (time.monotonic() - start) / 3600.0
    program.report(said.splitlines()[0])
    if made:
        program.report(f"{made} made by the cluster, {made / hours:.0f} per hour")


def _samples(folder: Path) -> int:
    return sum(1 for _ in (folder / "samples").glob("*.nc"))
