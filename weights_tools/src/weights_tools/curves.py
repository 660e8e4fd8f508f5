"""Learning curves as a table and as a figure."""

from __future__ import annotations

import io
import math
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from weights_tools.checkpoint import write_whole


def write_picture(history: list[dict[str, float]], folder: Path) -> None:
    """Write ``curves.png``: the loss, and epsilon and delta on the validation clouds."""
    picture = io.BytesIO()
    figure(history).savefig(picture, format="png", dpi=100)
    write_whole(folder / "curves.png", picture.getvalue())


def figure(history: list[dict[str, float]]) -> Figure:
    """The learning curves, with a mark at the epoch of ``best.pt``."""
    epochs = [row["epoch"] for row in history]
    # Not by pyplot, which requires a display and holds all figures in memory.
    drawing = Figure(figsize=(8.0, 4.0), layout="constrained")
    loss, score = drawing.subplots(1, 2)
    loss.semilogy(epochs, [row["loss"] for row in history], color="tab:blue")
    loss.set(xlabel="epoch", ylabel="training loss (of scaled extinction)")
    for name, meaning, color in (
        ("epsilon", "relative error", "tab:red"),
        ("delta", "mass error", "tab:green"),
    ):
        values = [row[f"validation_{name}"] for row in history]
        score.plot(epochs, values, color=color, label=f"{name}: {meaning}")
    score.set(xlabel="epoch", ylabel="score on validation clouds (1)", ylim=(-0.5, 1.5))
    score.axhline(0.0, color="black", linewidth=0.5)
    best = best_epoch(history)
    score.axvline(best, color="black", linewidth=0.5, linestyle=":", label=f"best: epoch {best}")
    score.legend()
    for axes in (loss, score):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return drawing


def best_epoch(history: list[dict[str, float]]) -> int:
    """The epoch with the smallest epsilon; the last one if there are several."""

    def epsilon(row: dict[str, float]) -> float:
        value = row["validation_epsilon"]
        return math.inf if math.isnan(value) else value

    return int(min(reversed(history), key=epsilon)["epoch"])
