"""Bands about a value that is known."""

from __future__ import annotations

from .case import Band


def around(middle: float, share: float, more: float = 0.0) -> Band:
    """`middle` ± `share` of it ± `more`."""
    room = share * abs(middle) + more
    return Band(middle - room, middle + room)
