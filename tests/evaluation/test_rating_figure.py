"""The figure of ratings: what is in it, with one league and with two."""

import re

import pytest

from marl_lanes.evaluation.rating_figure import draw_ratings


def row(player, role, value, generation, *, low=None, is_held_out=False):
    high = None if low is None else 2.0 * value - low
    told = {"player": player, "role": role, "rating": value, "low": low, "high": high}
    return {**told, "generation": generation, "is_held_out": is_held_out}


LEAGUE = {
    "num_maneuvers": 30,
    "confidence": 0.95,
    "ratings": [
        row("changer_0", "changer", 100.0, 0, low=90.0),
        row("changer_1", "changer", 120.0, 1),
        row("neutral", "followers", -150.0, None, low=-170.0),
        row("late-yielder", "followers", -90.0, None, is_held_out=True),
        row("follower_1", "followers", 20.0, 1, low=5.0),
    ],
}


@pytest.mark.parametrize("number", [1, 2])
def test_the_figure_names_everybody_once(tmp_path, number):
    paths = [tmp_path / "ratings.svg", tmp_path / "ratings.png"]
    draw_ratings(paths, [LEAGUE] * number)
    assert paths[1].read_bytes().startswith(b"\x89PNG")
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", paths[0].read_text(encoding="utf-8"))
    for text in ("changer", "followers", "neutral", "late-yielder", "generation [1]"):
        assert texts.count(text) == 1, text
    assert any("30 maneuvers per match, 95 % intervals" in text for text in texts)
    before = paths[0].read_bytes()
    draw_ratings(paths, [LEAGUE] * number)
    assert paths[0].read_bytes() == before
