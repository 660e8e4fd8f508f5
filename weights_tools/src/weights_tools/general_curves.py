"""The learning curves of a general network as a figure."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from weights_tools.checkpoint import write_whole
from weights_tools.curves import mark


def write_picture(history: list[dict[str, float]], folder: Path) -> None:
    """Write ``curves.png``: the loss, and epsilon and delta for each formation of the validation,
    over the duration of the training."""
    minutes = [row["minutes"] for row in history]
    # Not by pyplot, which requires a display and holds all figures in memory.
    drawing = Figure(figsize=(10.0, 4.0), layout="constrained")
    loss, epsilon, delta = drawing.subplots(1, 3)
    loss.plot(minutes, [row["loss"] for row in history], color="tab:blue", marker=mark(history))
    loss.set(xlabel="minutes", ylabel="training loss")
    for axes, score, meaning in (
        (epsilon, "epsilon", "relative error epsilon (1)"),
        (delta, "delta", "mass error delta (1)"),
    ):
        names = [key for key in history[-1] if key.endswith(f"_{score}")]
        for name in names:
            label = name.removesuffix(f"_{score}").replace("_", "-")
            values = [row.get(name, float("nan")) for row in history]
            axes.plot(minutes, values, label=label, marker=mark(history))
        axes.set(xlabel="minutes", ylabel=meaning)
        axes.legend()
    delta.axhline(0.0, color="black", linewidth=0.5)
    picture = io.BytesIO()
    drawing.savefig(picture, format="png", dpi=100)
    write_whole(folder / "curves.png", picture.getvalue())
