"""Evidence from the IMU alone: rest, drag of a multirotor, held readings in motion."""

import numpy as np

from estimator.filter.alignment import NO_POSITION, Core
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.relinearise import Stretch
from estimator.sources import rest
from estimator.sources.air import drag
from estimator.sources.base import held
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.rest import Rest
from models import so3
from models.measurements import Measurement
from models.messages import Reason
from models.state import X

FELT = frozenset({rest.TOPIC, drag.TOPIC})  # kinds of aids that ask the IMU
_MOVES = 2  # velocities, seconds apart, that are not zero: what looks at rest goes on so
_NO_RATE = np.zeros(3)


class ImuEvidence:
    """since: start of the rest; asked_ns: when it was asked for; refuted: positions that showed motion since the IMU did; same:
    last value and since when, by topic.
    """

    def __init__(self, core: Core) -> None:
        self.core = core
        self.since: tuple[int, float] | None = None
        self.asked_ns = self.refuted = 0
        self.same: dict[str, tuple[bytes, int]] = {}

    def copy(self, core: Core) -> "ImuEvidence":
        """An independent one in the same state, of another core."""
        other = object.__new__(ImuEvidence)
        other.core, other.since, other.asked_ns, other.refuted = core, self.since, self.asked_ns, self.refuted
        other.same = self.same.copy()
        return other

    def felt(self, aid: Aid, samples: ImuBuffer) -> tuple[Aid, Measurement | Refusal]:
        """Evidence of the IMU alone: rest, drag."""
        core = self.core
        if aid.kind == rest.TOPIC:
            return aid, self._rest(samples)
        config = core.config.drag
        second, begin = core.recent(samples), samples.first_after(core.t_ns - drag.EVERY_NS)
        u = samples.u[begin : samples.first_after(core.t_ns)]
        if second is None or not len(u) or not core.is_aligned:
            return aid, Refusal(Reason.THINNED, NO_POSITION)
        if rest.is_quiet(second):
            return aid, Refusal(Reason.THINNED, "at rest")
        return drag.felt(aid, u, config)

    def _rest(self, samples: ImuBuffer) -> Rest | Refusal:
        core = self.core
        rules, u = core.config.rest, core.recent(samples)
        unasked_ns, self.asked_ns = core.t_ns - self.asked_ns, core.t_ns
        if unasked_ns > rest.AFTER_NS:  # it may have flown
            self._end()
            self.refuted = 0
        if u is None or not core.is_aligned or core.hypotheses is None or not rest.is_quiet(u):
            self._end()
            self.refuted = 0
            return Refusal(Reason.THINNED, "in motion" if core.is_aligned else NO_POSITION)
        lead = core.hypotheses.lead
        if self.since is None:
            self.since = core.t_ns, so3.to_euler(lead.x[X.Q])[2]
        since_ns, azimuth = self.since
        if core.t_ns - since_ns < rest.AFTER_NS:
            return Refusal(Reason.THINNED, "at rest for a moment")
        why = rest.objection(lead.x, lead.cov, rules)
        if why or self.refuted >= _MOVES:
            self._end()  # it has to look at rest for as long again
            self.refuted += core.is_aided
            return Refusal(Reason.GATED, why or "looks at rest, but positions have shown that it moves")
        core.stretch = None  # a run would leave out what rest has shown, and rest is linear
        earth_n = core.origin.earth_rate_n if core.origin is not None else _NO_RATE
        return rest.at_rest(u, azimuth, earth_n, rules)

    def _end(self) -> None:
        """The next rest has a heading of its own."""
        core = self.core
        if self.since is not None and core.is_aligned and core.hypotheses is not None:
            core.hypotheses.forget(rest.BLOCK)
            core.stretch = Stretch.of(core.hypotheses.lead)
        self.since = None

    def is_held(self, aid: Aid, z: Measurement, samples: ImuBuffer) -> bool:
        """It reads the same as before, though the vehicle moves."""
        core = self.core
        reading = held.content(z, aid.order[-1])
        known, since_ns = self.same.get(aid.topic, (b"", 0))
        if known != reading:
            self.same[aid.topic] = reading, aid.t_ns
            return False
        if aid.t_ns - since_ns < held.spares_ns(z, aid.kind):
            return False
        second = core.recent(samples)
        if second is None:
            return False
        bank = core.hypotheses if core.is_aligned else None
        return not rest.is_quiet(second) or (bank is not None and held.moves(bank.lead.x, bank.lead.cov))
