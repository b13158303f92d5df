"""Environments as context managers."""

from typing import Any, Self


class Closes:
    """``with ... as env`` closes the environment at the end of the block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        closing: Any = self
        closing.close()
