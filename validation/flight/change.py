"""How light that should stand still changes from frame to frame (failure-catalogue, "Temporal").

Lights are fixed and only the viewer moves, so every change is error. With E_k the irradiance at fixed points in frame k and Ē
their mean light:

    pop_k     = max over points and colours of |E_k - E_(k-1)| / Ē
    flicker_k = rms over points and colours of (E_(k+1) - 2 E_k + E_(k-1)) / Ē
    lag       = frames until the streamed light is within 1 % of Ē of what the whole texture says: the longest wait of any point
"""

from __future__ import annotations

import numpy as np

from ...reference.datatypes import F32, F64

PERCENTILE = 99.0
SETTLED = 0.01  # of the mean light: nearer than this counts as there


def jumps(before: F32, after: F32, scale: float) -> F64:
    """Largest change (N,) over the colours of irradiance (N, 3), over `scale`, W·m⁻²."""
    change = np.abs(after.astype(np.float64) - before.astype(np.float64))
    return np.asarray(change.max(axis=1, initial=0.0) / scale)


class Still:
    """The light at fixed points, frame after frame. worst (N,) f64: the largest pop of each point so far; pops, p99s, flickers: per
    frame from the second on, flickers from the third."""

    def __init__(self, points: int, scale: float) -> None:
        """points: N. scale: mean irradiance, W·m⁻², above 0."""
        self.worst = np.zeros(points)
        self.pops: list[float] = []
        self.p99s: list[float] = []
        self.flickers: list[float] = []
        self._scale = scale
        self._last: list[F32] = []

    def frame(self, irradiance: F32) -> None:
        """Take the irradiance (N, 3) of the next frame."""
        last = self._last
        if last:
            jump = jumps(last[-1], irradiance, self._scale)
            self.worst = np.maximum(self.worst, jump)
            self.pops.append(float(jump.max(initial=0.0)))
            self.p99s.append(float(np.percentile(jump, PERCENTILE)) if len(jump) else 0.0)
        if len(last) == 2:
            bend = irradiance.astype(np.float64) - 2.0 * last[1] + last[0]
            self.flickers.append(float(np.sqrt(np.mean(bend**2))) / self._scale)
        self._last = [*last[-1:], irradiance]


class Lag:
    """How long fixed points wait for their light. waiting (N,) i64: frames that each waits already; longest (N,): its longest wait."""

    def __init__(self, points: int, scale: float) -> None:
        """points: N. scale: mean irradiance, W·m⁻², above 0."""
        self.waiting = np.zeros(points, dtype=np.int64)
        self.longest = np.zeros(points, dtype=np.int64)
        self._scale = scale

    def frame(self, streamed: F32, whole: F32) -> None:
        """Take the irradiance (N, 3) of the next frame, as streamed and as the whole texture at the same level of detail has it."""
        late = jumps(whole, streamed, self._scale) > SETTLED
        self.waiting = np.where(late, self.waiting + 1, 0)
        self.longest = np.maximum(self.longest, self.waiting)
