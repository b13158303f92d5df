"""Time of the start, in fresh processes: the import and the first step.

python benchmarks/start.py [--rounds N] [--json FILE]

Each round has one process with an empty cache of compiled kernels, then one with a filled cache.
On a busy machine the processor time, which is also printed, is more reliable than the wall time.
"""

import os
import statistics
import subprocess
import sys
import tempfile

from turns import print_target, read_options

from marl_lanes.files import write_json

_PROGRAM = """
import time
start = time.perf_counter()
import marl_lanes
imported = time.perf_counter()
env = marl_lanes.parallel_env("paper")
env.reset(seed=0)
env.step({agent: [0.0] for agent in env.agents})
print(imported - start, time.perf_counter() - imported, time.process_time())
"""
_TARGETS = {"import": 0.5, "first step, cold cache": 15.0, "first step, warm cache": 1.0}
"""[s]"""


def measure(cache: str) -> tuple[float, float, float]:
    """Wall time of the import, then of the first reset and step; total processor time [s]."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
    output = subprocess.run(
        [sys.executable, "-c", _PROGRAM], env=environment, check=True, capture_output=True
    ).stdout
    imported, stepped, processor = map(float, output.split())
    return imported, stepped, processor


def main() -> None:
    """Run the rounds, print the medians, write the JSON."""
    options = read_options(__doc__ or "", rounds=3)
    rows: dict[str, list[float]] = {name: [] for name in _TARGETS}
    for _ in range(options.rounds):
        with tempfile.TemporaryDirectory() as cache:
            imported, cold, cold_processor = measure(cache)
            _, warm, warm_processor = measure(cache)
        print(f"processor time: cold {cold_processor:.2f} s, warm {warm_processor:.2f} s")
        for name, seconds in zip(rows, (imported, cold, warm), strict=True):
            rows[name].append(seconds)
    medians = {name: statistics.median(seconds) for name, seconds in rows.items()}
    for name, bound in _TARGETS.items():
        print_target(f"{name} [s]", medians[name], bound, is_least=False)
    if options.json is not None:
        write_json(options.json, {"rounds": options.rounds, **medians})


if __name__ == "__main__":
    main()
