import numpy as np

from logs.evaluation.integrity import against_truth, regions, summarise
from models.messages import Alert, Integrity

S = 1_000_000_000
T0 = 1_795_000_000_000_000_000


def _level(t_s: float, hpl: float, state: Alert = Alert.USABLE) -> Integrity:
    t_ns = T0 + round(t_s * S)
    return Integrity(t_ns, t_ns, state, "", 1e-5, hpl, 5.0, 10.0, np.inf, (1e-3, 1e-5), (1.0, hpl), (5.0, 5.0), 1.0, 1.0)


def test_the_regions_are_those_of_the_stanford_diagram() -> None:
    error = np.array([1.0, 4.0, 12.0, 1.0, 30.0])
    level = np.array([3.0, 3.0, 3.0, 11.0, 11.0])
    found = regions(error, level, 10.0, [np.full(5, 20.0)])
    assert (found.nominal, found.misleading, found.hazardous, found.unavailable) == (1, 1, 1, 2)
    assert found.exceeded == (1, 3)
    assert found.compared == 5
    assert found.available == 0.6


def test_a_level_answers_for_the_largest_error_until_the_next_one_but_not_for_longer_than_a_second() -> None:
    levels = [_level(0.0, 3.0), _level(0.2, 3.0)]
    t_ns = T0 + np.array([-0.1, 0.0, 0.1, 0.2, 1.1, 1.3]) * S
    error = np.zeros((6, 3))
    error[:, 0], error[:, 2] = [9.0, 0.1, -2.0, 0.3, 0.4, 9.0], [9.0, 0.0, 0.0, 0.0, -0.7, 9.0]
    found = against_truth(levels, t_ns.astype(np.int64), error)
    assert found.row.tolist() == [0, 1]
    assert found.horizontal.tolist() == [2.0, 0.4]
    assert found.vertical.tolist() == [0.0, 0.7]


def test_a_log_is_summed_up() -> None:
    levels = [_level(0.0, np.inf, Alert.DO_NOT_USE), _level(0.2, 3.0), _level(0.4, 3.0), _level(0.6, 3.0)]
    t_ns = T0 + (np.array([0.0, 0.2, 0.4]) * S).astype(np.int64)
    found = summarise(levels, t_ns, np.array([[50.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 0.0, 6.0]]))
    assert found is not None
    assert found.horizontal is not None
    assert found.vertical is not None
    assert found.evaluations == 4
    assert found.states == {"do not use": 0.25, "usable": 0.75}
    assert found.limits_m == (10.0, None)
    assert found.horizontal.exceeded == (2, 0, 0)
    assert (found.horizontal.nominal, found.horizontal.unavailable) == (2, 1)
    assert found.vertical.exceeded == (1, 1, 1)
    assert found.vertical.misleading == 1


def test_without_levels_or_without_a_truth_nothing_is_counted() -> None:
    assert summarise([], np.empty(0, np.int64), np.empty((0, 3))) is None
    found = summarise([_level(0.0, 3.0)], np.empty(0, np.int64), np.empty((0, 3)))
    assert found is not None
    assert found.horizontal is None
