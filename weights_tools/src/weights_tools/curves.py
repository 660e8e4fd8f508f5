"""Learning curves as a table and as a picture."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from weights_tools.checkpoint import write_whole


def write_table(history: list[dict[str, float]], folder: Path) -> None:
    """Write ``curves.csv``, a row for every epoch."""
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, fieldnames=list(history[0]))
    writer.writeheader()
    writer.writerows(history)
    write_whole(folder / "curves.csv", table.getvalue().encode())


def write_picture(history: list[dict[str, float]], folder: Path) -> None:
    """Draw ``curves.png``: the loss, and epsilon and delta on the validation clouds."""
    # Without pyplot, which would want a display and keep every figure.
    from matplotlib.figure import Figure

    epochs = [row["epoch"] for row in history]
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    loss, score = figure.subplots(1, 2)
    loss.semilogy(epochs, [row["loss"] for row in history], color="tab:blue")
    loss.set(xlabel="epoch", ylabel="training loss")
    for name, color in (("epsilon", "tab:red"), ("delta", "tab:green")):
        values = [row[f"validation_{name}"] for row in history]
        score.plot(epochs, values, color=color, label=name)
    score.set(xlabel="epoch", ylabel="validation score", ylim=(-0.5, 1.5))
    score.axhline(0.0, color="black", linewidth=0.5)
    score.legend()
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=100)
    write_whole(folder / "curves.png", picture.getvalue())
