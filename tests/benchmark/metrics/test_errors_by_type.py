"""One table of counts for each way in which an object can go wrong."""

import numpy as np
import pytest

from benchmark.metrics.errors_by_type import ERROR_TYPES, errors_by_type, identity_switches
from benchmark.metrics.overlap import intersection_over_union

# Rows: background, first and second object; columns: slots, of which 0 is the background's.
FINE = [[90, 0, 0], [0, 10, 0], [0, 0, 10]]


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (FINE, [set(), set()]),
        ([[90, 0, 0], [0, 10, 0], [0, 10, 0]], [{"merged"}, {"merged"}]),
        ([[90, 0, 0], [10, 0, 0], [0, 0, 10]], [{"missed"}, set()]),
        ([[90, 0, 0, 0], [0, 8, 0, 2], [0, 0, 10, 0]], [{"split"}, set()]),
        ([[90, 0, 0, 0], [0, 9, 0, 1], [0, 0, 10, 0]], [set(), set()]),
        ([[87, 3, 0], [0, 10, 0], [0, 0, 10]], [{"leaked"}, set()]),
        ([[88, 2, 0], [0, 8, 0], [0, 0, 10]], [{"leaked"}, set()]),
        ([[88, 2, 0], [0, 10, 0], [0, 0, 10]], [set(), set()]),
        ([[90, 0, 0], [4, 6, 0], [0, 0, 10]], [set(), set()]),
        ([[50, 40, 0, 0], [0, 6, 4, 0], [0, 10, 0, 0]], [{"merged", "split", "leaked"}, {"merged", "leaked"}]),
        ([[90, 0, 0], [0, 0, 0], [0, 0, 10]], [set(), set()]),
    ],
    ids=["none", "merged", "missed", "split", "frayed", "leaked", "fifth", "rim", "eaten", "several", "absent"],
)
def test_each_error_is_read_off_its_table(table: list[list[int]], expected: list[set[str]]) -> None:
    found = errors_by_type(np.array([table]), 0)[0]
    assert [names(mask) for mask in found] == expected


def test_an_object_that_changes_its_slot_is_switched_in_that_frame_only() -> None:
    renamed = [[90, 0, 0], [0, 0, 10], [0, 10, 0]]
    found = errors_by_type(np.array([FINE, renamed, renamed]), 0)
    assert [[names(mask) for mask in frame] for frame in found] == [[set()] * 2, [{"switched"}] * 2, [set()] * 2]


def test_a_switch_is_seen_across_frames_that_hide_the_object() -> None:
    hidden = [[90, 0, 0], [0, 0, 0], [0, 0, 10]]
    back = [[90, 0, 0, 0], [0, 0, 0, 10], [0, 0, 10, 0]]
    tables = np.array([np.pad(FINE, ((0, 0), (0, 1))), np.pad(hidden, ((0, 0), (0, 1))), back])
    assert names(errors_by_type(tables, 0)[2, 0]) == {"switched"}


def test_of_equal_slots_an_object_can_only_have_been_in_one() -> None:
    """The middle frame halves it between the slots of the others: whichever it is in, it switches once."""
    tables = np.array([[[90, 0, 0], [0, 10, 0]], [[90, 0, 0], [0, 5, 5]], [[90, 0, 0], [0, 0, 10]]])
    assert identity_switches(intersection_over_union(tables)[:, None]).tolist() == [1]


@pytest.mark.parametrize("seed", range(20))
def test_switches_add_up_to_the_metric(seed: int) -> None:
    tables = np.random.default_rng(seed).integers(0, 4, (6, 4, 5))
    switched = errors_by_type(tables, 0)[..., ERROR_TYPES.index("switched")]
    assert switched.sum() == identity_switches(intersection_over_union(tables)[:, None])[0]


@pytest.mark.parametrize("seed", range(20))
def test_names_of_slots_do_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tables = rng.integers(0, 1000, (3, 4, 5))
    order = rng.permutation(5)
    background = int(np.flatnonzero(order == 0)[0])
    assert np.array_equal(errors_by_type(tables, 0), errors_by_type(tables[:, :, order], background))


def names(mask: np.ndarray) -> set[str]:
    return {name for name, is_there in zip(ERROR_TYPES, mask, strict=True) if is_there}
