"""The ``marl-lanes`` command."""
