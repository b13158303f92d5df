"""Text in pictures: never over other text, never beyond the picture."""

from typing import Literal

from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import Colour

Anchor = Literal["topleft", "topright", "midleft", "midright", "center", "midtop", "midbottom"]

_MAX_KEPT = 4096
"""Pictures of text; beyond that all are drawn anew."""

_CAP_SHARE = 1.42
"""Size that pygame's own font needs for lines of one pixel, by which a text's size is given."""


class Lettering:
    """Draws text and remembers where, for one picture after the other.

    Attributes:
        placed: rectangles of the texts of the current picture.
        texts: the texts in them.
    """

    def __init__(self) -> None:
        pygame.font.init()
        self._fonts: dict[int, pygame.font.Font] = {}
        self._pictures: dict[tuple[str, int, Colour], pygame.Surface] = {}
        self.placed: list[pygame.Rect] = []
        self.texts: list[str] = []

    def begin(self) -> None:
        """Begin a picture: no text is placed."""
        self.placed.clear()
        self.texts.clear()

    def measure(self, text: str, size: int) -> tuple[int, int]:
        """Width and height of a text [pixel]."""
        return self._font(size).size(text)

    def shorten(self, text: str, size: int, width: int) -> str:
        """The text, or its start with an ellipsis, within a width [pixel]."""
        if self.measure(text, size)[0] <= width:
            return text
        while text and self.measure(text + "…", size)[0] > width:
            text = text[:-1]
        return text.rstrip() + "…" if text else ""

    def put(
        self,
        surface: "pygame.Surface",
        text: str,
        place: tuple[float, float],
        size: int,
        colour: Colour,
        *,
        anchor: Anchor = "topleft",
        chip: Colour | None = None,
        within: "pygame.Rect | None" = None,
    ) -> "pygame.Rect | None":
        """Draw a text, unless it would be over another one or reach beyond the picture.

        Args:
            surface: the whole picture.
            text: one line.
            place: of the anchor [pixel].
            size: of a line [pixel].
            colour: of the letters.
            anchor: the point of the text's rectangle that goes to the place.
            chip: colour of a box behind the text.
            within: rectangle that the text must not leave; the whole picture by default.

        Returns:
            the rectangle, with its box; None if the text is not drawn.
        """
        picture = self._render(text, size, colour)
        rect = picture.get_rect()
        padding = round(0.3 * size) if chip is not None else 0
        box = rect.inflate(2 * padding, padding)
        setattr(box, anchor, (round(place[0]), round(place[1])))
        rect.center = box.center
        limits = surface.get_rect() if within is None else within
        if not limits.contains(box) or box.collidelist(self.placed) >= 0:
            return None
        if chip is not None:
            pygame.draw.rect(surface, chip, box, border_radius=round(0.35 * size))
        surface.blit(picture, rect)
        self.placed.append(box)
        self.texts.append(text)
        return box

    def _font(self, size: int) -> "pygame.font.Font":
        if size not in self._fonts:
            self._fonts[size] = pygame.font.Font(None, round(_CAP_SHARE * size))
        return self._fonts[size]

    def _render(self, text: str, size: int, colour: Colour) -> "pygame.Surface":
        key = (text, size, colour)
        if key not in self._pictures:
            if len(self._pictures) >= _MAX_KEPT:
                self._pictures.clear()
            self._pictures[key] = self._font(size).render(text, True, colour)
        return self._pictures[key]
