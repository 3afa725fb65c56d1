"""Block-wise least squares against the dense formulas."""

import numpy as np

from vision.pose.least_squares import System, distances, solve


def make(rng: np.random.Generator, edges: int = 7, rows: int = 4, nuisances: int = 5) -> tuple[System, np.ndarray]:
    root = rng.normal(size=(edges, rows, rows))
    R = root @ root.transpose(0, 2, 1) + np.eye(rows)
    found = rng.random((edges, rows)) > 0.2
    found[:, 1::2] = found[:, ::2]
    A = rng.normal(size=(edges, rows, 6 + nuisances))
    return System.of(rng.normal(size=(edges, rows)), A, R, found), found


def test_the_step_is_the_dense_one() -> None:
    rng = np.random.default_rng(1)
    system, found = make(rng)
    information, delta, present = np.diag(rng.uniform(0.5, 2.0, 6)), rng.normal(size=6), rng.normal(size=5)
    got = solve(system, present, information, delta)
    keep = found.ravel()
    R = np.zeros((keep.size, keep.size))
    for e in range(7):
        R[4 * e : 4 * e + 4, 4 * e : 4 * e + 4] = system.R[e]
    R, z = R[np.ix_(keep, keep)], system.z.ravel()[keep]
    H, N = system.A.reshape(-1, 11)[keep, :6], system.A.reshape(-1, 11)[keep, 6:]
    V = R + N @ N.T
    # With nuisances of unit variance about 0, of which `present` is drawn already: z + N nu_0 = H dx + N nu + e
    images = H.T @ np.linalg.solve(V, H)
    dx = np.linalg.solve(images + information, H.T @ np.linalg.solve(V, z + N @ present) - information @ delta)
    np.testing.assert_allclose(got.dx, dx)
    schur = got.omega[:6, :6] - got.omega[:6, 6:] @ np.linalg.solve(got.omega[6:, 6:], got.omega[6:, :6])
    np.testing.assert_allclose(schur, images)


def test_a_weightless_edge_is_as_if_not_there() -> None:
    rng = np.random.default_rng(2)
    system, found = make(rng)
    weight = np.ones(7)
    weight[2] = 0.0
    less = system.weighted(weight)
    assert less.count == system.count - int(found[2, ::2].sum())
    here = solve(less, np.zeros(5), np.eye(6), np.zeros(6))
    some = [e for e in range(7) if e != 2]
    there = solve(System(system.z[some], system.A[some], system.R[some], system.W[some]), np.zeros(5), np.eye(6), np.zeros(6))
    np.testing.assert_allclose(here.dx, there.dx)
    assert distances(less, here.residual)[2] == 0.0


def test_weights_are_the_inverse_of_what_was_found() -> None:
    system, found = make(np.random.default_rng(3))
    for R, W, some in zip(system.R, system.W, found, strict=True):
        expected = np.zeros_like(R)
        expected[np.ix_(some, some)] = np.linalg.inv(R[np.ix_(some, some)])
        np.testing.assert_allclose(W, expected, atol=1e-12)


def test_columns_that_are_zero_change_nothing() -> None:
    """Each edge depends on some of the nuisances only: as dense as written, and as in the normal equations."""
    rng = np.random.default_rng(4)
    system, _ = make(rng)
    system.A[:4, :, 8:] = 0.0
    got = solve(system, np.zeros(5), np.eye(6), np.zeros(6))
    omega = np.einsum("eik,eij,ejm->km", system.A, system.W, system.A) + np.diag([0.0] * 6 + [1.0] * 5)
    eta = np.einsum("eik,eij,ej->k", system.A, system.W, system.z)
    np.testing.assert_allclose(got.omega, omega, atol=1e-12)
    np.testing.assert_allclose(got.dx, np.linalg.solve(omega + np.diag([1.0] * 6 + [0.0] * 5), eta)[:6])
