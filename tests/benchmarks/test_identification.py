"""Looks and pairs that can be made again one by one, and counts with bounds that a reader can follow."""

import pytest

from benchmarks.identification.__main__ import jobs, run, table
from benchmarks.identification.batch import Batch, counted
from benchmarks.identification.looks import judge, look, world_of
from benchmarks.integrity.report import bound


def test_a_look_is_the_same_alone() -> None:
    """GIVEN a batch WHEN one of its looks is made alone THEN it is the same case."""
    world = world_of("grid", 20.0, 1, 0)
    fixes = [judge(20.0, 1, number, world) for number in range(12)]
    alone = judge(20.0, 1, 9, world_of("grid", 20.0, 1, 0))
    assert alone == fixes[9]
    batch = look(("looks", "grid", 20.0, 12, 1, "this"))
    assert batch == counted(("looks", "grid", 20.0, 12, 1, "this"), [f for f in fixes if f is not None])
    assert 0 < batch.fixes < 12


@pytest.mark.long
def test_rendered_pairs_give_fixes() -> None:
    """GIVEN a rendered village WHEN pairs of it are recognised THEN most give a fix, none far off."""
    batch = run(("pairs", "village", 5.0, 6, 1, "this"))
    assert batch.fixes >= 4
    assert batch.far == 0
    assert batch.identified > 3 * batch.fixes


def test_jobs_are_named_once_and_take_turns() -> None:
    """GIVEN both kinds WHEN they are planned THEN no job is there twice, and each kind is begun at once."""
    work = jobs(6_000, 864, 3)
    assert len(set(work)) == len(work)
    assert sum(n for kind, _, _, n, _, _ in work if kind == "looks") == 6_000
    assert sum(n for kind, _, _, n, _, _ in work if kind == "pairs") == 864
    assert {job[0] for job in work[:2]} == {"looks", "pairs"}
    assert {job[4] for job in work} == {3, 4, 5, 6}


def test_shares_have_their_bound() -> None:
    """GIVEN batches of two worlds WHEN they are tabled THEN each world and all have counts and Clopper-Pearson bounds."""
    some = [
        Batch("looks", "grid, prior 5 m", 0, "this", 500, 400, 2, 1, 900, 3, 0.5, 300),
        Batch("looks", "random, prior 5 m", 0, "this", 500, 450, 0, 0, 950, 0, 0.2, 300),
    ]
    lines = {line[1]: line[2:] for line in table(some).rows}
    assert list(lines) == ["grid, prior 5 m", "random, prior 5 m", "all"]
    whole = ("1000", "850", "2", "0.0074", "1", f"{bound(1, 850):.2g}", "0.7", "600", "0", "1850", "3", f"{bound(3, 1850):.2g}")
    assert lines["all"] == whole
    assert lines["random, prior 5 m"][3] == "0.0066"  # 3 / 450
