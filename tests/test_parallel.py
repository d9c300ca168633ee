"""Processes that share work: which of them a terminal's Ctrl-C reaches."""

from functools import partial
from signal import SIG_BLOCK, SIGINT, pthread_sigmask

from omniocc.parallel import mapped


def test_ctrl_c_reaches_the_parent_alone():
    for blocked in mapped(partial(pthread_sigmask, SIG_BLOCK), [set(), set()], workers=2):
        assert SIGINT in blocked
    assert SIGINT not in pthread_sigmask(SIG_BLOCK, set())
