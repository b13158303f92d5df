import numpy as np
import pytest

from marl_lanes.rendering.lettering import Lettering
from marl_lanes.rendering.loading import pygame

WHITE, GREEN = (255, 255, 255), (0, 90, 0)


@pytest.fixture
def surface():
    return pygame.Surface((200, 60), depth=32)


def drawn(surface):
    return np.argwhere(pygame.surfarray.array3d(surface).any(axis=2))


def test_text_is_drawn_within_its_rectangle(surface):
    lettering = Lettering()
    box = lettering.put(surface, "12.3 s", (20, 10), 14, WHITE)
    assert box.topleft == (20, 10)
    assert box.size == lettering.measure("12.3 s", 14)
    places = drawn(surface)
    assert len(places) > 50
    assert places.min(axis=0).tolist() >= [20, 10]
    assert (places.max(axis=0) < [box.right, box.bottom]).all()
    assert (lettering.texts, lettering.placed) == (["12.3 s"], [box])


def test_text_never_covers_text(surface):
    lettering = Lettering()
    assert lettering.put(surface, "first", (20, 10), 14, WHITE)
    before = pygame.surfarray.array3d(surface)
    assert lettering.put(surface, "second", (30, 14), 14, WHITE) is None
    assert (pygame.surfarray.array3d(surface) == before).all()
    assert lettering.put(surface, "second", (30, 40), 14, WHITE)


@pytest.mark.parametrize("place", [(-1, 10), (190, 10), (10, -1), (10, 55)])
def test_text_never_leaves_the_picture(surface, place):
    lettering = Lettering()
    assert lettering.put(surface, "text", place, 14, WHITE) is None
    assert len(drawn(surface)) == 0
    inner = pygame.Rect(50, 0, 100, 60)
    assert lettering.put(surface, "text", (45, 10), 14, WHITE, within=inner) is None


def test_a_box_is_behind_the_text(surface):
    lettering = Lettering()
    box = lettering.put(surface, "text", (100, 30), 14, WHITE, anchor="center", chip=GREEN)
    assert box == lettering.find_room("text", (100, 30), 14, anchor="center", is_boxed=True)
    assert abs(box.centerx - 100) <= 1
    assert tuple(surface.get_at((box.left + 1, box.centery)))[:3] == GREEN


def test_fixed_texts_stay(surface):
    lettering = Lettering()
    lettering.put(surface, "fixed", (10, 10), 14, WHITE)
    lettering.fix()
    lettering.put(surface, "frame", (100, 10), 14, WHITE)
    lettering.begin()
    assert lettering.texts == ["fixed"]
    assert len(lettering.placed) == 1


def test_long_text_is_shortened():
    lettering = Lettering()
    assert lettering.shorten("short", 14, 100) == "short"
    text = lettering.shorten("runs/a/long/name/of/a/folder", 14, 100)
    assert text.startswith("runs/a")
    assert text.endswith("…")
    assert lettering.measure(text, 14)[0] <= 100
    assert lettering.shorten("text", 14, 3) == ""
