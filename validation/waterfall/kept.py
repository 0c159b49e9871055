"""Finished parts of a waterfall, kept as soon as they are there: one that was stopped goes on at the part that it was at."""

from __future__ import annotations

from collections.abc import Callable

from .. import cache

KIND = "waterfall-part"


class Parts:
    """key: of the record that the waterfall is of, all that its parts depend on; None keeps nothing."""

    def __init__(self, key: str | None = None) -> None:
        self._key = key

    def arrays(self, name: str, work: Callable[[], cache.Arrays]) -> cache.Arrays:
        """The part `name`, or what `work` makes of it now. What is kept is exact: a run that was stopped ends as one that was not."""
        if self._key is None:
            return work()
        key = cache.key(self._key, name)
        kept = cache.load(KIND, key)
        if kept is None:
            kept = work()
            cache.store(KIND, key, kept)
        return kept
