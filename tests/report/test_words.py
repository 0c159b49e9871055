"""Numbers in words: figures, intervals, units, judgements."""

from __future__ import annotations

import pytest
from lightgauge.validation.report import words


def spaced(text: str) -> str:
    """With plain spaces: some are there to keep a number and its unit on one line."""
    return text.replace("\u00a0", " ")


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "0"), (0.0912, "0.0912"), (12.34, "12.3"), (48211.4, "48,211"), (3.1e-7, "3.10e-7"), (-0.5, "-0.500")],
)
def test_numbers_have_three_figures(value: float, shown: str) -> None:
    assert words.number(value) == shown


@pytest.mark.parametrize(
    ("metric", "kind", "shown"),
    [
        ({"value": 0.12, "se": 0.003}, "percent", ("12.00 %", "± 0.59 %")),
        ({"value": 0.012, "se": 0.001}, "signed", ("+1.20 %", "± 0.20 %")),
        ({"value": -0.012, "se": 0.001}, "signed", ("-1.20 %", "± 0.20 %")),
        ({"value": 3e-7, "se": None}, "plain", ("3.00e-7", "")),
        ({"value": 0.0, "se": 0.0}, "plain", ("0", "")),
        ({"value": 1234.0, "se": 500.0}, "plain", ("1,234", "± 980")),
        ({"value": 29.81, "se": 19.0, "interval": [7.2, 44.0]}, "times", ("29.8×", "7.20 to 44.0×")),
    ],
)
def test_the_interval_sets_the_places(metric: dict[str, float], kind: words.Kind, shown: tuple[str, str]) -> None:
    assert tuple(map(spaced, words.written(metric, kind))) == shown


@pytest.mark.parametrize(
    ("value", "se", "judged"),
    [(0.5, 0.1, "good"), (0.9, 0.1, "unsure"), (1.1, 0.1, "unsure"), (1.3, 0.1, "over"), (-1.3, 0.1, "over")],
)
def test_a_metric_is_judged_with_its_interval(value: float, se: float, judged: str) -> None:
    assert words.judge({"value": value, "se": se}, 1.0) == judged
    assert words.judge({"value": value, "se": se}, None) == ""
    assert words.judge({"value": 0.9, "se": 0.2, "interval": [0.8, 0.95]}, 1.0) == "good"
    assert words.judge({"value": value, "se": se, "below_noise": True}, 1.0) == "unsure"


def test_names_of_sets_are_told_from_names_of_metrics() -> None:
    assert words.meaning("relrmse_surface")[1:] == ("relrmse", "_surface")
    assert words.meaning("radiosity_error")[1:] == ("radiosity_error", "")
    assert words.meaning("made_up_volume") == (None, "made_up_volume", "")


@pytest.mark.parametrize(
    ("key", "value", "shown"),
    [
        ("bake_bytes", 31_871_233, "30.4 MiB"), ("peak_rss_mib", 1422.3, "1.4 GiB"), ("bake_s", 171.2, "2 min 51 s"),
        ("update_ms", 0.41, "410 µs"), ("sample_ns", 41.2, "41.2 ns"), ("real_probes", 4113, "4,113"),
        ("other", "LBVH", "LBVH"), ("other", None, "not measured"),
    ],
)  # fmt: skip
def test_costs_have_their_unit(key: str, value: object, shown: str) -> None:
    assert spaced(words.amount(key, value)) == shown


def test_every_text_is_there() -> None:
    assert all(m.label and m.says for m in words.MEANINGS.values())
    assert all(label and says for label, says in words.COSTS.values())
