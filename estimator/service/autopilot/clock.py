"""The autopilot's clock: from TIMESYNC within half a round trip, else from its messages.

Off by over two seconds: implausible; five in a row: a reboot.
"""

from typing import Final

from estimator.service.base.clock import SECOND_NS, Offset

_IMPLAUSIBLE_NS: Final = 2 * SECOND_NS
_REBOOT_COUNT: Final = 5
_QUICKEST_NS: Final = SECOND_NS // 1000
_OPEN_QUESTIONS: Final = 16


class AutopilotClock:
    """Its stamps on our clock."""

    def __init__(self) -> None:
        self._quick, self._synced = Offset(_QUICKEST_NS), Offset(0)
        self._asked: list[int] = []
        self._implausible_in_a_row = 0
        self.implausible = self.reboots = self.answers = 0

    @property
    def offset(self) -> Offset:
        """The better of the two offsets."""
        return self._quick if self._synced.ahead_ns is None else self._synced

    def ask(self, now_ns: int) -> int:
        """ts1 of a question sent now."""
        self._asked = [*self._asked[1 - _OPEN_QUESTIONS :], now_ns]
        return now_ns

    def answer(self, ts1: int, tc1: int, now_ns: int) -> None:
        """A question was answered; ours counts, once."""
        if ts1 not in self._asked:
            return
        self._asked.remove(ts1)
        if self._plausible(tc1, now_ns):
            self.answers += 1
            self._synced.round_trip(ts1, tc1, now_ns)

    def t_ns(self, stamp_ns: int, now_ns: int) -> int | None:
        """A stamp on our clock; None: not plausible."""
        if not self._plausible(stamp_ns, now_ns):
            return None
        self._quick.one_way(stamp_ns, now_ns)
        return self.offset.ours(stamp_ns)

    def hear(self, stamp_ns: int, now_ns: int) -> None:
        """A coarse time since boot, to detect a reboot."""
        self._plausible(stamp_ns, now_ns)

    def _plausible(self, stamp_ns: int, now_ns: int) -> bool:
        expected_ns = self.offset.theirs(now_ns)
        if expected_ns is None or abs(stamp_ns - expected_ns) <= _IMPLAUSIBLE_NS:
            self._implausible_in_a_row = 0
            return True
        self.implausible += 1
        self._implausible_in_a_row += 1
        if self._implausible_in_a_row < _REBOOT_COUNT:
            return False
        self.reboots += 1
        self._implausible_in_a_row = 0
        self._quick, self._synced, self._asked = Offset(_QUICKEST_NS), Offset(0), []
        return True
