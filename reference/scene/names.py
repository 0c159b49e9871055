"""Names that come from files: printable, short, unique."""

from __future__ import annotations

from collections.abc import Container

MAX_NAME = 64


def clean(text: object, fallback: str = "unnamed") -> str:
    """Printable form of a name, without control characters and brackets that start markup, at most 64 characters."""
    kept = "".join(c if c.isprintable() and c not in '<>"' else "_" for c in str(text)).strip()
    return kept[:MAX_NAME].lstrip("=+@-") or fallback


def unique(text: object, taken: Container[str], fallback: str = "unnamed") -> str:
    """`clean`, with a number behind it if the name is taken."""
    name = clean(text, fallback)
    if name not in taken:
        return name
    number = 2
    while (candidate := f"{name[: MAX_NAME - 8]}-{number}") in taken:
        number += 1
    return candidate
