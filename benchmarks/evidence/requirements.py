"""What the protection levels are required to do, the tests that show it, and where its result stands."""

from typing import Final, NamedTuple


class Requirement(NamedTuple):
    """tests: file::function under tests/; result: a file of the pack, or empty where the tests are the result."""

    name: str
    text: str
    tests: tuple[str, ...]
    result: str = ""


_I: Final = "estimator/integrity"
REQUIREMENTS: Final = (
    Requirement(
        "PL-1",
        "The level bounds the error at the stated risk for errors of the assumed distribution.",
        (f"{_I}/test_protection.py::test_the_bound_holds_and_is_tight",),
        "campaign.json",
    ),
    Requirement(
        "PL-2",
        "A source that nothing checks has no level below its own fault rate.",
        (
            f"{_I}/test_monitor.py::test_a_source_that_nothing_checks_has_no_bound_below_its_own_fault_rate",
            f"{_I}/test_faults.py::test_a_source_alone_is_not_bounded_and_has_faults_of_known_size",
        ),
    ),
    Requirement(
        "PL-3",
        "Sources that disagree are covered by the level within a second.",
        (
            f"{_I}/test_monitor.py::test_sources_that_disagree_are_not_used_within_a_second_and_the_bound_covers_both",
            f"{_I}/test_monitor.py::test_it_comes_at_once_with_a_position_that_is_off",
            f"{_I}/test_monitor.py::test_an_imu_that_runs_away_beside_gnss_is_covered_and_alerted_before_the_error_passes_the_limit",
        ),
        "drawn.json",
    ),
    Requirement(
        "PL-4",
        "An outage ends the use before the error passes the alert limit.",
        (f"{_I}/test_monitor.py::test_an_outage_ends_the_use_before_the_error_passes_the_limit",),
        "campaign.json",
    ),
    Requirement(
        "PL-5",
        "A worse state holds at once, a better one after two seconds.",
        (f"{_I}/test_alert.py::test_worse_at_once_and_better_after_two_seconds",),
    ),
    Requirement(
        "PL-6",
        "The estimate is the same to the bit whatever is configured; a defect of the levels costs the level alone.",
        (
            f"{_I}/test_monitor.py::test_the_estimate_is_the_same_to_the_bit_whatever_is_configured",
            f"{_I}/test_monitor.py::test_a_defect_costs_the_level_and_not_the_estimate",
        ),
    ),
    Requirement(
        "EV-1",
        "The weight of a drawn flight is the ratio of its nominal and its drawn probability.",
        ("benchmarks/test_drawn.py::test_the_weighted_share_of_each_kind_is_its_nominal_probability",),
        "drawn.json",
    ),
)
