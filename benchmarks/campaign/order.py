"""Late and shuffled fixes: is anything lost for its age or order, and is the final state that of punctual fixes, to the bit?

Delays are drawn anew for each fix from 0 to 5 s, so that fixes overtake each other; the same values arrive punctually in the run
that is compared. Gates are on. What comes late is worked in behind the outputs, so the IMU goes on for a while after the flight.
"""

from collections import Counter
from collections.abc import Iterator, Sequence

import msgspec

from benchmarks.campaign.flights import IMU_HZ
from estimator.fusion import Fusion, FusionConfig
from models.messages import AidStatus, Estimate, ImuSample, Input, Reason
from models.sim.aids import PoseFixes
from models.sim.scenario import Scenario, Simulation, simulate
from models.sim.sensors import Imu
from models.sim.trajectory import FixedWing

DELAY_S = (0.0, 5.0)
WORKED_IN_S = 2.0
DURATIONS_S = {0.05: 200.0, 0.5: 60.0, 5.0: 25.0, 30.0: 6.0}  # by the rate of the fixes, Hz


class Orders(msgspec.Struct, frozen=True):
    """What became of the late fixes of one run.

    aligned: there was an estimate in the end; identical: its state and covariance have the bytes of the punctual run's.
    """

    fixes: dict[str, int]
    aligned: bool
    identical: bool


class OrderResult(msgspec.Struct, frozen=True):
    """All runs of one source: valid measurements, those gated, those lost for another reason, runs with identical end."""

    name: str
    runs: int
    aligned: int
    fixes: int
    gated: int
    lost: int
    identical: int


def sources() -> dict[str, Scenario]:
    """Punctual scenarios by name."""
    imu = Imu(rate_hz=IMU_HZ)
    return {
        f"pose {rate:g} Hz": Scenario(duration_s=duration, vehicle=FixedWing(), imu=imu, pose_fix=PoseFixes(rate_hz=rate))
        for rate, duration in DURATIONS_S.items()
    }


def late(punctual: Scenario) -> Scenario:
    """The same measurements, delayed at random and so out of order."""
    assert punctual.pose_fix is not None
    return msgspec.structs.replace(punctual, pose_fix=msgspec.structs.replace(punctual.pose_fix, delay_s=DELAY_S))


def run(name: str, seed: int) -> Orders:
    """One seed of a source, late against punctual."""
    punctual = sources()[name]
    simulation = simulate(late(punctual), seed)
    end, reasons = final(simulation)
    reference, _ = final(simulate(punctual, seed))
    identical = (
        end is not None
        and reference is not None
        and end.t_ns == reference.t_ns
        and end.nav.tobytes() == reference.nav.tobytes()
        and end.covariance.tobytes() == reference.covariance.tobytes()
    )
    return Orders(dict(Counter(reasons)), end is not None, identical)


def final(simulation: Simulation) -> tuple[Estimate | None, list[Reason]]:
    """The last estimate, None where the filter never aligned, and the last word on every measurement."""
    origin = simulation.origin
    fusion = Fusion(FusionConfig(imu=simulation.imu_noise, origin=origin.lla if origin else None))
    last: Estimate | None = None
    reasons: dict[tuple[int, str, str], Reason] = {}
    for message in (*simulation.messages, *_afterwards(simulation)):
        for output in fusion.handle(message):
            if isinstance(output, Estimate):
                last = output
            elif isinstance(output, AidStatus):
                reasons[output.t_ns, output.topic, output.kind] = output.reason
    return last, list(reasons.values())


def _afterwards(simulation: Simulation) -> Iterator[Input]:
    """The last IMU sample again and again, after everything has arrived."""
    last = max((m for m in simulation.messages if isinstance(m, ImuSample)), key=lambda m: m.t_ns)
    arrived_ns, step_ns = max(m.arrived_ns for m in simulation.messages), round(1e9 / IMU_HZ)
    for k in range(1, round(WORKED_IN_S * IMU_HZ)):
        yield ImuSample(last.t_ns + k * step_ns, arrived_ns + k * step_ns, last.gyro_b, last.accel_b)


def judge(name: str, runs: Sequence[Orders]) -> OrderResult:
    """The sums."""
    fixes: Counter[str] = Counter()
    for each in runs:
        fixes.update(each.fixes)
    entered = sum(fixes[reason] for reason in (Reason.FUSED, Reason.ALIGNING))
    gated, total = fixes[Reason.GATED], fixes.total()
    aligned, identical = sum(each.aligned for each in runs), sum(each.identical for each in runs)
    return OrderResult(name, len(runs), aligned, total, gated, total - entered - gated, identical)
