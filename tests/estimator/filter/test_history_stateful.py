"""Any sequence of inserts, advances and slices keeps the history's invariants, and ends in the bits of punctual processing.

But for what came late and would have ended a published estimate: that is given up.
"""

from itertools import pairwise

from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from estimator.filter.alignment import InitialiseConfig, TrackerConfig
from estimator.filter.history import _CHECKPOINT_SAMPLES, History
from estimator.filter.tracker import Tracker
from estimator.sources.base.aid import Aid
from models.imu import Coast, ImuNoise
from models.messages import ImuSample, Reason
from models.sim.scenario import EPOCH_NS
from tests.estimator.scenes import SECOND, aid_of, pose_fix

HISTORY_S = 2.0
SPAN_NS = round(HISTORY_S * 1e9)
STEP_NS = 10_000_000
DIGESTED = 400  # samples after which everything late is worked in
STRETCH_NS = 120 * SECOND  # of the alignment, at most: its samples are kept

near_the_edge = st.sampled_from([SPAN_NS + d for d in (-STEP_NS, -1_000_000, -1, 0, 1, STEP_NS)])
lateness = st.one_of(st.integers(0, SPAN_NS), near_the_edge)


class Counted(History):
    """A history that counts how often what came late was given up, so that the published estimate could go on."""

    given_up = 0

    def _begin_at(self, tracker: Tracker) -> None:
        assert tracker.standing > self.tracker.standing
        self.given_up += 1
        super()._begin_at(tracker)


def _history() -> Counted:
    config = TrackerConfig(imu=ImuNoise(), coast=Coast(), initialise=InitialiseConfig(), origin=None)
    return Counted(Tracker(config), HISTORY_S)


class Flight(RuleBasedStateMachine):
    """IMU, fixes and time as they may come; what the history has accepted is kept, to be processed again in order."""

    def __init__(self) -> None:
        super().__init__()
        self.history = _history()
        self.now_ns = EPOCH_NS
        self.samples: dict[int, ImuSample] = {}  # by stamp
        self.aids: list[Aid] = []
        self.count = 0

    def _sample(self, t_ns: int) -> None:
        self.count += 1
        sample = ImuSample(t_ns, self.now_ns, (0.0, 1e-3 * (self.count % 5), 0.0), (0.0, 1e-2 * (self.count % 7), -9.8))
        if self.history.insert_sample(sample) is None:
            self.samples[t_ns] = sample

    def _fix(self, t_ns: int) -> None:
        self.count += 1
        aid = aid_of(pose_fix(t_ns, (0.01 * (self.count % 9), 0.0, 0.0)))
        if self.history.insert_aid(aid) is None:
            self.aids.append(aid)

    @initialize()
    def begins(self) -> None:
        self._sample(self.now_ns)
        self._fix(self.now_ns)
        self.samples_come(n=30, slices=True)

    @rule(n=st.integers(1, 120), slices=st.booleans())
    def samples_come(self, n: int, slices: bool) -> None:
        for _ in range(n):
            self.now_ns += STEP_NS
            self._sample(self.now_ns)
            self.history.advance(self.now_ns)
            if slices:
                self.history.catch_up()

    @rule(gap_ns=st.sampled_from([SECOND // 20, SECOND // 2, 3 * SECOND, 70 * SECOND]))
    def the_imu_pauses(self, gap_ns: int) -> None:
        self.now_ns += gap_ns
        self.samples_come(n=1, slices=True)

    @rule(late_ns=lateness)
    def a_sample_comes_late(self, late_ns: int) -> None:
        self._sample(self.now_ns - late_ns)

    @rule()
    def a_sample_comes_twice(self) -> None:
        assert self.history.insert_sample(self.samples[self.history.samples.newest_ns]) in {Reason.DUPLICATE, Reason.TOO_OLD}

    @rule(late_ns=lateness)
    def a_fix_comes(self, late_ns: int) -> None:
        self._fix(self.now_ns - late_ns)

    @rule(n=st.integers(2, 60), oldest_ns=lateness, newest_ns=lateness)
    def many_fixes_come_at_once(self, n: int, oldest_ns: int, newest_ns: int) -> None:
        for k in range(n):
            self._fix(self.now_ns - oldest_ns + k * (oldest_ns - newest_ns) // n)

    @rule()
    def a_fix_comes_twice(self) -> None:
        if self.aids:
            assert self.history.insert_aid(self.aids[-1]) in {Reason.DUPLICATE, Reason.TOO_OLD}

    @rule(ahead_ns=st.integers(1, SECOND))
    def a_fix_is_ahead_of_the_imu(self, ahead_ns: int) -> None:
        self._fix(self.now_ns + ahead_ns)

    @rule(by_ns=st.sampled_from([SECOND // 5, 2 * SECOND]))
    def a_tick_coasts(self, by_ns: int) -> None:
        """The IMU is silent; what it delivers afterwards lies before the time that was coasted to."""
        self.history.advance(self.now_ns + by_ns, coast=True)

    @rule()
    def a_slice_is_due(self) -> None:
        self.history.catch_up()

    @invariant()
    def the_parts_fit_together(self) -> None:
        h = self.history
        assert len(h._checkpoints) == len(h._checkpoint_times) >= 1
        assert all(a < b for a, b in pairwise(h._checkpoint_times))
        assert [c.core.t_ns for c in h._checkpoints] == h._checkpoint_times
        assert h._redo_from_ns is None or h._checkpoint_times[0] < h._redo_from_ns, "nothing to go back to"
        assert len(h._orders) == len(h._entries)
        assert all(a < b for a, b in pairwise(h._orders))
        assert [e.aid.order for e in h._entries] == h._orders
        assert 0 <= h._next <= len(h._orders)
        assert all(order[0] <= h.tracker.core.t_ns for order in h._orders[: h._next])
        since_ns = h.tracker.core.t_ns if h._redo_from_ns is None else min(h._redo_from_ns, h.tracker.core.t_ns)
        assert all(order[0] >= since_ns for order in h._orders[h._next :])  # a slice may end between two of one stamp
        assert not any(e.failed for e in h._entries)

    def teardown(self) -> None:
        self.now_ns = max(self.now_ns, *(a.t_ns for a in self.aids))
        self.samples_come(n=DIGESTED, slices=True)
        assert self.history._ahead is None
        assert self.history._redo_from_ns is None
        self._memory_is_bounded()
        if self.history.given_up:
            return
        punctual = _history()
        aids = sorted(self.aids, key=lambda a: a.t_ns)
        for sample in sorted(self.samples.values(), key=lambda s: s.t_ns):
            while aids and aids[0].t_ns <= sample.t_ns:
                assert punctual.insert_aid(aids.pop(0)) is None
            punctual.insert_sample(sample)
            punctual.advance(sample.t_ns)
        assert not aids
        ended, expected = self.history.tracker, punctual.tracker
        assert ended.core.t_ns == expected.core.t_ns
        assert (ended.core.hypotheses is None) == (expected.core.hypotheses is None)
        if ended.core.hypotheses is not None and expected.core.hypotheses is not None:
            assert ended.core.hypotheses.lead.x.tobytes() == expected.core.hypotheses.lead.x.tobytes()
            assert ended.core.hypotheses.lead.cov.tobytes() == expected.core.hypotheses.lead.cov.tobytes()

    def _memory_is_bounded(self) -> None:
        """By what lies within the span and the alignment, and one checkpoint before it."""
        h = self.history
        within = SPAN_NS + _CHECKPOINT_SAMPLES * STEP_NS
        assert all(t >= h.samples.newest_ns - within for t in h._checkpoint_times[1:])
        assert all(order[0] >= h.samples.newest_ns - within for order in h._orders)
        assert h.samples.count <= 2 * (SPAN_NS + 8 * SECOND + STRETCH_NS) // STEP_NS


TestFlight = Flight.TestCase
TestFlight.settings = settings(max_examples=25, stateful_step_count=50, phases=(Phase.explicit, Phase.reuse, Phase.generate))
