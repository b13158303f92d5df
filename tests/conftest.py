"""Fixtures for tests of more than one folder."""

import pytest


@pytest.fixture(scope="module")
def two_nodes():
    """The address of a Ray cluster of two nodes on loopback."""
    from ray_cluster import two_nodes

    with two_nodes() as address:
        yield address
