import pytest

from obpose.config_text import dotted_values
from obpose.variants import PROFILES, make_config


@pytest.mark.parametrize("profile", PROFILES)
def test_slot_attention_as_published_differs_from_ours_in_the_mistakes_of_the_authors_code(profile: str):
    ours = dict(dotted_values(make_config("slot-attention", profile)))
    published = dict(dotted_values(make_config("slot-attention-as-published", profile)))
    assert {name: value for name, value in published.items() if value != ours[name]} == {
        "model.attention.slot_distribution": "untrained",
        "model.object_field.density": "squashed",
        "model.background_field.density": "squashed",
    }
