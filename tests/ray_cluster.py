"""A Ray cluster of two nodes with a CPU each, on this machine's own address."""

import os
from contextlib import contextmanager


@contextmanager
def two_nodes():
    """The cluster's address, HOST:PORT; its processes end with the block."""
    # Ray asks the network for nothing: no usage report.
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
    cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    try:
        cluster.add_node(**node)
        yield cluster.address
    finally:
        cluster.shutdown()
