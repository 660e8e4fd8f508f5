"""The line that ``progress=True`` shows."""

import sys
import time
from typing import Any, Optional


class Line:
    """A line on the standard error that shows the state of a computation, at most twice a second."""

    _INTERVAL_S = 0.5

    def __init__(self) -> None:
        self._shown_s = 0.0
        self._length = 0
        self._latest: Optional[dict[str, Any]] = None

    def __call__(self, status: dict[str, Any]) -> None:
        self._latest = status
        now = time.monotonic()
        if now - self._shown_s >= self._INTERVAL_S:
            self._shown_s = now
            self._show(status)

    def _show(self, status: dict[str, Any]) -> None:
        text = _text(status)
        print("\r" + text.ljust(self._length), end="", file=sys.stderr, flush=True)
        self._length = len(text)

    def close(self) -> None:
        """End the line with the last state."""
        if self._latest is not None:
            self._show(self._latest)
            print(file=sys.stderr, flush=True)


def _text(status: dict[str, Any]) -> str:
    if "share" in status:
        text = f"render {status['share']:4.0%}"
        if status["samples"]:
            text += f", {status['samples']} photon paths per pixel, noise {status['noise']:.2%}"
        return text
    text = f"step {status['iteration']}, blocks of {status['block']}, misfit {status['misfit']:.3f}"
    if status["relative_error"] is not None:
        text += f", epsilon {status['relative_error']:.3f}"
    return text
