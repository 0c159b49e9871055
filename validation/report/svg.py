"""A little SVG: elements with escaped text, logarithmic axes with readable ticks.

Only presentation attributes, never `style` (the page's content policy forbids it); lines and letters take `currentColor`,
so that a drawing suits a light and a dark page.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

MANTISSAS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0))


def tag(name: str, *inside: str, **attributes: str | float) -> str:
    """One element. `inside` is markup already; attribute names have `_` for `-`; values are escaped."""
    pairs = "".join(f' {key.rstrip("_").replace("_", "-")}="{_attribute(v)}"' for key, v in attributes.items())
    return f"<{name}{pairs}>{''.join(inside)}</{name}>" if inside else f"<{name}{pairs}/>"


def text(words: str, x: float, y: float, **attributes: str | float) -> str:
    """A line of text, escaped."""
    return tag("text", escaped(words), x=x, y=y, **attributes)


def escaped(words: str) -> str:
    """Text as markup."""
    return escape(printable(words))


def printable(words: str) -> str:
    """Text without what steers a terminal or turns the direction of reading: shown as visible signs instead."""
    shown = (chr(0x2400 + ord(c)) if ord(c) < 32 and c not in "\n\t" else c for c in words)
    return "".join("\ufffd" if _unprintable(ord(c)) else c for c in shown)


def _unprintable(code: int) -> bool:
    turning = 0x202A <= code <= 0x202E or 0x2066 <= code <= 0x2069 or code in (0x200E, 0x200F, 0x061C)
    return turning or 0x7F <= code <= 0x9F or 0xD800 <= code <= 0xDFFF


def _attribute(value: str | float) -> str:
    return escape(printable(value), quote=True) if isinstance(value, str) else f"{value:.2f}".rstrip("0").rstrip(".")


def ticks(low: float, high: float, binary: bool = False, most: int = 7) -> list[float]:
    """Round values within low..high (both > 0): 1-2-5, 1-3 or decades, or powers of two; the densest set of `most`."""
    if binary:
        first, last = math.ceil(math.log2(low)), math.floor(math.log2(high))
        step = max(1, math.ceil((last - first + 1) / most))
        return [2.0**k for k in range(first, last + 1, step)]
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for mantissas in reversed(MANTISSAS):
        found = [m * 10.0**d for d in decades for m in mantissas if low <= m * 10.0**d <= high]
        if len(found) <= most:
            return found
    return found[:: math.ceil(len(found) / most)]


def padded(values: list[float], factor: float) -> tuple[float, float]:
    """Range of positive values, widened by `factor` on both sides, at least a factor of 4 wide."""
    low, high = (min(values), max(values)) if values else (1.0, 1.0)
    widen = max(factor, 2.0 / math.sqrt(high / low))
    return low / widen, high * widen


@dataclass(frozen=True)
class LogScale:
    """Maps low..high (> 0) to pixels start..end, logarithmically; what lies outside is held at the edge."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """Pixel of `value`."""
        held = min(max(value, self.low), self.high)
        share = math.log(held / self.low) / math.log(self.high / self.low)
        return self.start + share * (self.end - self.start)
