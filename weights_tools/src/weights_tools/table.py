"""Learning curves as a table."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from weights_tools.checkpoint import write_whole


def write_table(history: list[dict[str, float]], folder: Path) -> None:
    """Write ``curves.csv`` with one row for each epoch."""
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, fieldnames=list(history[0]))
    writer.writeheader()
    writer.writerows(history)
    write_whole(folder / "curves.csv", table.getvalue().encode())
