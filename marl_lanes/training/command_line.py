"""Command line of a program: hydra composes it with its YAML files; bad input is one line."""

import argparse
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import Any, NoReturn, cast

from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import BaseModel

from marl_lanes.plugins import add_import, import_modules
from marl_lanes.scenario.yaml_files import format_yaml
from marl_lanes.training.config import ConfigError, ProgramConfig
from marl_lanes.training.overrides import check_overrides

MAIN_FILE = "config"
"""The YAML file of a program that names the other ones."""

HYDRA_VERSION = "1.3"
"""The version whose defaults hydra uses."""

Fields = dict[str, Any]
"""Plain values, nested."""

Choices = Mapping[str, Callable[[Fields], str]]
"""For a folder of YAML files, by name: which file to use, given the composed fields."""


class Parser(argparse.ArgumentParser):
    """Refuses options as the programs refuse everything else: in one line, with status 2.

    Args:
        **options: those of ``ArgumentParser``. Options cannot be abbreviated.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """End the program."""
        _refuse(f"{message}; --help shows what is allowed")


@contextmanager
def refusing() -> Iterator[None]:
    """Where what was given cannot be, end the program with status 2 and one line on stderr."""
    try:
        yield
    except (ValueError, OSError) as error:
        _refuse(str(error))


def _refuse(reason: str) -> NoReturn:
    print(f"error: {' '.join(reason.split())}", file=sys.stderr)  # noqa: T201
    sys.exit(2)


def read_command_line(
    kind: type[ProgramConfig],
    folder: Path,
    description: str,
    arguments: Sequence[str] | None = None,
    choices: Choices | None = None,
    *,
    file: str = MAIN_FILE,
    program: str | None = None,
) -> Fields:
    """The fields of the command line and the YAML files, not yet checked.

    ``--help`` and ``--cfg job`` print and end the program. ``--import`` imports the user's modules.

    Args:
        kind: the configuration; ``--help`` lists its fields.
        folder: the program's folder, with its YAML files.
        description: description of the program, for ``--help``.
        arguments: the command line; None: that of this process.
        choices: as for ``compose_fields``.
        file: as for ``compose_fields``.
        program: how it is called, for ``--help``; None: as this process.

    Raises:
        ConfigError: a key is unknown, or an override cannot be read.
        ValueError: a module cannot be imported.
    """
    parser = Parser(
        prog=program,
        description=description,
        epilog="fields:\n" + "\n".join(map(_wrap, _describe(kind))),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        usage="%(prog)s [FIELD=VALUE ...] [--import MODULE] [--cfg job]",
    )
    parser.add_argument(
        "overrides", nargs="*", metavar="FIELD=VALUE", help="overrides in the syntax of hydra"
    )
    parser.add_argument("--cfg", choices=["job"], help="print the configuration and end")
    add_import(parser)
    options = parser.parse_intermixed_args(arguments)
    import_modules(options.modules)
    fields = compose_fields(kind, folder, options.overrides, choices, file=file)
    if options.cfg is not None:
        sys.stdout.write(format_yaml(fields))
        sys.exit(0)
    return fields


def describe_command(program: str, arguments: Sequence[str] | None = None) -> str:
    """The command that starts a program as it was started, for a shell.

    Args:
        program: how it is called: ``python agents/naf/train.py``.
        arguments: the command line; None: that of this process.
    """
    given = sys.argv[1:] if arguments is None else arguments
    return shlex.join([*program.split(), *given])


def compose_fields(
    kind: type[ProgramConfig],
    folder: Path,
    overrides: Sequence[str],
    choices: Choices | None = None,
    *,
    file: str = MAIN_FILE,
) -> Fields:
    """Compose a program's YAML files and the overrides with hydra.

    Args:
        kind: the configuration; messages about an unknown key name its nearest field.
        folder: folder of the YAML files.
        overrides: ``FIELD=VALUE``, ``+FIELD=VALUE``, ``FOLDER=FILE``.
        choices: chooses files that no override names.
        file: the YAML file that names the other ones, without its suffix.

    Raises:
        ConfigError: a key is unknown, or an override cannot be read.
    """
    given = check_overrides(kind, folder, overrides)
    try:
        with initialize_config_dir(str(folder.resolve()), version_base=HYDRA_VERSION):
            fields = _compose(file, overrides)
            chosen = [
                f"{name}={choose(fields)}"
                for name, choose in (choices or {}).items()
                if name not in given
            ]
            return _compose(file, [*overrides, *chosen]) if chosen else fields
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(_explain(error)) from None


def _compose(file: str, overrides: Sequence[str]) -> Fields:
    composed = compose(file, list(overrides))
    return cast("Fields", OmegaConf.to_container(composed, resolve=True))


def _explain(error: Exception) -> str:
    """One line about what hydra does not accept."""
    reason = " ".join(str(error).split())
    _, is_of_kind, override = reason.partition("Error merging override ")
    return f"{override}: must be of the kind that --cfg job shows" if is_of_kind else reason


def _wrap(line: str) -> str:
    """A line about a field, within the terminal."""
    width = get_terminal_size().columns - 2
    return fill(line, width, subsequent_indent="      ", break_on_hyphens=False)


def _describe(kind: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """A line for every field, with its meaning."""
    for name, field in kind.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from _describe(inner, f"{prefix}{name}.")
        else:
            yield f"  {prefix}{name}: {field.description}"
