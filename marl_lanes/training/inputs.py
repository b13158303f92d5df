"""What a run was begun with, kept in its folder: it goes on from that alone."""

import hashlib
import os
import stat
from collections.abc import Iterable, Mapping
from pathlib import Path

from marl_lanes.files import copy_file, open_regular, write_text
from marl_lanes.naf.checkpoint import find_checkpoint
from marl_lanes.scenario import Scenario, load_scenario
from marl_lanes.scenario.yaml_files import format_yaml
from marl_lanes.training.config import CONFIG_FILE, ConfigError, ProgramConfig, write_config

SCENARIO_FILE = "scenario.yaml"
"""File name of the run's scenario, with every field."""

LEARNED_FILE = "learned_followers.pt"
"""File name of the copy of the scenario's ``followers.learned.checkpoint``, if it is read."""

SUMS_FILE = "SHA256SUMS"
"""File name of the checksums, in the form of ``sha256sum``."""


def own_scenario(folder: Path, scenario: Scenario, *, has_learned: bool) -> Scenario:
    """The scenario with the run's copy of its learned followers' checkpoint, or with none.

    Args:
        folder: of the run.
        scenario: with the checkpoint from wherever it is.
        has_learned: whether the run reads it.
    """
    if scenario.followers.learned.checkpoint is None:
        return scenario
    path = str(folder.resolve() / LEARNED_FILE) if has_learned else None
    return load_scenario(scenario, {"followers": {"learned": {"checkpoint": path}}})


def keep_inputs(
    folder: Path, config: ProgramConfig, scenario: Scenario, files: Mapping[str, Path]
) -> Scenario:
    """Write the configuration, the scenario, copies of other files, and the checksums of all.

    Args:
        folder: of the run.
        config: of the run.
        scenario: of the run, before ``training_overrides``.
        files: checkpoints that the run reads, by their names in the folder.

    Returns:
        the scenario as a resumed run reads it.

    Raises:
        OSError: a file cannot be read or written.
        CheckpointError: the zoo does not have one of them.
    """
    for name, path in files.items():
        copy_file(find_checkpoint(path), folder / name)
    write_config(folder / CONFIG_FILE, config)
    kept = own_scenario(folder, scenario, has_learned=LEARNED_FILE in files)
    fields = kept.model_dump(mode="json")
    if LEARNED_FILE in files:
        fields["followers"]["learned"]["checkpoint"] = LEARNED_FILE
    write_text(folder / SCENARIO_FILE, format_yaml(fields))
    names = [CONFIG_FILE, SCENARIO_FILE, *files]
    lines = [f"{_digest(folder / name)}  {name}\n" for name in names]
    write_text(folder / SUMS_FILE, "".join(lines))
    return kept


def find_scenario(folder: Path) -> Path:
    """The scenario's file of a run.

    Raises:
        ConfigError: the folder is not one of a run, or a link in it leads out of it.
    """
    path = folder / SCENARIO_FILE
    if not path.is_file():
        raise ConfigError(
            f"run {folder}: must be a run folder; it has no {SCENARIO_FILE}: it is of an older "
            "version, or was ended before it began"
        )
    check_folder(folder)
    return path


def read_scenario(folder: Path) -> Scenario:
    """The scenario of a run.

    Raises:
        ConfigError: as for ``find_scenario``.
        ScenarioError: the scenario cannot be read or is not valid.
    """
    return own_scenario(folder, load_scenario(find_scenario(folder)), has_learned=True)


def check_inputs(folder: Path, files: Iterable[str]) -> None:
    """Refuse to go on with a run whose inputs are not those that it was begun with.

    Args:
        folder: of the run.
        files: names of the other files that it reads.

    Raises:
        ConfigError: one has changed, or is gone.
    """
    try:
        with open_regular(folder / SUMS_FILE) as file:
            pairs = [line.split("  ", 1) for line in file.read().decode().splitlines()]
        wanted = {name: digest for digest, name in pairs}
    except (OSError, ValueError):
        raise ConfigError(
            f"resume = {str(folder)!r}: its {SUMS_FILE} is damaged or gone: begin another run"
        ) from None
    for name in (CONFIG_FILE, SCENARIO_FILE, *files):
        try:
            is_same = _digest(folder / name) == wanted.get(name)
        except OSError:
            is_same = False
        if not is_same:
            raise ConfigError(
                f"resume = {str(folder)!r}: its {name} must be as when the run began (checksum in "
                f"{SUMS_FILE}); it has changed, or is gone"
            )


def check_folder(folder: Path) -> None:
    """Refuse a run folder with a link out of it, a pipe or a device.

    Who reads or writes there means the folder's own files.

    Raises:
        ConfigError: there is one.
    """
    root = folder.resolve()
    for parent, folders, files in os.walk(folder):
        for path in (Path(parent) / name for name in (*folders, *files)):
            try:
                mode = path.lstat().st_mode
            except FileNotFoundError:
                continue  # a training goes on
            is_own = stat.S_ISREG(mode) or stat.S_ISDIR(mode)
            if stat.S_ISLNK(mode):
                is_own = path.resolve().is_relative_to(root)
            if not is_own:
                raise ConfigError(
                    f"run {folder}: {path.relative_to(folder)}: must be a file or a folder of its "
                    "own"
                )


def _digest(path: Path) -> str:
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
