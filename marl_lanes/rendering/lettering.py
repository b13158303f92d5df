"""Text in pictures: never over other text, never beyond the picture."""

from typing import Literal

from marl_lanes.rendering.loading import pygame
from marl_lanes.rendering.palette import Colour

Anchor = Literal["topleft", "topright", "midleft", "midright", "center", "midtop", "midbottom"]

_MAX_KEPT = 4096
"""Texts with their sizes and pictures; beyond that all are drawn anew."""

_FONT_SHARE = 1.42
"""Size that pygame's own font needs for lines of one pixel, by which a text's size is given."""

_FINE = 3
"""Text is drawn so much larger and then shrunk: letters then stand at even distances."""


class Lettering:
    """Draws text and remembers where, for one picture after the other.

    Attributes:
        placed: rectangles of the texts of the current picture.
        texts: the texts in them.
    """

    def __init__(self) -> None:
        pygame.font.init()
        self._fonts: dict[int, pygame.font.Font] = {}
        self._sizes: dict[tuple[str, int], tuple[int, int]] = {}
        self._pictures: dict[tuple[str, int, Colour], pygame.Surface] = {}
        self.placed: list[pygame.Rect] = []
        self.texts: list[str] = []
        self._num_fixed = 0

    def fix(self) -> None:
        """Keep the texts that are placed by now in all pictures."""
        self._num_fixed = len(self.placed)

    def begin(self) -> None:
        """Begin a picture with the fixed texts."""
        del self.placed[self._num_fixed :]
        del self.texts[self._num_fixed :]

    def measure(self, text: str, size: int) -> tuple[int, int]:
        """Width and height of a text [pixel]."""
        found = self._sizes.get((text, size))
        if found is None:
            if len(self._sizes) >= _MAX_KEPT:
                self._sizes.clear()
            width, height = self._font(size).size(text)
            found = self._sizes[text, size] = -(-width // _FINE), -(-height // _FINE)
        return found

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
        box = self.find_room(text, place, size, anchor=anchor, is_boxed=chip is not None)
        limits = surface.get_rect() if within is None else within
        if not limits.contains(box) or box.collidelist(self.placed) >= 0:
            return None
        if chip is not None:
            pygame.draw.rect(surface, chip, box, border_radius=round(0.4 * size))
        picture = self._render(text, size, colour)
        surface.blit(picture, picture.get_rect(center=box.center))
        self.placed.append(box)
        self.texts.append(text)
        return box

    def find_room(
        self,
        text: str,
        place: tuple[float, float],
        size: int,
        *,
        anchor: Anchor = "topleft",
        is_boxed: bool = False,
    ) -> "pygame.Rect":
        """The rectangle that a text would take, with its box."""
        rect = pygame.Rect((0, 0), self.measure(text, size))
        if is_boxed:
            rect.inflate_ip(2 * round(0.35 * size), round(0.25 * size))
        setattr(rect, anchor, (round(place[0]), round(place[1])))
        return rect

    def _font(self, size: int) -> "pygame.font.Font":
        if size not in self._fonts:
            self._fonts[size] = pygame.font.Font(None, round(_FONT_SHARE * size * _FINE))
        return self._fonts[size]

    def _render(self, text: str, size: int, colour: Colour) -> "pygame.Surface":
        key = (text, size, colour)
        if key not in self._pictures:
            if len(self._pictures) >= _MAX_KEPT:
                self._pictures.clear()
            large = self._font(size).render(text, True, colour)
            self._pictures[key] = pygame.transform.smoothscale(large, self.measure(text, size))
        return self._pictures[key]
