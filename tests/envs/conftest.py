"""The frames that are drawn for an environment, and that none is drawn in a window."""

import pytest


@pytest.fixture
def frames(monkeypatch):
    """The frames that are drawn."""
    from marl_lanes.rendering.painter import Painter

    drawn = []
    draw = Painter.draw

    def keep(self, frame):
        drawn.append(frame)
        return draw(self, frame)

    monkeypatch.setattr(Painter, "draw", keep)
    return drawn


@pytest.fixture
def no_window(no_display):  # noqa: ARG001
    """No window can be opened, and none has been afterwards."""
    import pygame

    yield
    assert not pygame.display.get_init()
