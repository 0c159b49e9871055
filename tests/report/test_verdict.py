"""The headline of a scene follows from its numbers and their intervals."""

from __future__ import annotations

from collections.abc import Callable

from lightgauge.validation.record import metric
from lightgauge.validation.record_models import JsonObject
from lightgauge.validation.report.verdict import badness, headline, warnings

Make = Callable[..., JsonObject]


def test_the_error_is_set_against_its_floor(scene: Make) -> None:
    assert headline(scene("a", 0.11, 0.1)).words == "at its floor"
    assert headline(scene("a", 0.135, 0.1)).words == "near its floor"
    assert headline(scene("a", 0.31, 0.1)).words == "placement limited"
    assert headline(scene("a", 0.010, 0.002)).words == "accurate"


def test_noise_is_never_a_pass(scene: Make) -> None:
    made = scene("a", 0.001, 0.002)
    made["metrics"]["relrmse"]["below_noise"] = True
    assert headline(made).words == "below the noise floor" and headline(made).tone == "mute"


def test_missing_and_failed_scenes_say_so() -> None:
    assert headline({"name": "a", "status": "failed"}).words == "failed"
    assert headline({"name": "a", "status": "ok", "metrics": {}}).words == "not measured"


def test_one_number_does_not_hide_the_room(scene: Make) -> None:
    made = scene("a")
    assert warnings(made) == []
    made["metrics"]["leak"] = metric(0.02, 0.002, 900)
    made["metrics"]["relrmse_volume"] = metric(0.6, 0.01, 900)
    assert {w.words for w in warnings(made)} == {"leaks light", "worse in mid-air"}
    made["metrics"]["relrmse_camera_inside"] = metric(0.6, 0.01, 300)
    made["metrics"]["relrmse_camera_outside"] = metric(0.1, 0.01, 300)
    assert {w.words for w in warnings(made)} == {"leaks light", "worse in mid-air", "worse from inside"}
    made["metrics"]["leak"] = metric(0.002, 0.002, 900)
    assert "leaks light" not in {w.words for w in warnings(made)}


def test_worst_scenes_come_first(scene: Make) -> None:
    scenes = [scene("fine"), scene("poor", 0.3), {"name": "broken", "status": "failed"}, scene("worse", 0.4)]
    assert [s["name"] for s in sorted(scenes, key=badness, reverse=True)] == ["broken", "worse", "poor", "fine"]


def test_the_patches_are_blamed_before_the_placement(scene: Make) -> None:
    made = scene("a", 0.31, 0.1)
    made["metrics"]["patch_relrmse"] = metric(0.24, 0.01, 2000)
    assert (headline(made).words, headline(made).tone) == ("patches limited", "bad")
    assert "24" in headline(made).why
    made["metrics"]["patch_relrmse"] = metric(0.2, 0.01, 2000)
    assert headline(made).words == "placement limited"
    made["metrics"]["patch_relrmse"] = metric(0.3, 0.2, 2000, below_noise=True)
    assert headline(made).words == "placement limited"
    near = scene("a", 0.11, 0.1)
    near["metrics"]["patch_relrmse"] = metric(0.09, 0.001, 2000)
    assert (headline(near).words, headline(near).tone) == ("patches limited", "fair")


def test_a_kernel_that_deviates_and_points_without_light_are_said(scene: Make) -> None:
    made = scene("a")
    made["metrics"] |= {"kernel_deviation": metric(9e-6, 0.0, 9), "unlit_share": metric(0.0, 0.0, 9)}
    assert warnings(made) == []
    made["metrics"] |= {"kernel_deviation": metric(2e-5, 0.0, 9), "unlit_share_volume": metric(0.1, 0.01, 900)}
    assert {w.words for w in warnings(made)} == {"kernel deviates", "unlit points"}


def test_levels_of_detail_do_not_hide_behind_the_finest(scene: Make) -> None:
    made = scene("a", 0.1, 0.1)
    made["metrics"]["relrmse_lod"] = metric(0.12, 0.001, 900)
    assert warnings(made) == []
    made["metrics"]["relrmse_lod"] = metric(0.8, 0.01, 900)
    (said,) = warnings(made)
    assert said.words == "worse at its levels of detail" and "80" in said.why
