"""The exponent of a law e = C x^p from errors at several x, with its interval: cases R1, R2, R4."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from .case import Case, Reading
from .until_decided import mean_of, until_decided

Sizes = npt.NDArray[np.floating]
Law = tuple[Sizes, Callable[[int], Sequence[float]]]
EACH, LOOKS = 4, 6  # repetitions a look


def exponents(case: Case, value: float, laws: Mapping[str, Law]) -> dict[str, Reading]:
    """Exponent of each law, from EACH more repetitions until the case is decided. A law: its sizes (K,), and the errors there, all
    positive, of a repetition of that number."""
    errors: dict[str, list[Sequence[float]]] = {name: [] for name in laws}

    def look(k: int) -> Mapping[str, Reading]:
        for name, (_, repetition) in laws.items():
            errors[name] += [repetition(r) for r in range(EACH * (k - 1), EACH * k)]
        return {name: exponent(sizes, np.array(errors[name])) for name, (sizes, _) in laws.items()}

    return until_decided(case, value, look, LOOKS)


def exponent(sizes: Sizes, errors: Sizes) -> Reading:
    """Slope of ln e over ln x. sizes (K,), errors (S, K) from S ≥ 2 independent repetitions, all positive: each repetition is fitted
    by least squares, and the spread of the S slopes gives the standard error. Of S · K errors only S are independent here."""
    x = np.log(sizes) - np.log(sizes).mean()
    slopes = np.log(errors) @ x / (x @ x)
    return mean_of(slopes.tolist())
