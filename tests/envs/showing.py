"""Small pictures of the environments, and what is in them."""

import numpy as np

from marl_lanes.colours import TRAFFIC

SMALL = {"size": (320, 180), "speed": 100.0}
RED, YELLOW = (
    np.array(list(bytes.fromhex(colour[1:]))) for colour in (TRAFFIC.changer, TRAFFIC.vehicle)
)


def is_near(picture, colour):
    return (np.abs(picture.astype(int) - colour) < 40).all(axis=-1)


def assert_shows_traffic(picture):
    """Not black, and with yellow cars."""
    assert picture.mean() > 15.0
    assert len(np.unique(picture.astype(np.uint32) @ (1, 256, 65_536))) > 20
    assert is_near(picture, YELLOW).sum() > 30
