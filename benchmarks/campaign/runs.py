"""One flight, simulated, estimated and judged against its truth and its bound.

    e = x_true (-) x_hat,   NEES = e' P^-1 e  of  pose (p, theta), velocity, full state         (Bar-Shalom 2001, eq. 5.4.2-2)

The bound begins at the first pose fix with the filter's covariance; for GNSS alone with a diffuse one.
"""

import math
from collections import Counter

import msgspec
import numpy as np

from benchmarks.campaign.bound import linearise, posterior_bound
from benchmarks.campaign.flights import Flight
from estimator.fusion import Fusion, FusionConfig
from models.messages import AidStatus, Array, Estimate, GnssFix, GnssVelocity, Input, PoseFix, Reason
from models.sim.scenario import EPOCH_NS, Simulation, simulate
from models.state import E, NavState, local

POSE = np.r_[E.P, E.THETA]
PARTS = {"pose": POSE, "velocity": np.r_[E.V], "full": np.arange(E.SIZE)}  # whose NEES is taken
BLOCKS = {"position": E.P, "velocity": E.V, "attitude": E.THETA}  # whose RMSE is compared with the bound
_DIFFUSE_TILT_RAD, _DIFFUSE_HEADING_RAD = math.radians(12.0), 1.0

Arrived = tuple[int, str, str]  # t_ns, topic, kind: one measurement


class Score(msgspec.Struct, frozen=True):
    """One run at k instants: nees (k, PARTS), squared errors and bound's traces (k, BLOCKS); what became of the valid fixes.

    None, or nan, where there was no estimate; resets: jumps reported; internal: defects reported.
    """

    nees: list[list[float | None]]
    squared: list[list[float | None]]
    bound: list[list[float]]
    fixes: dict[str, int]
    resets: int
    internal: int


def run(flight: Flight, number: int, process_scale: float = 1.0) -> Score:
    """Simulate, estimate, judge run `number` of a flight; process_scale != 1 is a filter that is tuned wrong."""
    simulation = simulate(flight.scenario, flight.seed(number))
    config = flight.config(process_scale)
    at_ns = [EPOCH_NS + round(instant.t_s * 1e9) for instant in flight.instants()]
    estimates, reasons = estimate(simulation, config, frozenset(at_ns))
    bound = bound_at(flight, simulation, at_ns)
    nees, squared = np.full((len(at_ns), len(PARTS)), np.nan), np.full((len(at_ns), len(BLOCKS)), np.nan)
    for k, t_ns in enumerate(at_ns):
        if t_ns in estimates:
            error = error_of(estimates[t_ns], simulation)
            nees[k] = [normalised_squared(error[part], estimates[t_ns].covariance[np.ix_(part, part)]) for part in PARTS.values()]
            squared[k] = [error[block] @ error[block] for block in BLOCKS.values()]
    return Score(
        nees=nees.tolist(),
        squared=squared.tolist(),
        bound=[[float(np.trace(P[block, block])) for block in BLOCKS.values()] for P in bound],
        fixes=dict(Counter(reasons.values())),
        resets=max((e.reset_counter for e in estimates.values()), default=0),
        internal=sum(reason is Reason.INTERNAL for reason in reasons.values()),
    )


def estimate(
    simulation: Simulation, config: FusionConfig, at_ns: frozenset[int]
) -> tuple[dict[int, Estimate], dict[Arrived, Reason]]:
    """The estimates at these instants, and what became of each measurement in the end."""
    fusion = Fusion(config)
    estimates: dict[int, Estimate] = {}
    reasons: dict[Arrived, Reason] = {}
    for message in simulation.messages:
        for output in fusion.handle(message):
            if isinstance(output, Estimate) and output.t_ns in at_ns:
                estimates[output.t_ns] = output
            elif isinstance(output, AidStatus):
                reasons[output.t_ns, output.topic, output.kind] = output.reason
    return estimates, reasons


def error_of(estimate: Estimate, simulation: Simulation) -> Array:
    """x_true (-) x_hat, (15,)."""
    truth = simulation.truth
    k = int(np.searchsorted(truth.t_ns, estimate.t_ns))
    true = NavState(truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k], truth.gyro_bias[k], truth.accel_bias[k])
    return local(estimate.nav, true.pack())


def normalised_squared(error: Array, covariance: Array) -> float:
    """e' P^-1 e, scaled so that metres and rad/s stand side by side; inf where P is not positive definite."""
    sigma = np.sqrt(np.diag(covariance))
    try:
        low = np.linalg.cholesky(covariance / np.outer(sigma, sigma))
    except np.linalg.LinAlgError:
        return math.inf
    white = np.linalg.solve(low, error / sigma)
    return float(white @ white)


def bound_at(flight: Flight, simulation: Simulation, at_ns: list[int]) -> Array:
    """The posterior Cramer-Rao bound at the instants, (k, 15, 15), of everything from the first fix on."""
    aids = sorted((m for m in simulation.messages if isinstance(m, PoseFix | GnssFix | GnssVelocity)), key=lambda m: m.t_ns)
    first = next((m for m in aids if isinstance(m, PoseFix)), aids[0])
    truth = simulation.truth.since(first.t_ns)
    rest = [linear for m in aids if m.t_ns > first.t_ns and (linear := linearise(m, simulation.truth)) is not None]
    P0 = prior(first, truth.R_nb[0], flight.config())
    return posterior_bound(truth, flight.noise(), rest, P0, at_ns, simulation.origin)


def prior(first: Input, R_nb: Array, config: FusionConfig) -> Array:
    """The filter's own covariance at its first fix, P (15, 15)."""
    start = config.initialise
    P = np.zeros((E.SIZE, E.SIZE))
    P[E.V, E.V] = np.eye(3) * start.velocity_sigma_m_s**2
    P[E.BG, E.BG] = np.eye(3) * start.gyro_bias_sigma**2
    P[E.BA, E.BA] = np.eye(3) * start.accel_bias_sigma**2
    if isinstance(first, PoseFix):
        P[E.P, E.P], P[E.THETA, E.THETA] = first.covariance[:3, :3], R_nb.T @ first.covariance[3:, 3:] @ R_nb
    else:
        about_n = np.diag(np.square([_DIFFUSE_TILT_RAD, _DIFFUSE_TILT_RAD, _DIFFUSE_HEADING_RAD]))
        P[E.P, E.P] = first.covariance_n if isinstance(first, GnssFix) else np.eye(3)
        P[E.THETA, E.THETA] = R_nb.T @ about_n @ R_nb
    return P
