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
    """The learning curves, with a mark at the epoch of ``best.pt``. All values are in the picture, also
    those of a network that has hardly been trained."""
    epochs = [row["epoch"] for row in history]
    best = best_epoch(history)
    # Not by pyplot, which requires a display and holds all figures in memory.
    drawing = Figure(figsize=(10.0, 4.0), layout="constrained")
    axes = drawing.subplots(1, 3)
    for panel, name, label, color in zip(
        axes,
        ("loss", "validation_epsilon", "validation_delta"),
        ("training loss (of scaled extinction)", "relative error epsilon (1)", "mass error delta (1)"),
        ("tab:blue", "tab:red", "tab:green"),
    ):
        panel.plot(epochs, [row[name] for row in history], color=color, marker=mark(history))
        panel.axvline(best, color="black", linewidth=0.5, linestyle=":")
        panel.set(xlabel="epoch", ylabel=label)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    loss, epsilon, delta = axes
    loss.set_yscale("log")
    epsilon.set_yscale("log")
    # Linear where a trained network is; the delta of an untrained one may be -100.
    delta.set_yscale("symlog", linthresh=1.0)
    delta.axhline(0.0, color="black", linewidth=0.5)
    epsilon.set_title(f"validation clouds; best.pt: epoch {best}", fontsize="medium")
    return drawing


def mark(history: list[dict[str, float]]) -> str:
    """Markers of single values, which a line alone does not show."""
    return "o" if len(history) < 12 else ""


def best_epoch(history: list[dict[str, float]]) -> int:
    """The epoch with the smallest epsilon; the last one if there are several."""

    def epsilon(row: dict[str, float]) -> float:
        value = row["validation_epsilon"]
        return math.inf if math.isnan(value) else value

    return int(min(reversed(history), key=epsilon)["epoch"])
