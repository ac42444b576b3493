"""The pool of the step's programs."""

from smoothers.scp.qp_step import ProgramPool


def test_the_pool_builds_each_size_once_and_counts_the_time():
    pool = ProgramPool()
    assert pool.program(4, 3) is pool.program(4, 3)
    assert pool.program(4, 2) is not pool.program(4, 3)
    assert pool.build_time > 0.0
