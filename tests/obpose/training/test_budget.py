import dataclasses
import itertools
import math
import time
from typing import Any

import pytest
import torch

from obpose.config import TrainConfig
from obpose.training.budget import Budget, Stopwatch, learning_rate

CPU, GPU = torch.device("cpu"), torch.device("cuda")


def test_steps_take_the_place_of_minutes():
    assert Budget.of(TrainConfig(minutes=2.0)).fraction(step=999, seconds=30.0) == 0.25
    assert Budget.of(TrainConfig(minutes=2.0, steps=40)).fraction(step=10, seconds=999.0) == 0.25
    assert Budget.of(TrainConfig(steps=40)).fraction(step=41, seconds=0.0) == 1.0


@pytest.mark.parametrize(
    ("config", "count"),
    [
        (TrainConfig(minutes=1.0), 10),
        (TrainConfig(minutes=600.0), 120),
        (TrainConfig(steps=70), 10),
        (TrainConfig(steps=100_000), 100),
    ],
)
def test_validations_are_spread_evenly_and_the_last_is_at_the_end(config: TrainConfig, count: int):
    budget = Budget.of(config)
    fractions = [i / 10_007 for i in range(10_008)]
    due = [now for before, now in itertools.pairwise(fractions) if budget.validation_is_due(before, now)]
    assert len(due) == count
    assert due[-1] == 1.0
    assert due[0] == pytest.approx(1 / count, abs=1e-3)


def test_the_learning_rate_falls_from_its_value_to_zero():
    config = TrainConfig(learning_rate=0.4)
    rates = [learning_rate(config, fraction) for fraction in (0.0, 0.25, 0.5, 0.75, 1.0)]
    assert rates[0] == 0.4
    assert rates[2] == pytest.approx(0.2)
    assert rates[4] == 0.0
    assert rates == sorted(rates, reverse=True)
    assert learning_rate(TrainConfig(learning_rate=0.4, decay="none"), 0.9) == 0.4


@pytest.mark.parametrize("decay", ["cosine", "halving", "none"])
def test_a_rising_learning_rate_starts_at_zero_and_then_follows_the_schedule(decay: Any):
    plain = TrainConfig(learning_rate=0.4, decay=decay)
    rising = dataclasses.replace(plain, rise=0.2)
    parts = [learning_rate(rising, part) / learning_rate(plain, part) for part in (0.0, 0.05, 0.1, 0.2, 0.6)]
    assert parts == pytest.approx([0.0, 0.25, 0.5, 1.0, 1.0])


def test_halving_halves_over_the_budget():
    config = TrainConfig(learning_rate=0.4, decay="halving")
    assert [learning_rate(config, part) for part in (0.0, 0.5, 1.0)] == pytest.approx([0.4, 0.4 * math.sqrt(0.5), 0.2])


def burn(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_on_a_cpu_work_counts_and_waiting_does_not():
    watch = Stopwatch(CPU, 5.0)
    with watch.running():
        burn(0.02)
        time.sleep(0.2)
    burn(0.02)
    assert 5.02 <= watch.seconds < 5.15


def test_on_a_gpu_waiting_counts():
    watch = Stopwatch(GPU)
    with watch.running():
        time.sleep(0.05)
    time.sleep(0.05)
    counted = watch.seconds
    assert counted >= 0.05
    time.sleep(0.01)
    assert watch.seconds == counted
