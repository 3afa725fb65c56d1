"""What the estimator's tests share: simulated flights, a Fusion that is driven through them, and what came out."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import msgspec
import numpy as np

from estimator.config import parse
from estimator.fusion import Fusion, FusionConfig
from estimator.sources.base.aid import Aid
from estimator.sources.pose import PoseConfig, pose_aid
from models import so3
from models.messages import AidStatus, Array, Estimate, Health, ImuSample, Input, Mode, PoseFix, Reason, Reset, Vec3, vec3
from models.radius import reach
from models.sim.scenario import EPOCH_NS, Simulation, Truth, simulate
from models.sim.scenario_file import loads
from models.state import E, X, local

SECOND = 10**9

# GNSS is lost and comes back; a third of the fixes is false; four in a row are wrong by the same offset.
FAULTY = """
duration_s = 16.0
[vehicle]
kind = "multirotor"
seed = 3
[imu]
rate_hz = 50.0
[gnss]
rate_hz = 2.0
outages_s = [[4.0, 7.5]]
[pose_fix]
rate_hz = 3.0
outlier_share = 0.3
outages_s = [[5.0, 6.0]]
false_spans = [{ start_s = 7.0, end_s = 8.4, offset_n_m = [4.0, 3.0, 0.0] }]
"""


@dataclass(slots=True)
class Run:
    """A Fusion and everything it has said, by kind."""

    fusion: Fusion
    estimates: list[Estimate] = field(default_factory=list)
    statuses: list[AidStatus] = field(default_factory=list)
    health: list[Health] = field(default_factory=list)
    resets: list[Reset] = field(default_factory=list)

    def feed(self, messages: Iterable[Input]) -> "Run":
        """Drive the Fusion through the messages."""
        for message in messages:
            for out in self.fusion.handle(message):
                match out:
                    case Estimate():
                        self.estimates.append(out)
                    case AidStatus():
                        self.statuses.append(out)
                    case Health():
                        self.health.append(out)
                    case Reset():
                        self.resets.append(out)
        return self

    @property
    def aligned(self) -> list[Estimate]:
        """The estimates with a heading."""
        return [e for e in self.estimates if e.mode is not Mode.ALIGNING_HEADING]

    def last_words(self, topic: str) -> dict[tuple[int, str], AidStatus]:
        """The highest revision of what was said about each measurement of a topic, by (t_ns, kind)."""
        words: dict[tuple[int, str], AidStatus] = {}
        for status in sorted((s for s in self.statuses if s.topic == topic), key=lambda s: s.revision):
            words[status.t_ns, status.kind] = status
        return words

    def reasons(self, topic: str) -> dict[Reason, int]:
        """How many measurements of a topic ended with which reason."""
        final = [s.reason for s in self.last_words(topic).values()]
        return {reason: final.count(reason) for reason in set(final)}

    def internal_errors(self) -> list[str]:
        """Details of the defects that were survived."""
        return [s.detail for s in self.statuses if s.reason is Reason.INTERNAL]


def simulated(toml: str, seed: int = 1) -> Simulation:
    """The run of a scenario given as TOML text."""
    return simulate(loads(toml), seed)


def config_of(simulation: Simulation) -> FusionConfig:
    """What an engineer would configure for it."""
    return parse(simulation.config_toml).fusion()


def fly(simulation: Simulation, config: FusionConfig | None = None, messages: Iterable[Input] | None = None) -> Run:
    """A Fusion driven through a simulation (or through other messages with its configuration)."""
    return Run(Fusion(config or config_of(simulation))).feed(simulation.messages if messages is None else messages)


def true_state(truth: Truth, t_ns: int) -> Array:
    """The packed true state (16,) at an IMU sample's time."""
    k = int(np.searchsorted(truth.t_ns, t_ns))
    assert truth.t_ns[k] == t_ns, "truth is known at IMU samples"
    x = np.empty(X.SIZE)
    x[X.P], x[X.V], x[X.Q] = truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k]
    x[X.BG], x[X.BA] = truth.gyro_bias[k], truth.accel_bias[k]
    return x


def error(estimate: Estimate, truth: Truth) -> Array:
    """Error state (15,) of an estimate."""
    return local(estimate.nav, true_state(truth, estimate.t_ns))


def position_errors(estimates: Iterable[Estimate], truth: Truth) -> Array:
    """Distance of each estimate from the true position, m."""
    return np.array([np.linalg.norm(error(e, truth)[E.P]) for e in estimates])


def radii(estimates: Iterable[Estimate]) -> Array:
    """The 95 % radius in space of each estimate, m."""
    return np.array([reach(e.covariance[E.P, E.P]) for e in estimates])


def within(estimates: Iterable[Estimate], start_s: float, end_s: float, *, every: int = 20) -> list[Estimate]:
    """The estimates of a time span (seconds from the start), thinned."""
    begin, end = EPOCH_NS + round(start_s * 1e9), EPOCH_NS + round(end_s * 1e9)
    return [e for e in estimates if begin <= e.t_ns < end][::every]


def same(a: Estimate, b: Estimate) -> bool:
    """Whether two estimates are the same to the bit (when they were computed, and how often it jumped, aside)."""
    return (
        a.t_ns == b.t_ns
        and a.nav.tobytes() == b.nav.tobytes()
        and a.covariance.tobytes() == b.covariance.tobytes()
        and (a.mode, a.last_absolute_ns, a.origin, a.gyro_b) == (b.mode, b.last_absolute_ns, b.origin, b.gyro_b)
    )


def hover(duration_s: float, rate_hz: float = 100.0, start_ns: int = EPOCH_NS, place: Vec3 = (0.0, 0.0, 0.0)) -> list[Input]:
    """A vehicle at rest, level, heading north: perfect IMU samples, and true pose fixes at 2 Hz that are punctual."""
    step_ns = round(1e9 / rate_hz)
    samples: list[Input] = [
        ImuSample(t, t, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665))
        for t in range(start_ns, start_ns + round(duration_s * 1e9) + 1, step_ns)
    ]
    fixes: list[Input] = [
        pose_fix(t, place) for t in range(start_ns + SECOND // 2 + 1, start_ns + round(duration_s * 1e9), SECOND // 2)
    ]
    return sorted(samples + fixes, key=lambda m: (m.arrived_ns, m.t_ns))


def pose_fix(
    t_ns: int,
    p_n: Vec3 = (0.0, 0.0, 0.0),
    *,
    yaw: float = 0.0,
    sigma_m: float = 0.1,
    sigma_rad: float = 0.02,
    late_s: float = 0.0,
) -> PoseFix:
    """A level pose fix."""
    w, x, y, z = so3.from_euler(0.0, 0.0, yaw).tolist()
    covariance = np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)
    return PoseFix(t_ns, t_ns + round(late_s * 1e9), p_n, (w, x, y, z), covariance)


def aid_of(fix: PoseFix, config: PoseConfig | None = None) -> Aid:
    """The aid that a sound pose fix becomes."""
    aid = pose_aid(fix, config or PoseConfig())
    assert isinstance(aid, Aid), aid
    return aid


def displaced(fix: PoseFix, by_n: Vec3) -> PoseFix:
    """The fix, a lie."""
    return msgspec.structs.replace(fix, p_n=vec3(np.add(fix.p_n, by_n)))


def arriving(message: Input, late_s: float) -> Input:
    """The message, late."""
    return msgspec.structs.replace(message, arrived_ns=message.t_ns + round(late_s * 1e9))


def by_arrival(messages: Iterable[Input]) -> list[Input]:
    """In order of arrival."""
    return sorted(messages, key=lambda m: m.arrived_ns)
