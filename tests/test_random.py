"""The random numbers: uniform, independent of one another, and dependent on the question alone."""

from __future__ import annotations

from typing import Any

import drjit as dr
import drjit.scalar
import numpy as np
import pytest

from chi2 import SIGNIFICANCE, mean_p_value, p_value
from lanes import DOUBLE, SINGLE, Lanes, hemisphere, needs_llvm
from urushi.optics.random import generator, uniform, uniform_three

pytestmark = needs_llvm

N = 1 << 16
DRAWS = 6


def words(wi: np.ndarray, wo: np.ndarray, seed: Any = 0, sample: Any = 0, draws: int = DRAWS) -> np.ndarray:
    """The first words of each lane's generator, (draws, N)."""
    import drjit.llvm.ad as llvm

    def integers(x: Any) -> Any:
        return llvm.UInt(np.ascontiguousarray(x, np.uint32)) if isinstance(x, np.ndarray) else llvm.UInt(x)

    one, other = SINGLE.vectors(wi), SINGLE.vectors(wo)
    rng = generator(one, [one.x, one.y, one.z, other.x, other.y, other.z], integers(seed), integers(sample))
    return np.array([np.array(rng.next_word()) for _ in range(draws)], np.uint32)


def streams(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Words of lanes that differ in as little as they can."""
    wi, wo = (np.broadcast_to(w, (N, 3)) for w in hemisphere(rng, 2))
    counting = np.arange(N)
    ulps = np.repeat(wo.astype(np.float32)[:, :1], 1, axis=1).copy()
    ulps = (ulps.view(np.uint32) + counting[:, None].astype(np.uint32)).view(np.float32)
    return {
        "directions": words(hemisphere(rng, N), hemisphere(rng, N)),
        "seeds": words(wi, wo, seed=counting),
        "samples": words(wi, wo, seed=7, sample=counting),
        "high seeds": words(wi, wo, seed=(counting << 16).astype(np.uint32)),
        "one ulp": words(wi, np.concatenate([ulps, wo[:, 1:]], axis=1)),
    }


@pytest.fixture(scope="module")
def lane_words() -> dict[str, np.ndarray]:
    from conftest import SEED

    return streams(np.random.default_rng(SEED))


KINDS = ["directions", "seeds", "samples", "high seeds", "one ulp"]


@pytest.mark.parametrize("kind", KINDS)
def test_uniform_bits_and_bytes(kind: str, lane_words: dict[str, np.ndarray]) -> None:
    for draw in lane_words[kind]:
        for bit in range(32):
            ones = int(np.count_nonzero(draw >> np.uint32(bit) & np.uint32(1)))
            assert p_value(np.array([ones, N - ones]), np.full(2, N / 2)) > SIGNIFICANCE, bit
        for byte in range(4):
            counts = np.bincount((draw >> np.uint32(8 * byte)) & np.uint32(255), minlength=256)
            assert p_value(counts, np.full(256, N / 256)) > SIGNIFICANCE, byte


@pytest.mark.parametrize("kind", KINDS)
def test_draws_and_neighbours_are_independent(kind: str, lane_words: dict[str, np.ndarray]) -> None:
    """Pairs of numbers fill the square evenly, and their bits agree half of the time: later draws of one lane, and
    the same draw of neighbouring lanes."""
    found = lane_words[kind]
    pairs = [(found[i], found[j]) for i in range(DRAWS) for j in range(i)]
    pairs += [(found[i, :-step], found[j, step:]) for step in (1, 2, 256) for i in (0, 1) for j in (0, 1)]
    for one, other in pairs:
        cells = np.bincount((one >> np.uint32(27)) << np.uint32(5) | other >> np.uint32(27), minlength=1024)
        assert p_value(cells, np.full(1024, len(one) / 1024)) > SIGNIFICANCE
        u, v = one * 2.0**-32 - 0.5, other * 2.0**-32 - 0.5
        assert mean_p_value(u * v, 0.0) > SIGNIFICANCE
        agree = 32 - np.bitwise_count(one ^ other).astype(float)
        assert mean_p_value(agree, 16.0) > SIGNIFICANCE


def test_no_two_questions_share_a_stream(lane_words: dict[str, np.ndarray]) -> None:
    """64 bits of state from the hash: no two streams begin alike. (Lane 0 asks the same of some.)"""
    first = np.concatenate([found[:, 1:] for found in lane_words.values()], axis=1).astype(np.uint64)
    joined = first[0] << np.uint64(32) | first[1]
    assert len(np.unique(joined)) == len(joined)


def test_answer_does_not_depend_on_the_batch(rng: np.random.Generator) -> None:
    wi, wo = hemisphere(rng, 1000), hemisphere(rng, 1000)
    order = rng.permutation(1000)
    together = words(wi, wo, 3, 5)
    assert np.array_equal(together[:, order], words(wi[order], wo[order], 3, 5))
    assert np.array_equal(together[:, 17:18], words(wi[17:18], wo[17:18], 3, 5))
    for changed in (words(wi, wo, 4, 5), words(wi, wo, 3, 6), words(wo, wi, 3, 5)):
        assert np.mean(together == changed) < 1e-3


def sfc32(a: int, b: int, c: int, count: int, draws: int) -> list[int]:
    """The published generator (PractRand's sfc32), in plain integers."""
    found, mask = [], 0xFFFFFFFF
    for _ in range(draws):
        word = (a + b + count) & mask
        count = (count + 1) & mask
        a = b ^ (b >> 9)
        b = (c + (c << 3)) & mask
        c = (((c << 21) | (c >> 11)) + word) & mask
        found.append(word)
    return found


def test_scalar_and_vector_streams_are_the_same_bit_for_bit(rng: np.random.Generator) -> None:
    """And both are sfc32."""
    import drjit.llvm.ad as llvm

    wi, wo = (SINGLE.rounded(hemisphere(rng, 50)) for _ in range(2))
    one, other = SINGLE.vectors(wi), SINGLE.vectors(wo)
    many = generator(one, [one.x, one.y, one.z, other.x, other.y, other.z], llvm.UInt(11), llvm.UInt(13))
    start = [np.broadcast_to(np.array(x), 50) for x in (many.a, many.b, many.c, many.count)]
    numbers = np.array([np.array(uniform(many, one)) for _ in range(20)])
    for lane in range(50):
        w = dr.scalar.Array3f(*wi[lane])
        single = generator(w, [*map(float, wi[lane]), *map(float, wo[lane])], 11, 13)
        assert [single.a, single.b, single.c, single.count] == [int(x[lane]) for x in start]
        published = sfc32(single.a, single.b, single.c, single.count, 20)
        assert [uniform(single, w) for _ in range(20)] == list(numbers[:, lane])
        assert [word >> 9 for word in published] == [int(u * 2**23) for u in numbers[:, lane]]


@pytest.mark.parametrize("lanes", [SINGLE, DOUBLE], ids=["single", "double"])
def test_numbers_are_uniform_and_below_one(lanes: Lanes, rng: np.random.Generator) -> None:
    import drjit.llvm.ad as llvm

    w = lanes.vectors(hemisphere(rng, 1 << 18))
    stream = generator(w, [w.x, w.y], llvm.UInt(0), llvm.UInt(0))
    found = np.array(uniform(stream, w))
    assert found.dtype == lanes.dtype and found.min() >= 0 and found.max() < 1
    assert p_value(np.histogram(found, 4096, (0, 1))[0], np.full(4096, len(found) / 4096)) > SIGNIFICANCE
    # The largest word there is.
    stream.a, stream.b, stream.c, stream.count = (llvm.UInt(x) for x in (0xFFFFFFFF, 0, 0xFFFFFFFF, 0))
    largest = np.array(uniform(stream, w))[0]
    assert 1 - 1e-6 < largest < 1


def test_three_numbers_of_two_words(rng: np.random.Generator) -> None:
    """The first two are `uniform`'s; the third is as even, independent of both, and the same in scalar form."""
    import drjit.llvm.ad as llvm

    w = SINGLE.vectors(SINGLE.rounded(hemisphere(rng, 1 << 18)))
    start = (w, [w.x, w.y, w.z], llvm.UInt(5), llvm.UInt(0))
    again, stream = generator(*start), generator(*start)
    one, two, three = (np.array(x, np.float64) for x in uniform_three(stream, w))
    assert np.array_equal(one, np.array(uniform(again, w))) and np.array_equal(
        two, np.array(uniform(again, w))
    )
    assert np.array_equal(np.array(stream.a), np.array(again.a))
    assert three.min() > 0 and three.max() < 1
    cells = np.histogram(three, 4096, (0, 1))[0]
    assert p_value(cells, np.full(4096, len(three) / 4096)) > SIGNIFICANCE
    for other in (one, two):
        assert mean_p_value((three - 0.5) * (other - 0.5), 0.0) > SIGNIFICANCE
        square = np.histogram2d(three, other, 32, ((0, 1), (0, 1)))[0].ravel()
        assert p_value(square, np.full(1024, len(three) / 1024)) > SIGNIFICANCE
    single = dr.scalar.Array3f(*(float(np.array(x)[7]) for x in w))
    found = uniform_three(generator(single, [*single], 5, 0), single)
    assert found == (one[7], two[7], three[7])
    double = DOUBLE.vectors(hemisphere(rng, 1000))
    numbers = uniform_three(generator(double, [double.x], llvm.UInt(0), llvm.UInt(0)), double)
    assert len({float(np.array(x)[0]) for x in numbers}) == 3 and np.array(numbers[2]).dtype == np.float64
