"""Result of an import."""

import msgspec

from logs.findings import Finding, together


class TopicRow(msgspec.Struct, frozen=True):
    """A topic of a bag; use: [inputs] key or empty; copied: in the log."""

    topic: str
    type: str
    messages: int
    rate_hz: float
    use: str = ""
    remark: str = ""
    copied: bool = False


class ImportSummary(msgspec.Struct, frozen=True):
    """topics: of a bag."""

    out: str
    config: str
    messages: dict[str, int]
    start_ns: int
    end_ns: int
    notes: tuple[str, ...]
    topics: tuple[TopicRow, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def seconds(self) -> float:
        """Length of the log."""
        return (self.end_ns - self.start_ns) * 1e-9

    def __str__(self) -> str:
        counts = ", ".join(f"{topic} {n}" for topic, n in self.messages.items())
        lines = [f"{self.seconds:.1f} s: {counts}", f"configuration: {self.config}", *(f"note: {note}" for note in self.notes)]
        lines += [f"at fault: {finding}" for finding in together(self.findings)]
        return "\n".join(lines)
