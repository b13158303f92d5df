"""The command that sets up completion in a shell, and what answers when TAB is pressed."""

import argparse
import os
from typing import Any

from marl_lanes.cli.arguments import Commands, add_command
from marl_lanes.terminal import say

SHELLS = ("bash", "zsh", "fish")


def add(commands: Commands) -> None:
    """Add ``completion``."""
    completion = add_command(
        commands,
        "completion",
        _show_script,
        summary="print what a shell needs to complete commands",
        description="Print the lines with which a shell completes commands, options and names when "
        "TAB is pressed. Add them to the file that the shell reads when it starts.",
        examples="""
            marl-lanes completion bash >> ~/.bashrc
            marl-lanes completion zsh >> ~/.zshrc
            marl-lanes completion fish > ~/.config/fish/completions/marl-lanes.fish
        """,
    )
    completion.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))


def answer(parser: argparse.ArgumentParser) -> None:
    """Where a shell asks what may come next, answer and end the process.

    Args:
        parser: of all commands.
    """
    if "_ARGCOMPLETE" in os.environ:
        from argcomplete import autocomplete

        from marl_lanes.cli.completers import files

        # Any function will do, whatever its types say.
        offer: Any = lambda prefix, **_: files(prefix)  # noqa: E731
        autocomplete(parser, default_completer=offer)


def _show_script(options: argparse.Namespace) -> None:
    from argcomplete.shell_integration import shellcode

    say(shellcode(["marl-lanes"], shell=options.shell).strip("\n"))
