"""Messages that nobody should send, by the million, through decoder, estimator, encoder and the MAVLink link.

    python -m benchmarks.service.fuzz --messages 2000000 [--seeds 4] [--processes 2] [--out out/fuzz.jsonl] [--resume]

A flight is a vehicle on a circle with all sensors, in which a part of the messages (2, 20 or 60 %) is spoiled: fields of the
record (NaN, infinite, huge, denormal, negative), covariances (zero, asymmetric, indefinite, of 1e300 or 1e-300), stamps (late,
early, twice, far away), then bytes of the message (torn, longer, bits, counts of 2^32 - 1, another type). Every third flight
comes over MAVLink, spoiled likewise, field by field and byte by byte. The last two seconds of each are whole.

It counts the reasons given, and lists what must not happen: an exception anywhere, a decision "internal", an estimate that is
not sound, one that ends although the IMU goes on, a message that takes more than half a second. Each kind is listed once, with
what to do to see it again.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

from benchmarks.jobs import run_jobs
from benchmarks.service.fuzz_flight import Finding, FlightResult, fly
from benchmarks.service.fuzz_messages import per_flight


def work(job: tuple[int, int]) -> FlightResult:
    """One flight: seed and number."""
    return fly(*job)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=200_000, help="at least so many in all, spoiled or not")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz.jsonl"), help="each flight's result, as it comes")
    parser.add_argument("--found", type=Path, help="where findings are written down for a person to read")
    parser.add_argument("--resume", action="store_true", help="flights in --out are not flown again")
    given = parser.parse_args()
    flights = -(-given.messages // per_flight())
    jobs = [(1 + k % given.seeds, k // given.seeds) for k in range(flights)]
    results = run_jobs(jobs, work, FlightResult, given.out, processes=given.processes, resume=given.resume)
    _tell(results, given.found)
    sys.exit(any(r.findings for r in results))


def _tell(results: list[FlightResult], path: Path | None) -> None:
    reasons: Counter[str] = Counter()
    findings: dict[str, tuple[int, Finding]] = {}
    for result in results:
        reasons.update(result.reasons)
        for finding in result.findings:
            count, first = findings.get(finding.what, (0, finding))
            findings[finding.what] = count + finding.count, min(first, finding, key=lambda f: len(f.reproduction))
    messages, spoiled = sum(r.messages for r in results), sum(r.spoiled for r in results)
    print(
        f"{len(results)} flights, {messages} messages, {spoiled} of them spoiled; slowest {max(r.slowest_ms for r in results)} ms"
    )
    for reason, count in sorted(reasons.items()):
        print(f"{count:9d}  {reason}")
    text = "".join(f"\n## {what}\n{count} times. {f.detail}\n{f.reproduction}\n" for what, (count, f) in findings.items())
    print(text or "nothing found")
    if path:
        path.write_text(text)


if __name__ == "__main__":
    main()
