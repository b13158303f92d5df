"""A quintic polynomial to the target lane's centre, planned anew from the state at every time step.

Source: Werling, Ziegler, Kammel, Thrun 2010, "Optimal trajectory generation for dynamic street
scenarios in a Frenet frame": its lateral motion, with the weights of Eq. 7 in one constant.
"""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

COST_OF_TIME = 0.6
"""[m^2/s^6] K, found by trying: 0.2, 0.4, 0.8 and 1.6 cost more on ``paper``."""

DURATIONS = np.arange(0.8, 9.01, 0.2)
"""[s] The durations to choose from."""

_MIN_SPEED = 1.0
"""[m/s]"""


def steer_by_quintic(
    speed: FloatArray,
    deviation: FloatArray,
    yaw: FloatArray,
    relative_yaw_rate: FloatArray,
    time_step: float,
) -> FloatArray:
    """The yaw acceleration that reaches, one step ahead, the polynomial's lateral acceleration.

    The polynomial e(t) = c_0 + ... + c_5 t^5 goes from the present deviation, its rate -v psi and
    its acceleration -v w to zero in all three at T. Of these polynomials it is the one with the
    lowest integral of e'''^2 over the time, plus K T. A plan made on the way is then the rest of
    the first one, so the remaining time follows from the state.

    Args:
        speed: v, (N,) [m/s]; a lower speed than 1 m/s counts as 1 m/s.
        deviation: from the target lane's centre, (N,) [m].
        yaw: relative to the road, (N,) [rad].
        relative_yaw_rate: w, yaw rate minus the road's turning, (N,) [rad/s].
        time_step: [s].

    Returns:
        (N,) [rad/s^2], not clipped.
    """
    speed = np.maximum(speed, _MIN_SPEED)
    acceleration = -speed * relative_yaw_rate
    c3, c4, c5 = _find_cheapest(deviation, -speed * yaw, acceleration)
    change = 6.0 * c3 * time_step + 12.0 * c4 * time_step**2 + 20.0 * c5 * time_step**3
    return np.asarray(-change / (speed * time_step))


def _find_cheapest(e: FloatArray, rate: FloatArray, acceleration: FloatArray) -> FloatArray:
    """c_3, c_4 and c_5 of the cheapest duration, (3, N)."""
    t = DURATIONS
    e, rate, acceleration = (one[:, np.newaxis] for one in (e, rate, acceleration))
    c3 = -(20.0 * e + 12.0 * rate * t + 3.0 * acceleration * t**2) / (2.0 * t**3)
    c4 = (30.0 * e + 16.0 * rate * t + 3.0 * acceleration * t**2) / (2.0 * t**4)
    c5 = -(12.0 * e + 6.0 * rate * t + acceleration * t**2) / (2.0 * t**5)
    roughness = (
        36.0 * c3**2 * t
        + 144.0 * c3 * c4 * t**2
        + (192.0 * c4**2 + 240.0 * c3 * c5) * t**3
        + 720.0 * c4 * c5 * t**4
        + 720.0 * c5**2 * t**5
    )
    best = np.argmin(roughness + COST_OF_TIME * t, axis=1)
    return np.stack([c3, c4, c5])[:, np.arange(len(best)), best]
