"""Packages of an extra, imported when something needs them."""

from importlib import import_module
from types import ModuleType


class MissingExtraError(ImportError, ValueError):
    """A package is needed that an extra of marl-lanes installs."""


def need(module: str, extra: str) -> ModuleType:
    """Import a module.

    Args:
        module: its dotted name.
        extra: of marl-lanes that installs it.

    Raises:
        MissingExtraError: it is not installed; the message names the extra.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        # A module that is there and lacks another one is a fault of its own.
        if error.name is None or error.name.partition(".")[0] != module.partition(".")[0]:
            raise
        raise MissingExtraError(
            f"{error.name}: is not installed: pip install 'marl-lanes[{extra}]'", name=error.name
        ) from None
