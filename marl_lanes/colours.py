"""The colours of every picture: figures, web pages, traffic; safe for colour-blind eyes.

A colour never tells anything alone: series differ also by line style or marker, dispositions by the
pattern of their outline, a refused gap by hatching. tests/test_colours.py simulates the three kinds
of colour blindness and asserts how far apart the colours are that must be told apart.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Theme:
    """Colours of figures and pages, each as ``#rrggbb``."""

    background: str
    """Of a figure or page."""
    panel: str
    """Of boxes and table heads on the background."""
    text: str
    """Text, axes and reference lines."""
    muted: str
    """Text of less weight."""
    grid: str
    """Lines of grids and tables, which carry no meaning."""
    link: str
    """Links and what can be clicked."""
    warning: str
    """Text of warnings."""
    ground: str
    """Beside the road, in pictures of traffic."""
    series: tuple[str, ...]
    """Lines of a plot, in the order of use; the last is grey, for what is behind the others."""

    def variables(self) -> dict[str, str]:
        """The colours by the names of their CSS variables: ``link``, ``series-0``, ..."""
        plain = {name: value for name, value in vars(self).items() if name != "series"}
        return plain | {f"series-{index}": value for index, value in enumerate(self.series)}


LIGHT = Theme(
    background="#ffffff",
    panel="#f3f4f6",
    text="#1b1f24",
    muted="#57606a",
    grid="#d5d9de",
    link="#0a4bd4",
    warning="#9e330f",
    ground="#dfe6d8",
    series=("#2748e8", "#a8380f", "#16a58c", "#5a1272", "#d9781e", "#55585c"),
)
"""Dark on white; also of figures in files."""

DARK = Theme(
    background="#15181c",
    panel="#20252b",
    text="#e8eaed",
    muted="#a6adb5",
    grid="#3a4149",
    link="#8ab4ff",
    warning="#ffb08a",
    ground="#242b24",
    series=("#4a7bea", "#dd6f37", "#3bca9b", "#b8a5dc", "#ffcb3e", "#7d7d80"),
)
"""Light on near black."""


@dataclass(frozen=True)
class Traffic:
    """Colours on the road, each as ``#rrggbb``; the same in every theme."""

    road: str
    marking: str
    changer: str
    """Body of a commanded vehicle; red as in the paper's Figure 5."""
    vehicle: str
    """Body of every other vehicle; yellow as in the paper's Figure 5."""
    cooperative: str
    """Outline by disposition, as the next three."""
    neutral: str
    """Dark like the road, so that it looks like no outline."""
    adversarial: str
    external: str
    """A learned or any other policy."""
    indicator: str
    brake_light: str
    safe_gap: str
    """The gap that the rule accepts."""
    refused_gap: str


TRAFFIC = Traffic(
    road="#2e3035",
    marking="#f4f4f2",
    changer="#d42f22",
    vehicle="#f3d617",
    cooperative="#4ab1ff",
    neutral="#0b0d0f",
    adversarial="#ff27a1",
    external="#ffffff",
    indicator="#fd7f00",
    brake_light="#fd9aca",
    safe_gap="#21b594",
    refused_gap="#b358d3",
)
