"""The frames that are drawn for an environment, and a computer without a display."""

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
def no_display(monkeypatch):
    """No window can be opened, and none has been afterwards."""
    import pygame

    pygame.display.quit()
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    yield
    assert not pygame.display.get_init()
