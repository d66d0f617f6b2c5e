"""One thread for small matrices, and as many as before afterwards."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

from urushi.solvers.adding import threads
from urushi.solvers.adding.media import Scattering, slab


def counts() -> list[int]:
    """Threads of every library of linear algebra that is loaded."""
    return [one["num_threads"] for one in ThreadpoolController().info() if one["user_api"] == "blas"]


@pytest.fixture(autouse=True)
def _several() -> None:
    """Three threads before, so that one is a difference on any machine."""
    np.linalg.det(np.eye(3))
    with ThreadpoolController().limit(limits=3, user_api="blas"):
        yield  # type: ignore[misc]


def test_one_thread_inside_and_as_many_as_before_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    before = counts()
    if max(before, default=1) == 1:
        pytest.skip("numpy's linear algebra has one thread here")
    with threads.one_thread():
        assert set(counts()) == {1}
        with threads.one_thread():
            assert set(counts()) == {1}
        assert set(counts()) == {1}
    assert counts() == before
    with pytest.raises(ValueError, match="singular"), threads.one_thread():
        raise ValueError("singular")
    assert counts() == before
    seen = []
    solve = np.linalg.svd
    monkeypatch.setattr(np.linalg, "svd", lambda *args: seen.append(set(counts())) or solve(*args))
    slab(
        Scattering.build(np.array([1.0, 0.4]), np.array([0.5, 0.5]), np.ones(1), range(1)),
        np.ones(1),
        np.ones(1),
    )
    assert seen == [{1}] and counts() == before
