"""A Ray cluster of two nodes with a CPU each, on this machine's own address."""

import os
from contextlib import contextmanager


@contextmanager
def two_nodes():
    """The cluster's address, HOST:PORT; its processes end with the block."""
    # Ray sends no usage report.
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    cluster = _start()
    try:
        yield cluster.address
    finally:
        cluster.shutdown()


def _start(attempts=3):
    """Both nodes. Ray gives each a few seconds to start, also on a busy machine."""
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
    while True:
        attempts -= 1
        cluster = Cluster()
        try:
            cluster.add_node(**node, include_dashboard=False)
            cluster.add_node(**node)
        except Exception:
            cluster.shutdown()
            if not attempts:
                raise
        else:
            return cluster
