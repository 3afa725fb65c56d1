"""Exact rewind: the estimate is a function of the set of measurements, ordered by validity.

A late measurement returns the tracker to the checkpoint before it, gates and source machines included: late = punctual, to the
bit. Checkpoints stand at IMU samples and aids only.

Behind each output a slice, cut by stamps, is redone, while the former tracker goes on by the IMU. If the redone one loses
estimate or heading, the former goes on for `history_s`. A measurement that raises is INTERNAL and passed over.
"""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from estimator.filter.alignment import NEVER, Decision
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.quiet import Quiet
from estimator.filter.tracker import Tracker
from estimator.sources.base.aid import Aid
from models.messages import Array, ImuSample, Reason

_CHECKPOINT_SAMPLES = 128  # IMU samples between checkpoints: one costs about as much as going through thirty again
_MEASUREMENT_NS = 2_500_000  # between two samples, of what came late, one for each so long: a slice fits into the time
_TICK_MEASUREMENT_NS = 5_000_000  # between two ticks, one for each so long: samples that wait need the rest of the time
_PACE = 2  # a slice covers this many times the interval between the newest two samples
_LEVELLING_NS = 6_000_000_000  # IMU kept before the oldest checkpoint, or what it may go through again, for the alignment


@dataclass(slots=True, eq=False)
class Entry:
    """failed: processing raised."""

    aid: Aid
    decision: Decision | None = None
    revision: int = -1
    replayed: int = 0
    counted: Reason | None = None
    failed: bool = False


class History:
    """Samples, aids and checkpoints of the last `history_s`."""

    def __init__(self, tracker: Tracker, history_s: float, samples: ImuBuffer | None = None) -> None:
        self.samples = samples or ImuBuffer()
        self.tracker = tracker
        self._span_ns, self._gap_ns = int(history_s * 1e9), round(tracker.core.config.coast.gap_s * 1e9)
        self._orders: list[tuple[int, str, str, bytes]] = []
        self._entries: list[Entry] = []
        self._next = 0  # first entry that the tracker has not seen
        self._checkpoints = [tracker.copy()]
        self._checkpoint_times = [tracker.core.t_ns]
        self._since_checkpoint = 0  # IMU samples
        self._redo_from_ns: int | None = None
        self._ahead: Tracker | None = None  # publishes while `tracker` works in what came late
        self._ahead_since_ns = 0
        self._due = False  # a slice of that work
        self._coasted_ns = NEVER
        self._changed: list[Entry] = []
        self.quiet: Quiet | None = None  # where the next sample has nothing to do but to be gone through

    def from_last_sound(self) -> "History | None":
        """From the newest sound checkpoint with the IMU samples, no aid; or None."""
        for tracker in reversed(self._checkpoints):
            if tracker.is_sound:
                return History(tracker.copy(), self._span_ns * 1e-9, self.samples)
        return None

    def insert_sample(self, sample: ImuSample) -> Reason | None:
        """Insert an IMU sample; the reason where it is refused."""
        self.quiet = None
        if sample.t_ns <= self._checkpoint_times[0]:
            return Reason.TOO_OLD
        if sample.t_ns > self.samples.newest_ns:
            before_ns = self.samples.newest_ns
            self.samples.insert(sample)
            if self._checkpoint_times[0] <= before_ns < self.tracker.core.t_ns:  # the IMU was missing and the tracker has coasted
                self._rewind_to(before_ns + 1)
            return None
        before = self.samples.first_after(sample.t_ns - 1) - 1  # the sample changes the whole interval that it splits
        if before < 0 and self.samples.has_forgotten:
            return Reason.TOO_OLD
        # A new first sample also changes what becomes of a measurement shortly before it, with which the alignment may begin.
        before_ns = int(self.samples.t_ns[before]) if before >= 0 else sample.t_ns - 1 - self._gap_ns
        if before_ns < max(self._checkpoint_times[0], self.samples.newest_ns - self._span_ns):
            return Reason.TOO_OLD
        if not self.samples.insert(sample):
            return Reason.DUPLICATE
        self._rewind_to(before_ns + 1)
        return None

    def change_imu(self, since_ns: int, samples: list[ImuSample]) -> int:
        """Samples after since_ns replaced by another IMU's; from when on."""
        self.quiet = None
        since_ns = max(since_ns, self._checkpoint_times[0] + 1, self.samples.newest_ns - self._span_ns)
        self.samples.cut(since_ns)
        for sample in samples:
            if sample.t_ns > since_ns:
                self.samples.insert(sample)
        self._rewind_to(since_ns + 1)
        return since_ns

    def insert_aid(self, aid: Aid) -> Reason | None:
        """Insert an aid; the reason where it is refused."""
        since_ns = aid.begin.t_ns if aid.begin is not None else aid.t_ns
        if since_ns <= self._checkpoint_times[0] or since_ns < self.samples.newest_ns - self._span_ns:
            return Reason.TOO_OLD
        if not self._place(aid):
            return Reason.DUPLICATE
        if aid.begin is not None:
            self._place(aid.begin)
        return None

    def _place(self, aid: Aid) -> bool:
        self.quiet = None
        k = bisect_left(self._orders, aid.order)
        if k < len(self._orders) and self._orders[k] == aid.order:
            return False
        self._orders.insert(k, aid.order)
        entry = Entry(aid)
        self._entries.insert(k, entry)
        if aid.t_ns <= self.tracker.core.t_ns:
            self._next += k <= self._next  # the tracker is beyond it, and goes back for it
            entry.replayed = self.samples.count - self.samples.first_after(aid.t_ns)
            self._rewind_to(aid.t_ns)
        return True

    def advance(self, to_ns: int, *, coast: bool = False) -> Tracker:
        """The tracker at `to_ns`, for publication, without late measurements until they are worked in.

        coast: beyond the newest IMU sample, with some of the waiting measurements; a late IMU sample takes it back.
        """
        self.quiet = None
        if self._redo_from_ns is not None and self._ahead is None:
            self._ahead, self._ahead_since_ns = self.tracker, self.tracker.core.t_ns
            self._restore()
        if self._ahead is not None:
            if not coast and self._ahead.core.t_ns <= to_ns:  # else it has coasted beyond
                self._ahead.propagate(self.samples, to_ns)
                self._due = True
                return self._ahead
            if self._redo_from_ns is not None:
                self._restore()
        if not coast:
            self._go_through(min(to_ns, self.samples.newest_ns))
        elif not self._coast(to_ns):
            return self._ahead or self.tracker
        self._hand_over()
        if not coast and self._is_quiet:
            self.quiet = Quiet(self.tracker, self.samples, _CHECKPOINT_SAMPLES - 1 - self._since_checkpoint)
        return self._ahead or self.tracker

    @property
    def _is_quiet(self) -> bool:
        return (
            self.tracker.core.t_ns == self.samples.newest_ns
            and self._next == len(self._orders)
            and self._since_checkpoint < _CHECKPOINT_SAMPLES - 1
            and self._redo_from_ns is None
            and self._ahead is None
            and self.tracker.alignment.shown is not None
        )

    def take_next(self, sample: ImuSample, quiet: Quiet) -> tuple[Array, Array] | None:
        """Quiet.take; a checkpoint is due at its end."""
        self._since_checkpoint += 1
        shown = quiet.take(sample)
        if shown is None or not quiet.left:
            self.quiet = None
        return shown

    def _coast(self, to_ns: int) -> bool:
        interval_ns = to_ns - max(self.samples.newest_ns, self._coasted_ns)
        self._coasted_ns = to_ns
        self._go_through(to_ns, self._slice(interval_ns, _TICK_MEASUREMENT_NS))
        return not self._waiting(to_ns)

    def _slice(self, interval_ns: int, measurement_ns: int) -> int:
        return max(1, interval_ns // measurement_ns, self._waiting(self.tracker.core.t_ns + _PACE * interval_ns))

    def catch_up(self) -> None:
        """Work in a slice of late measurements."""
        if not self._due:
            return
        self._due = False
        newest_ns = self.samples.newest_ns
        self._go_through(newest_ns, self._slice(newest_ns - self.samples.previous_ns, _MEASUREMENT_NS))
        if self.tracker.core.t_ns >= newest_ns:
            self._hand_over()

    def _hand_over(self) -> None:
        """Publish from the caught-up tracker, unless that would end a published estimate."""
        ahead = self._ahead
        if ahead is None:
            return
        if self.tracker.standing >= ahead.standing:
            self._ahead = None
        elif ahead.core.t_ns - self._ahead_since_ns > self._span_ns:
            self._ahead = None
            self._begin_at(ahead)
        elif self._redo_from_ns is not None:
            self._restore()

    def _begin_at(self, tracker: Tracker) -> None:
        self.tracker, self._redo_from_ns, self._since_checkpoint = tracker, None, 0
        self._checkpoints, self._checkpoint_times = [tracker.copy()], [tracker.core.t_ns]
        done = bisect_right(self._orders, tracker.core.t_ns, key=lambda order: order[0])
        del self._entries[:done], self._orders[:done]
        self._next = 0

    def changed(self) -> list[Entry]:
        """Entries whose decision differs from the reported one."""
        if not self._changed:  # nearly every call
            return []
        changed = [e for e in set(self._changed) if e.decision is not None and e.counted is not e.decision.reason]
        self._changed.clear()
        for entry in changed:
            entry.revision += 1
        return sorted(changed, key=lambda e: e.aid.order)

    def _decide(self, entry: Entry, decision: Decision) -> None:
        is_new = entry.decision is None or entry.decision.reason is not decision.reason
        if is_new and (entry.aid.is_reported or decision.reason is Reason.INTERNAL):
            self._changed.append(entry)
        entry.decision = decision

    def _go_through(self, to_ns: int, most: int | None = None) -> None:
        if self._next == len(self._orders) or self._take(to_ns, most):  # nearly every call there is none
            self._propagate(min(to_ns, self.samples.newest_ns))
        if self._since_checkpoint >= _CHECKPOINT_SAMPLES and not self._waiting(
            self.tracker.core.t_ns
        ):  # all of one stamp, or none
            self._checkpoint()

    def _waiting(self, to_ns: int) -> int:
        return bisect_right(self._orders, to_ns, lo=self._next, key=lambda order: order[0]) - self._next

    def _take(self, to_ns: int, most: int | None) -> bool:
        wanted = self._waiting(to_ns)
        left = wanted if most is None else min(wanted, most)
        is_all = left == wanted
        while left > 0:
            entry = self._entries[self._next]
            self._propagate(entry.aid.t_ns)
            if entry.failed or self._process(entry):
                self._next += 1
                self._since_checkpoint = _CHECKPOINT_SAMPLES  # it costs more than so many samples
                left -= 1
            else:  # gone back to before it
                left = self._waiting(to_ns) if is_all else left
        return is_all

    def _process(self, entry: Entry) -> bool:
        """False: it raised or the state is not finite; it is marked, and the tracker is the checkpoint's."""
        was_sound = self.tracker.is_sound
        try:
            decision = self.tracker.process(entry.aid, self.samples)
            if was_sound and not self.tracker.is_sound:
                raise ArithmeticError("the state is not finite after it")
        except Exception as error:
            entry.failed = True
            self._decide(entry, Decision(Reason.INTERNAL, detail=f"internal error: {type(error).__name__}: {error}"))
            self._rewind_to(entry.aid.t_ns)
            self._restore()
            return False
        self._decide(entry, decision)
        return True

    def _propagate(self, to_ns: int) -> None:
        samples, tracker = self.samples, self.tracker
        while tracker.core.t_ns < to_ns:
            if self._since_checkpoint >= _CHECKPOINT_SAMPLES:
                self._checkpoint()
            begin = samples.first_after(tracker.core.t_ns)
            count = min(samples.first_after(to_ns) - begin, _CHECKPOINT_SAMPLES)
            tracker.propagate(samples, to_ns if count < _CHECKPOINT_SAMPLES else int(samples.t_ns[begin + count - 1]))
            self._since_checkpoint += count

    def _checkpoint(self) -> None:
        self._checkpoints.append(self.tracker.copy())
        self._checkpoint_times.append(self.tracker.core.t_ns)
        self._since_checkpoint = 0
        horizon = self.samples.newest_ns - self._span_ns
        if self._redo_from_ns is not None:  # what waits to be redone needs a checkpoint before it
            horizon = min(horizon, self._redo_from_ns - 1)
        keep = bisect_right(self._checkpoint_times, horizon) - 1  # the newest that is older than the horizon
        if keep <= 0:
            return
        del self._checkpoints[:keep], self._checkpoint_times[:keep]
        oldest = self._checkpoint_times[0]
        self.samples.forget_before(min(oldest, self._checkpoints[0].needs_from_ns) - _LEVELLING_NS)
        drop = 0
        while drop < self._next and self._entries[drop].aid.t_ns <= oldest:
            drop += 1
        if drop:
            del self._entries[:drop], self._orders[:drop]
            self._next -= drop

    def _rewind_to(self, t_ns: int) -> None:
        self._redo_from_ns = t_ns if self._redo_from_ns is None else min(self._redo_from_ns, t_ns)

    def _restore(self) -> None:
        assert self._redo_from_ns is not None
        k = bisect_left(self._checkpoint_times, self._redo_from_ns) - 1
        del self._checkpoints[k + 1 :], self._checkpoint_times[k + 1 :]
        self.tracker = self._checkpoints[k].copy()
        at = self.tracker.core.t_ns
        self._next = bisect_right(self._orders, at, key=lambda order: order[0])
        self._since_checkpoint = 0
        self._redo_from_ns = None
