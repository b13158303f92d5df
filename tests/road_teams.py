"""Run with numba's compilation switched off: roads that teams of threads advance, as on a GPU.

python tests/road_teams.py SIZE ORDER NAME ...    (SIZE: a power of two)

One member works at a time, until it meets the others. ``first``, ``last`` and ``random`` are the
orders in which they do: where a result depends on it, members write what others read. Members that
meet at different places, or of which one leaves while others wait, would wait for ever on a GPU.
Writes out the digests of ``golden.py``'s short runs.
"""

import json
import sys
import threading

import golden
import numpy as np

from marl_lanes.traffic import host
from marl_lanes.traffic.machine import team
from marl_lanes.traffic.step import run


class TeamError(Exception):
    """Members that would not find together on a GPU."""


class Crew:
    """Threads of which one works at a time.

    Args:
        size: the number of members.
        order: ``first``, ``last`` or ``random``: who goes on first where all have met.
    """

    is_team = True

    def __init__(self, size, order):
        self.size = size
        self._order = order
        self._random = np.random.default_rng(0)
        self._own = threading.local()
        self._turns = [threading.Semaphore(0) for _ in range(size)]
        self.num_meetings = 0

    @property
    def member(self):
        return self._own.member

    def gather(self, value):
        """The values of all members, once all have come here."""
        own = self.member
        self._places[own], self._values[own] = _find_place(), value
        self._hand_on()
        self._turns[own].acquire()
        if self._error is not None:
            raise self._error
        return self._met

    def _hand_on(self):
        """Let the next member work; where all have met, choose a new order."""
        if not self._waiting:
            self._close_round()
        self._turns[self._waiting.pop(0)].release()

    def _close_round(self):
        if len(set(self._places)) > 1 and self._error is None:
            self._error = TeamError(f"members are at {sorted(set(map(str, self._places)))}")
        self.num_meetings += 1
        self._met = list(self._values)
        self._places = ["left"] * self.size
        self._waiting = self._choose_order()

    def _choose_order(self):
        members = [number for number in range(self.size) if number not in self._gone]
        if self._order == "random":
            self._random.shuffle(members)
        return members if self._order != "last" else members[::-1]

    def run(self, *arguments):
        """What ``run`` does, by the team."""
        self._error, self._gone, failed = None, set(), []
        self._places, self._values = ["left"] * self.size, [None] * self.size
        self._waiting = self._choose_order()

        def work(number):
            self._own.member = number
            self._turns[number].acquire()
            try:
                run(*arguments)
            except BaseException as error:
                failed.append(error)
                self._error = self._error or TeamError("a member has failed")
            finally:
                self._gone.add(number)
                if len(self._gone) < self.size:
                    self._hand_on()

        threads = [threading.Thread(target=work, args=(number,)) for number in range(self.size)]
        for thread in threads:
            thread.start()
        self._turns[self._waiting.pop(0)].release()
        for thread in threads:
            thread.join()
        for error in sorted(failed, key=lambda error: isinstance(error, TeamError)):
            raise error


def _find_place():
    """Where in the kernels a member is: the file and line of every call."""
    frame, places = sys._getframe(2), []
    while frame is not None and frame.f_code.co_name != "work":
        if "marl_lanes" in frame.f_code.co_filename and "team.py" not in frame.f_code.co_filename:
            places.append((frame.f_code.co_name, frame.f_lineno))
        frame = frame.f_back
    return tuple(places)


def main():
    size, order, *names = sys.argv[1:]
    crew = team.crew = Crew(int(size), order)
    host.run = crew.run
    digests = {name: golden.record(name, **golden.SHORT) for name in names}
    json.dump({"digests": digests, "num_meetings": crew.num_meetings}, sys.stdout)


if __name__ == "__main__":
    main()
