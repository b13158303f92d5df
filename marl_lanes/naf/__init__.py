"""Normalized advantage functions: the quadratic Q-network and its loss."""

from marl_lanes.naf.loss import NAFLoss
from marl_lanes.naf.network import NAFNetwork

__all__ = ["NAFLoss", "NAFNetwork"]
