"""How NAF is trained: the values of the recipes, and a training by them."""

from pathlib import Path

FOLDER = Path(__file__).parent
"""Of the YAML files."""
