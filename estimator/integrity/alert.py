"""The state of use: protection levels against alert limits, with hysteresis.

    usable       HPL, VPL at risk_per_hour within hal_m, val_m
    caution      not that, but at a hundred times the risk
    do not use   neither, or there is no estimate

Worse at once; better after 2 s within nine tenths of the limits.
"""

from typing import Final, NamedTuple

from estimator.integrity.config import IntegrityConfig
from models.messages import Alert

CAUTION_RISK: Final = 100.0  # times the risk
_RECOVER_NS: Final = 2_000_000_000
_RECOVERED: Final = 0.9  # of a limit
_ORDER: Final = (Alert.NOT_JUDGED, Alert.USABLE, Alert.CAUTION, Alert.DO_NOT_USE)


class Levels(NamedTuple):
    """HPL and VPL [m] at one risk."""

    hpl_m: float
    vpl_m: float

    def within(self, config: IntegrityConfig, share: float = 1.0) -> bool:
        """Whether they are inside so much of the alert limits."""
        return all(
            limit is None or level <= share * limit for level, limit in ((self.hpl_m, config.hal_m), (self.vpl_m, config.val_m))
        )


class Judge:
    """The state now, and since when a better one would do."""

    def __init__(self, config: IntegrityConfig) -> None:
        self._config = config
        self._state: Alert | None = None
        self._better_since_ns: int | None = None

    def judge(self, t_ns: int, at_risk: Levels, at_caution: Levels) -> Alert:
        """The state."""
        if self._config.hal_m is None and self._config.val_m is None:
            return Alert.NOT_JUDGED
        now = _state(at_risk, at_caution, self._config, 1.0)
        if self._state is None or _ORDER.index(now) >= _ORDER.index(self._state):
            self._state, self._better_since_ns = now, None
            return now
        surely = _state(at_risk, at_caution, self._config, _RECOVERED)
        if _ORDER.index(surely) >= _ORDER.index(self._state):
            self._better_since_ns = None
        elif self._better_since_ns is None or t_ns < self._better_since_ns:
            self._better_since_ns = t_ns
        elif t_ns - self._better_since_ns >= _RECOVER_NS:
            self._state, self._better_since_ns = surely, None
        return self._state


def _state(at_risk: Levels, at_caution: Levels, config: IntegrityConfig, share: float) -> Alert:
    if at_risk.within(config, share):
        return Alert.USABLE
    return Alert.CAUTION if at_caution.within(config, share) else Alert.DO_NOT_USE
