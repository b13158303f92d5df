"""Colours of the traffic and of the dark theme as red, green and blue from 0 to 255."""

from marl_lanes.colours import DARK, TRAFFIC
from marl_lanes.traffic.machine.state import Disposition, Outcome, Phase

Colour = tuple[int, int, int]


def to_rgb(text: str) -> Colour:
    """``#rrggbb`` as three numbers."""
    red, green, blue = bytes.fromhex(text.removeprefix("#"))
    return red, green, blue


def mix(first: Colour, second: Colour, share: float) -> Colour:
    """``first`` with a share of ``second`` in it."""
    red, green, blue = (
        round(one + (other - one) * share) for one, other in zip(first, second, strict=True)
    )
    return red, green, blue


BACKGROUND = to_rgb(DARK.background)
PANEL = to_rgb(DARK.panel)
GRID = to_rgb(DARK.grid)
TEXT = to_rgb(DARK.text)
MUTED = to_rgb(DARK.muted)
WARNING = to_rgb(DARK.warning)
GROUND = to_rgb(DARK.ground)

ROAD = to_rgb(TRAFFIC.road)
MARKING = to_rgb(TRAFFIC.marking)
CHANGER = to_rgb(TRAFFIC.changer)
VEHICLE = to_rgb(TRAFFIC.vehicle)
INDICATOR = to_rgb(TRAFFIC.indicator)
BRAKE_LIGHT = to_rgb(TRAFFIC.brake_light)
SAFE_GAP = to_rgb(TRAFFIC.safe_gap)
REFUSED_GAP = to_rgb(TRAFFIC.refused_gap)

_OUTLINES = {
    Disposition.COOPERATIVE: to_rgb(TRAFFIC.cooperative),
    Disposition.NEUTRAL: to_rgb(TRAFFIC.neutral),
    Disposition.ADVERSARIAL: to_rgb(TRAFFIC.adversarial),
    Disposition.EXTERNAL: to_rgb(TRAFFIC.external),
}

PHASES = {
    Phase.ABSENT: MUTED,
    Phase.WAITING: REFUSED_GAP,
    Phase.ENGAGED: SAFE_GAP,
    Phase.ABORTING: WARNING,
}

OUTCOMES = {
    Outcome.COMPLETED: SAFE_GAP,
    Outcome.COLLISION: WARNING,
    Outcome.OFF_ROAD: WARNING,
    Outcome.MISSED: REFUSED_GAP,
    Outcome.TIMED_OUT: REFUSED_GAP,
    Outcome.HORIZON: MUTED,
}


def outline_of(disposition: Disposition) -> Colour:
    """Of a vehicle's outline."""
    return _OUTLINES[disposition]
