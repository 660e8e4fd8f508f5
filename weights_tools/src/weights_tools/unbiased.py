"""Removal of the mean error of the total extinction by a larger scale of the output."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from weights_tools.errors import InputError

BIASED_SCORES = (
    "the scores of this scale are not measured: the file has those without --unbiased, as "
    "{name}_biased"
)
"""Explanation of the scores of :func:`unbiased_scale`."""


def unbiased_scale(
    output_scale: float, scores: Any, share: float, path: str | Path
) -> tuple[float, dict[str, Any]]:
    """The output scale (1/km) that removes a ``share`` (0 to 1) of the mean delta of the scores,
    and the scores of the original scale under the names ``{name}_biased``.

    Raises :class:`InputError` if the scores of the file ``path`` have no delta below 1.
    """
    delta = scores.get("delta") if isinstance(scores, dict) else None
    if not isinstance(delta, (int, float)) or not delta < 1.0:
        remedy = "give the scores with --metadata, or leave --unbiased out"
        raise InputError(path, f"its scores have a delta of {delta}", remedy)
    # The estimate has 1 - delta of the true total. Epsilon is not a function of the scale alone.
    scale = output_scale * (1.0 - (1.0 - share) * delta) / (1.0 - delta)
    return scale, {f"{name}_biased": score for name, score in scores.items()}
