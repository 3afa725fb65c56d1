"""A start without GNSS: position, and perhaps heading, of a vehicle that stands still.

Sent as fixes that share one error (LandmarkFix.landmark_errors), so that ten are worth one, until [rest] is confirmed, which
holds the estimate until the vehicle moves.
"""

import math
import time
from typing import Final

import msgspec
import numpy as np
import zenoh

from estimator.service import monitor
from estimator.service.zenoh.bus import BusError
from estimator.service.zenoh.keys import rmw_key
from logs.wire import schemas
from logs.wire.codec import encode_input
from models.messages import LandmarkFix, Vec3

_TOPIC: Final = "/landfix/fix"
_NAME: Final = "typed"  # of the one error, among those of landmarks
_STILL_M, _STILL_RAD = 0.02, math.radians(0.5)  # sigma, by which a vehicle that stands moves between two fixes
_TILT_RAD: Final = math.radians(10.0)  # of the ground that it stands on
_NOT_GIVEN: Final = 1e6
EVERY_S: Final = 0.2  # so that the velocity is known to 0.2 m/s, or nothing confirms a rest, with the IMU of a toy as well
LEAST_S: Final = 6.0  # of 3 s of rest, an update each second, and the start
_WAITING: Final = frozenset({"starting", "aligning", "aligning_heading"})


class Start(msgspec.Struct, frozen=True):
    """p_n [m] and sigma; heading from north [rad] and sigma, or None."""

    p_n: Vec3
    sigma_m: float
    heading: float | None = None
    heading_sigma: float = 0.0

    def fix(self, t_ns: int) -> LandmarkFix:
        """At t_ns, for a vehicle that stands level to 10 degrees."""
        given = self.heading is not None
        attitude = np.full(3, _STILL_RAD**2 if given else _NOT_GIVEN)
        sigmas = [self.sigma_m] * 3 + ([_TILT_RAD, _TILT_RAD, self.heading_sigma] if given else [0.0] * 3)
        errors, half = np.diag(sigmas), 0.5 * (self.heading or 0.0)
        return LandmarkFix(
            t_ns=t_ns,
            arrived_ns=t_ns,
            p_n=self.p_n,
            q_nb_wxyz=(math.cos(half), 0.0, 0.0, math.sin(half)),
            covariance=np.diag(np.r_[np.full(3, _STILL_M**2), attitude]),
            covariance_common=errors**2,
            landmarks=(_NAME,),
            similarity=1.0,
            residual_px=0.0,
            landmark_errors=errors[None],
        )


def start(session: zenoh.Session, domain: int, given: Start, patience_s: float) -> float:
    """Send it until the daemon has an estimate with a heading, LEAST_S at least; how long the estimate took, s.

    Raises BusError: there is an estimate already, or none comes.
    """
    if (mode := _mode(session)) not in _WAITING:
        raise BusError(f"the daemon has an estimate already (mode {mode}); a start is for one that has none")
    key, began_s = rmw_key(domain, _TOPIC, schemas.LANDMARK_FIX, schemas.type_hash(schemas.LANDMARK_FIX)), time.monotonic()
    begun_s: float | None = None
    while (waited_s := time.monotonic() - began_s) < patience_s:
        session.put(key, encode_input(given.fix(time.time_ns())).data)
        time.sleep(EVERY_S)
        if begun_s is None and (mode := _mode(session)) not in _WAITING:
            begun_s = waited_s
        if begun_s is not None and waited_s >= LEAST_S:
            return begun_s
    raise BusError(f"no estimate with a heading after {patience_s:g} s (mode {mode}): landfix monitor says what is missing")


def _mode(session: zenoh.Session) -> str:
    health = msgspec.json.decode(monitor.asked(session, "status"))["health"]
    return str(health["mode"]) if health else "starting"
