"""The checksum of a trajectory: of what its file says, in whatever bytes."""

import hashlib

import numpy as np

from marl_lanes.trajectory.columns import READ
from marl_lanes.trajectory.frames import Rows


class Checksum:
    """SHA-256 of what a file says: the metadata, and the rows in its order.

    Args:
        metadata: as the file has it.
    """

    def __init__(self, metadata: bytes) -> None:
        self._metadata = metadata
        # By columns, so that it does not matter in which blocks the rows come.
        self._columns = {column.name: hashlib.sha256() for column in READ}

    def add(self, rows: Rows) -> None:
        """Add rows that come after those before."""
        for column in READ:
            values = rows[column.name]
            if column.kind.startswith("f"):
                # There are many nan; a missing value is read as this one.
                values = np.where(np.isnan(values), values.dtype.type(np.nan), values)
            self._columns[column.name].update(np.ascontiguousarray(values).data)

    def finish(self) -> bytes:
        """The checksum in hexadecimal digits."""
        whole = hashlib.sha256(self._metadata)
        for column in self._columns.values():
            whole.update(column.digest())
        return whole.hexdigest().encode()
