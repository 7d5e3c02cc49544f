"""Fails each test after which a block of the heap has been written beyond its ends: `make heap`, which loads `heap.c` first."""

import ctypes
from collections.abc import Iterator

import pytest

HEAP = ctypes.CDLL(None)  # what was loaded first


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    before = HEAP.look()
    yield
    found = HEAP.look() - before
    assert not found, f"{found} blocks of the heap were written beyond their ends: see what was printed"
