"""One thread for small matrices, and as many as before afterwards."""

from __future__ import annotations

import numpy as np
import pytest

from urushi.solvers.adding import threads
from urushi.solvers.adding.media import Scattering, slab


def test_one_thread_inside_and_as_many_as_before_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    count, seen = [8], []
    switch = (lambda: count[0]), (lambda n: count.__setitem__(0, n))
    monkeypatch.setattr(threads, "_switch", lambda: switch)
    with threads.one_thread():
        seen.append(count[0])
        with threads.one_thread():
            seen.append(count[0])
        seen.append(count[0])
    assert seen == [1, 1, 1] and count == [8]
    with pytest.raises(ValueError, match="singular"), threads.one_thread():
        raise ValueError("singular")
    assert count == [8]
    solve = np.linalg.svd
    monkeypatch.setattr(np.linalg, "svd", lambda *args: seen.append(count[0]) or solve(*args))
    slab(
        Scattering.build(np.array([1.0, 0.4]), np.array([0.5, 0.5]), np.ones(1), range(1)),
        np.ones(1),
        np.ones(1),
    )
    assert seen[3:] == [1] and count == [8]


def test_without_such_a_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_switch", lambda: None)
    with threads.one_thread():
        assert np.linalg.det(np.eye(3)) == 1


def test_the_switch_works_where_there_is_one() -> None:
    switch = threads._switch()
    if switch is None:
        pytest.skip("numpy has no OpenBLAS of its own here")
    read, _ = switch
    before = read()
    with threads.one_thread():
        assert read() == 1
    assert read() == before
