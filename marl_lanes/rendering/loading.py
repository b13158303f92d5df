"""pygame, imported without its greeting, or one clear error that names the extra."""

import contextlib
import io
from typing import TYPE_CHECKING

from marl_lanes.extras import MissingExtraError, need

if TYPE_CHECKING:
    import pygame as pygame
else:
    # The greeting would stand in the output of programs that print JSON.
    with contextlib.redirect_stdout(io.StringIO()):
        pygame = need("pygame", "view")

    if not getattr(pygame, "IS_CE", False):
        raise MissingExtraError(
            "pygame: pygame-ce is needed, and pygame is in its place: pip uninstall pygame; "
            "pip install --force-reinstall 'marl-lanes[view]'",
            name="pygame",
        )
