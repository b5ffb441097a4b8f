"""Costs of scoring, in milliseconds of one core: times are CPU times."""

import time
from statistics import median

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from sklearn.metrics import adjusted_rand_score

from benchmark.metrics import clip_scores, score

FRAMES = 160
GROUP = f"metrics: {FRAMES} frames at 128x128"
LEAST_FRAMES_PER_SECOND = 500


@pytest.fixture(scope="module")
def maps() -> tuple[np.ndarray, np.ndarray]:
    """Eight discs that drift over a background; the prediction lies two pixels beside them and leaks."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:128, :128]
    truth = np.zeros((FRAMES, 128, 128), np.uint8)
    centres, speeds = rng.uniform(10, 118, (8, 2)), rng.uniform(-0.3, 0.3, (8, 2))
    for frame, labels in enumerate(truth):
        for thing, (cx, cy) in enumerate(centres + frame * speeds, start=1):
            labels[(x - cx) ** 2 + (y - cy) ** 2 < 15**2] = thing
    leaking = np.where(rng.random(truth.shape) < 0.02, 1, np.roll(truth, 2, axis=2))
    return truth, leaking.astype(np.int64)


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_all_metrics(benchmark: BenchmarkFixture, maps: tuple[np.ndarray, np.ndarray]):
    scores = benchmark(lambda: score(*maps))
    benchmark.extra_info["frames"] = scores["n_frames"]


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_all_metrics_of_a_clip(benchmark: BenchmarkFixture, maps: tuple[np.ndarray, np.ndarray]):
    truth, prediction = (labels.reshape(FRAMES // 2, 2, 128, 128) for labels in maps)
    benchmark(lambda: clip_scores(truth, prediction))


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_scikit_learn_ari_alone(benchmark: BenchmarkFixture, maps: tuple[np.ndarray, np.ndarray]):
    benchmark(lambda: scikit_learn(*maps))


def test_goals(maps: tuple[np.ndarray, np.ndarray]):
    """All metrics together, against what the benchmark promises."""
    ours, theirs = cpu_seconds(lambda: score(*maps)), cpu_seconds(lambda: scikit_learn(*maps))
    print(f"\nall metrics: {FRAMES / ours:.0f} frames/s, {theirs / ours:.1f} times scikit-learn's ARI alone")
    assert FRAMES / ours >= LEAST_FRAMES_PER_SECOND


def scikit_learn(truth: np.ndarray, prediction: np.ndarray) -> list[float]:
    return [adjusted_rand_score(t.ravel(), p.ravel()) for t, p in zip(truth, prediction, strict=True)]


def cpu_seconds(call) -> float:
    """Median of five."""
    times = []
    for _ in range(5):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return median(times)
