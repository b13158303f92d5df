"""pygame, imported without its greeting, or one clear error that names the extra."""

import contextlib
import io
from typing import TYPE_CHECKING

from marl_lanes.extras import need

if TYPE_CHECKING:
    import pygame as pygame
else:
    # The greeting would stand in the output of programs that print JSON.
    with contextlib.redirect_stdout(io.StringIO()):
        pygame = need("pygame", "view")
